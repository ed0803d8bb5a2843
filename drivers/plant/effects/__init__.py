"""The hidden effects that the simulated cell knows. A new one is a file here and a line in ``FACTORIES``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from drivers.plant.effect import Effect, Parameters
from drivers.plant.effects.backlash import backlash
from drivers.plant.effects.encoder_eccentricity import encoder_eccentricity
from drivers.plant.effects.joint_compliance import joint_compliance

FACTORIES: Mapping[str, Callable[[Parameters], Effect]] = {
    "backlash": backlash,
    "encoder_eccentricity": encoder_eccentricity,
    "joint_compliance": joint_compliance,
}


def build(arm: str, joints: int, configured: Mapping[str, Mapping[str, Any]]) -> tuple[Effect, ...]:
    """The effects of one arm. Raises ``ValueError`` naming the arm, the effect, the parameter and what exists."""
    effects = []
    for name, values in configured.items():
        if name not in FACTORIES:
            raise ValueError(f"arm {arm}: there is no effect '{name}'; effects are {', '.join(sorted(FACTORIES))}")
        if not isinstance(values, Mapping):
            raise ValueError(f"arm {arm}, effect {name}: expected its parameters by name, not {values!r}")
        effects.append(FACTORIES[name](Parameters(arm, name, values, joints)))
    return tuple(effects)
