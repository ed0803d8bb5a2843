"""Somebody who walks through the tracker's beam while a simulated arm moves along a path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from cellapp.cell.driving.cell import Cell
from drivers.arms.simulated import SimulatedArm
from drivers.trackers.simulated import SimulatedTracker
from tests.twin import plant_of

_CROSSED_S = 1.5


def crossed_beam(
    monkeypatch: pytest.MonkeyPatch, cells: Sequence[Cell], name: str, after_s: float, times: int = 1
) -> list[float]:
    """Let somebody walk through the beam to arm ``name`` in the first ``times`` paths that it moves along.

    ``cells`` holds the cell once it is open. Each time the beam is covered ``after_s`` [s] after the beginning of the
    path, for 1.5 s. Gives the times [s] at which it was, as they come.
    """
    start = SimulatedArm.start_path
    crossed: list[float] = []

    def started(arm: SimulatedArm, q: Any, period_s: float) -> None:
        plant, tracker = plant_of(cells[0]), cells[0].tracker
        assert isinstance(tracker, SimulatedTracker)

        def cross() -> None:
            tracker.covered.add(name)
            plant.schedule.at(plant.clock_s + _CROSSED_S, tracker.covered.clear)
            crossed.append(plant.clock_s)

        if arm.name == name and len(crossed) < times:
            plant.schedule.at(plant.clock_s + after_s, cross)
        start(arm, q, period_s)

    monkeypatch.setattr(SimulatedArm, "start_path", started)
    return crossed
