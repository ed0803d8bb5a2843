"""Cooperative targets on the simulated cell: both arms go there, both SMRs are measured while both rest."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.motion import Mover
from cellapp.cell.driving.push import push
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.records import ArmVerification, MeasuredPair, VerifyResult
from cellapp.commands.compensate.words import verify_lines
from cellapp.commands.push.run import judge_of
from cellapp.ground.results import ErrorSummary
from cellapp.robot.model import CellModel
from tests.cell.targets.pairs import pair_targets, stops_with_room
from tests.twin import plant_of


@pytest.fixture(scope="module")
def stops(run: RunFile, model: CellModel) -> list[int]:
    return stops_with_room(run, model, 4)


@pytest.fixture(scope="module")
def pairs(run: RunFile, model: CellModel, stops: list[int]) -> list[Command]:
    return list(compensate(run.profile, model, pair_targets(run, model, stops, tolerance=2e-3)))


def test_both_arms_are_measured_at_each_cooperative_target(
    run: RunFile, model: CellModel, stops: list[int], pairs: list[Command], cells: list[Any]
) -> None:
    found = push(run.profile, model, pairs, verify=True, judge=judge_of(run, run.profile))
    assert [(target.name, target.arm, target.partner, target.note) for target in found.targets] == [
        (f"pair-{stop}", name, other, "") for stop in stops for name, other in (("left", "right"), ("right", "left"))
    ]
    assert [(pair.name, pair.arms, pair.note) for pair in found.pairs] == [
        (f"pair-{stop}", ("left", "right"), "") for stop in stops
    ]
    for pair, (left, right) in zip(found.pairs, zip(found.targets[::2], found.targets[1::2])):
        measured, wanted = (
            1e3 * math.dist(points[0], points[1])
            for points in ((left.measured_M, right.measured_M), (left.wanted_M, right.wanted_M))
            if points[0] is not None and points[1] is not None
        )
        assert pair.wanted_mm == pytest.approx(wanted)
        assert pair.compensated_mm == pytest.approx(abs(measured - wanted))
        assert pair.verdict == "in"
        assert left.within_mm is not None
        assert 0.02 < left.within_mm < 0.5
        assert left.measured_M is not None
        assert left.predicted_M is not None
        assert math.dist(left.measured_M, left.predicted_M) < 0.2e-3
    assert found.cooperative is not None
    assert found.cooperative.compensated_mm.n == len(stops)
    assert found.cooperative.nominal_mm.mean > 10.0 * found.cooperative.compensated_mm.mean
    assert found.complaints() == []
    assert any("pairs" in line or "distance" in line for line in verify_lines(found))
    (cell,) = cells
    assert plant_of(cell).clearance.arms_m > 0.0  # type: ignore[union-attr]
    for name, home in home_positions(run.profile).items():
        np.testing.assert_array_equal(plant_of(cell).q(name), home)
    assert VerifyResult.from_json(found.to_json(), "again") == found


def test_a_partner_that_cannot_go_keeps_both_at_home(
    run: RunFile, model: CellModel, pairs: list[Command], cells: list[Any]
) -> None:
    refused = replace(pairs[1], q_nominal=None, q_compensated=None, refusal="out of reach")
    found = push(run.profile, model, [pairs[0], refused, *pairs[2:4]], verify=True)
    assert [target.note for target in found.targets] == ["arm right: out of reach", "out of reach", "", ""]
    assert found.targets[0].compensated_mm is None
    assert found.pairs[0].note == "arm right: out of reach"
    assert found.pairs[0].compensated_mm is None
    assert found.pairs[1].compensated_mm is not None


def test_an_smr_that_the_tracker_does_not_see_is_not_measured(
    run: RunFile, model: CellModel, pairs: list[Command]
) -> None:
    unseen = replace(pairs[1], visible=False)
    found = push(run.profile, model, [pairs[0], unseen], verify=True)
    left, right = found.targets
    assert (left.note, right.note) == ("", "not measured: the tracker does not see the SMR there")
    assert left.compensated_mm is not None
    assert (right.compensated_mm, found.pairs[0].compensated_mm, found.cooperative) == (None, None, None)
    assert found.complaints() == ["arm right: no target could be measured"]


def test_arms_that_may_not_move_together_go_one_after_the_other(
    run: RunFile, model: CellModel, pairs: list[Command], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gate is made to refuse that two arms move at once; nothing else changes."""
    asked = Mover.refusal

    def refusal(self: Mover, *legs: Any) -> str:
        return "not at once" if any(len(leg) > 1 for leg in legs) else asked(self, *legs)

    monkeypatch.setattr(Mover, "refusal", refusal)
    found = push(run.profile, model, pairs[:2], verify=True)
    assert [target.note for target in found.targets] == ["", ""]
    assert found.pairs[0].compensated_mm is not None
    assert found.pairs[0].compensated_mm < 0.2


def test_pairs_out_of_tolerance_are_complained_about() -> None:
    small, large = (ErrorSummary(mean=mean, rms=mean, std=0.0, max=mean, n=1) for mean in (0.02, 2.0))
    pair = MeasuredPair(
        name="p1",
        arms=("left", "right"),
        wanted_mm=500.0,
        nominal_mm=2.0,
        compensated_mm=0.5,
        corrected_mm=0.2,
        tolerance_mm=0.1,
        verdict="out",
    )
    good, bad = (
        ArmVerification(nominal_mm=before, compensated_mm=after) for before, after in ((large, small), (small, large))
    )
    (complaint,) = VerifyResult(arms={}, targets=(), pairs=(pair,), cooperative=good).complaints()
    assert complaint == "1 of 1 pairs with a tolerance are out of it: p1 (0.200 mm, tolerance 0.1 mm)"
    assert len(VerifyResult(arms={}, targets=(), pairs=(), cooperative=bad).complaints()) == 1
