"""Registry of the hidden effects of the simulated cell. A new one is a file here and a line in ``FACTORIES``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from drivers.plant.effect import Parameters, PlantEffect
from drivers.plant.effects.backlash import backlash
from drivers.plant.effects.drift import base_drift, base_step, target_slip, tracker_drift
from drivers.plant.effects.drive_lag import drive_lag
from drivers.plant.effects.encoder_eccentricity import encoder_eccentricity
from drivers.plant.effects.friction_windup import friction_windup
from drivers.plant.effects.joint_axis_runout import joint_axis_runout
from drivers.plant.effects.joint_axis_wobble import joint_axis_wobble
from drivers.plant.effects.joint_compliance import joint_compliance
from drivers.plant.effects.joint_vibration import joint_vibration
from drivers.plant.effects.link_bending import link_bending
from drivers.plant.effects.payload_compliance import payload_compliance
from drivers.plant.effects.pedestal import pedestal_compliance, pedestal_coupling
from drivers.plant.effects.target_incidence import target_incidence
from drivers.plant.effects.thermal import joint_drift, thermal_growth
from drivers.plant.effects.tracker import tracker_angle_error, tracker_distance_offset, tracker_scale
from drivers.plant.effects.transmission_error import transmission_error
from drivers.plant.effects.uncatalogued import (
    base_sway,
    crosstalk,
    draught,
    dress_pack,
    elbow_hose,
    joint_coupling,
    tool_sag,
    warm_floor,
    workspace_field,
    wrist_cable,
)
from drivers.plant.effects.unsettled_measurement import unsettled_measurement

FACTORIES: Mapping[str, Callable[[Parameters], PlantEffect]] = {
    "backlash": backlash,
    "base_drift": base_drift,
    "base_step": base_step,
    "base_sway": base_sway,
    "crosstalk": crosstalk,
    "draught": draught,
    "dress_pack": dress_pack,
    "drive_lag": drive_lag,
    "elbow_hose": elbow_hose,
    "joint_coupling": joint_coupling,
    "encoder_eccentricity": encoder_eccentricity,
    "friction_windup": friction_windup,
    "joint_axis_runout": joint_axis_runout,
    "joint_axis_wobble": joint_axis_wobble,
    "joint_compliance": joint_compliance,
    "joint_drift": joint_drift,
    "joint_vibration": joint_vibration,
    "link_bending": link_bending,
    "payload_compliance": payload_compliance,
    "pedestal_compliance": pedestal_compliance,
    "pedestal_coupling": pedestal_coupling,
    "target_incidence": target_incidence,
    "target_slip": target_slip,
    "thermal_growth": thermal_growth,
    "tool_sag": tool_sag,
    "tracker_angle_error": tracker_angle_error,
    "tracker_distance_offset": tracker_distance_offset,
    "tracker_drift": tracker_drift,
    "tracker_scale": tracker_scale,
    "transmission_error": transmission_error,
    "unsettled_measurement": unsettled_measurement,
    "warm_floor": warm_floor,
    "workspace_field": workspace_field,
    "wrist_cable": wrist_cable,
}


def build(arm: str, joints: int, configured: Mapping[str, Mapping[str, Any]]) -> tuple[PlantEffect, ...]:
    """Build the effects of one arm. Raises ``ValueError`` with the arm, the effect, the parameter and what is valid."""
    effects = []
    for name, values in configured.items():
        if name not in FACTORIES:
            raise ValueError(f"arm {arm}: unknown effect '{name}'; effects are {', '.join(sorted(FACTORIES))}")
        if not isinstance(values, Mapping):
            raise ValueError(f"arm {arm}, effect {name}: expected its parameters by name, not {values!r}")
        effects.append(FACTORIES[name](Parameters(arm, name, values, joints)))
    return tuple(effects)
