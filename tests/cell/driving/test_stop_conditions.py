"""Collection follows the conditions of a stop: start of the last step, rest, and the gate before either."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, one_by_one, open_cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.motion import Mover
from cellapp.cell.driving.reaction import StopReaction
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.planning.planned_stops import STOP_CONDITIONS_RESULT, StopConditions, stop_conditions_json
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.ground.progress import Cancelled, CancelToken
from drivers.arms.simulated import SimulatedArm
from drivers.clock import RealClock
from tests.twin import small_twin


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(small_twin(3))


class Moves:
    """Goals that were sent to the simulated arms."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.goals: list[tuple[str, np.ndarray]] = []
        moves = self

        class Arm(SimulatedArm):
            def start_move(self, q: Any, *rest: Any) -> None:
                moves.goals.append((self.name, np.array(q)))
                super().start_move(q, *rest)

        monkeypatch.setattr("drivers.arms.simulated.SimulatedArm", Arm)

    def went(self, name: str, q: np.ndarray) -> bool:
        return any(arm == name and np.allclose(goal, q) for arm, goal in self.goals)


def test_nothing_moves_that_the_gate_refuses(
    plan: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves = Moves(monkeypatch)
    few = {name: q[:3] for name, q in plan.items()}
    into_the_floor = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    beyond = few["right"][2] + 20.0
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_plan(few)
        conditions = {1: {"left": StopConditions(into_the_floor)}, 2: {"right": StopConditions(beyond, 1.0)}}
        run.write_result(STOP_CONDITIONS_RESULT, stop_conditions_json(conditions))
        notes = collect_run(run).notes
        assert run.stops_done() == {0}
        assert [note[:34] for note in notes[:2]] == [
            "stop 2: left out: refused to move:",
            "stop 3: left out: refused to move:",
        ]
        assert "floor" in notes[0]
        assert "limits" in notes[1]
        assert [event.text for event in run.events() if event.level == "warning"] == list(notes[:2])
    assert not moves.went("left", into_the_floor)
    assert not moves.went("right", beyond)
    for name in few:
        assert not moves.went(name, few[name][1])
        assert not moves.went(name, few[name][2])


def test_via_and_dwell_of_one_arm_are_honoured(
    plan: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves = Moves(monkeypatch)
    few = {name: q[:2] for name, q in plan.items()}
    via = few["left"][1] - 0.03
    with RunFile.create(tmp_path / "run", small_twin(2)) as run:
        run.write_plan(few)
        conditions = {1: {"left": StopConditions(via, 30.0), "right": StopConditions()}}
        run.write_result(STOP_CONDITIONS_RESULT, stop_conditions_json(conditions))
        collect_run(run)
        left, right = run.readings("left"), run.readings("right")
    assert left.step is not None
    assert right.step is not None
    assert left.dwell_s is not None
    assert right.dwell_s is not None
    np.testing.assert_allclose(left.step[1], 0.03, atol=1e-9)
    np.testing.assert_allclose(right.step[1], few["right"][1] - few["right"][0], atol=1e-9)
    home = home_positions(small_twin(2))
    np.testing.assert_allclose(left.step[0], few["left"][0] - home["left"], atol=1e-9)
    assert moves.went("left", via)
    assert 30.0 < left.dwell_s[1] < 33.0
    assert right.dwell_s[1] < 6.0, "the arm without a rest is measured first"
    assert left.time_s[1] > right.time_s[1]
    assert 0.0 < left.dwell_s[0] < 6.0


def test_the_rest_of_a_real_arm_ends_on_cancellation() -> None:
    profile = small_twin(2)
    with open_cell(profile) as cell:
        real = Cell(cell.arms, cell.tracker, RealClock())
        reaction = StopReaction(cell.arms, cell.tracker, one_by_one)
        mover, token = Mover(profile, real, cell_bodies(profile), reaction), CancelToken()
        mover.rest("left", 0.0, token)
        token.cancel()
        with pytest.raises(Cancelled):
            mover.rest("left", 600.0, token)
