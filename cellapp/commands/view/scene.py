"""The cell in space as data: arms, bases, tracker, obstacles, measured stops, errors before and after. No drawing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.view.charts import Array, mm
from cellapp.commands.view.words import STAGE_WORDS


@dataclass(frozen=True, eq=False)
class Capsules:
    """The bodies of one arm: capsules with axes from ``start`` to ``end`` (m, 3) [m] and ``radius`` (m,) [m]."""

    start: Array
    end: Array
    radius: Array


@dataclass(frozen=True, eq=False)
class ErrorVectors:
    """Measured minus computed positions ``steps`` (n, 3) [m] of one stage at held-out ``points`` (n, 3) [m]."""

    stage: str
    points: Array
    steps: Array
    stops: NDArray[np.int64]

    @property
    def mean_mm(self) -> float:
        """Mean length [mm]."""
        return float(np.linalg.norm(self.steps, axis=1).mean()) * 1e3 if len(self.steps) else 0.0


@dataclass(frozen=True, eq=False)
class SceneArm:
    """One arm: its bodies and its chain (k, 3) [m] from base to SMR at one measured stop, measured ``points`` (n, 3)
    [m] at ``stops`` (n,), and its errors before and after."""

    name: str
    base: Array
    chain: Array
    bodies: Capsules
    points: Array
    stops: NDArray[np.int64]
    errors: tuple[ErrorVectors, ...]


@dataclass(frozen=True, eq=False)
class CellScene:
    """The cell in the tracker frame, rotated so that z points up; the tracker is at the origin.

    ``obstacles`` are points (n, 3) [m] by name, drawn as their convex hulls. ``enlarged`` is the factor by which errors
    are drawn larger.
    """

    arms: tuple[SceneArm, ...]
    obstacles: Mapping[str, Array]
    enlarged: float

    @cached_property
    def points(self) -> Array:
        """Points (n, 3) [m] of arms, stops and tracker: what a picture must show."""
        parts = [part for arm in self.arms for part in (arm.points, arm.chain, arm.bodies.start, arm.bodies.end)]
        return np.vstack([np.zeros((1, 3)), *parts])

    @property
    def message(self) -> str:
        """Sentence on the distances of the arms from the tracker, and on how much smaller the errors became."""
        sentences = []
        for arm in self.arms:
            words = f"Arm {arm.name} stands {float(np.linalg.norm(arm.base)):.1f} m from the tracker"
            if arm.errors:
                before, after = arm.errors[0], arm.errors[-1]
                words += f"; its mean error at held-out stops is {mm(before.mean_mm)} ({STAGE_WORDS[before.stage]})"
                if after is not before:
                    words += f" before and {mm(after.mean_mm)} ({STAGE_WORDS[after.stage]}) after"
            sentences.append(f"{words}.")
        return " ".join(sentences)
