"""Detect suspicions from reference measurements: fixed nests, and the arms at the reference stop."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from cellapp.ground.progress import Suspicion
from cellapp.robot.kinematics.transforms import Array


class ReferenceWatch:
    """Judges reference measurements, each against the previous one (a jump) and against the first one (drift).

    Drift of a reference is raised once until it is within the limit again.

    Parameters
    ----------
    limit_m : float
        Largest accepted displacement [m].
    """

    def __init__(self, limit_m: float) -> None:
        self._limit_m = limit_m
        self._first: dict[str, Array] = {}
        self._last: dict[str, Array] = {}
        self._drifted: set[str] = set()

    def at_reference(self, points_M: Mapping[str, Array], arms: Collection[str]) -> tuple[Suspicion, ...]:
        """Return suspicions from the references' positions (3,) [m]; names in ``arms`` are arms, the others nests."""
        jumps = self._beyond(points_M, self._last)
        beyond = {name: size for name, size in self._beyond(points_M, self._first).items() if name not in jumps}
        drifts = {name: size for name, size in beyond.items() if name not in self._drifted}
        self._drifted = (self._drifted - points_M.keys()) | beyond.keys()
        shared = len(self._last.keys() & points_M.keys())
        for name, point in points_M.items():
            if name in jumps or name not in self._first:  # raise a jump once: later points are relative to this one
                self._first[name] = point
            self._last[name] = point
        fixed = [name for name in jumps if name not in arms]
        if jumps and len(jumps) == shared and (fixed or len(jumps) > 1):
            text = f"all references moved by {_largest_mm(jumps)} since the last time: was the tracker touched?"
            return (Suspicion("tracker moved", text), *_drifts(drifts, arms))
        return (*(_jump(name, size, arms) for name, size in jumps.items()), *_drifts(drifts, arms))

    def _beyond(self, points_M: Mapping[str, Array], before: Mapping[str, Array]) -> dict[str, float]:
        away = {name: float(np.linalg.norm(point - before[name])) for name, point in points_M.items() if name in before}
        return {name: size for name, size in away.items() if size > self._limit_m}


def _jump(name: str, size: float, arms: Collection[str]) -> Suspicion:
    if name in arms:
        text = (
            f"{name}: its SMR at the reference stop moved by {size * 1e3:.2f} mm since the last time: check that it"
            " sits firmly"
        )
        return Suspicion("loose SMR", text, name.removeprefix("arm "))
    return Suspicion("loose SMR", f"{name} moved by {size * 1e3:.2f} mm since the last time: check it")


def _drifts(drifts: Mapping[str, float], arms: Collection[str]) -> tuple[Suspicion, ...]:
    if not drifts:
        return ()
    arm = next(iter(drifts)) if len(drifts) == 1 and next(iter(drifts)) in arms else None
    text = f"{', '.join(sorted(drifts))}: drifted by {_largest_mm(drifts)} since the first time: check warm-up and air"
    return (Suspicion("drift", text, None if arm is None else arm.removeprefix("arm ")),)


def _largest_mm(sizes: Mapping[str, float]) -> str:
    return f"{max(sizes.values()) * 1e3:.2f} mm"
