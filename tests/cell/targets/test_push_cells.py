"""Pushing in cells that nobody tried: one arm, three arms, seven joints, each with a model that is exact."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from cellapp.cell.driving.push import push
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.targets import load_targets
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel
from tests.cell.planning.planned_cells import one_arm, seven_joints, three_arms
from tests.cell.targets.pairs import pair_targets
from tests.twin import PROFILES, small_twin

TARGETS = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())


def exact(profile: Profile) -> tuple[Profile, CellModel]:
    """The profile's cell without any error of its geometry, and the nominal model of it."""
    assert profile.plant is not None
    assert profile.tracker.pose is not None
    zero = profile.plant.geometry.model_copy(update=dict.fromkeys(type(profile.plant.geometry).model_fields, 0.0))
    plant = profile.plant.model_copy(update={"geometry": zero, "effects": {}})
    profile = profile.model_copy(update={"plant": plant})
    return profile, CellModel({name: nominal_model(profile, name) for name in profile.arms})


@pytest.mark.parametrize("cell", [one_arm, three_arms, seven_joints])
def test_single_targets_are_driven_and_corrected_in_other_cells(cell: Callable[[], Profile]) -> None:
    profile, model = exact(cell())
    targets = [target for target in TARGETS if target.arm == "left"][:3]
    found = push(profile, model, compensate(profile, model, targets), verify=True, rounds=2)
    assert [target.note for target in found.targets] == ["", "", ""]
    assert found.pairs == ()
    assert found.arms["left"].compensated_mm.mean < 40e-3
    assert found.arms["left"].corrected_mm is not None


def test_a_third_arm_waits_at_home_while_two_hold_a_target(run: RunFile) -> None:
    profile, model = exact(three_arms())
    pairs = pair_targets(run, model, [0, 5])
    third = TARGETS[20].model_copy(update={"arm": "third", "name": "third"})
    found = push(profile, model, compensate(profile, model, (pairs[0], third, pairs[1])), verify=True)
    assert [pair.arms for pair in found.pairs] == [("left", "right")] * 2
    assert [pair.note for pair in found.pairs] == ["", ""]
    assert max(pair.compensated_mm for pair in found.pairs if pair.compensated_mm is not None) < 0.1
