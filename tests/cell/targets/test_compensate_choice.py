"""Which solution is commanded: both arms of a cooperative target together, any rotation, several arms, the reasons."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.cell.targets.command import command_record
from cellapp.cell.targets.compensate import Command, compensate, compensate_result, with_approach
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.targets import Partner, Target, WorkingConditions, load_targets
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.kinematics.chain import Geometry, flange_poses, frame_poses, smr_positions
from cellapp.robot.kinematics.transforms import rotation_zyx
from cellapp.robot.model import CellModel
from tests.postures import far_from_singular
from tests.twin import PROFILES, small_twin, with_arms

TARGETS = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())


def pose(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def term(slug: str, **values: float) -> EffectTerm:
    size = np.array(list(values.values()))
    return EffectTerm(slug, tuple(values), size, np.zeros(len(size)), ("",) * len(size), EFFECTS[slug].law())


def together(model: CellModel, q_left: np.ndarray, q_right: np.ndarray, name: str = "both") -> Target:
    """A cooperative target that both arms hold at these configurations."""
    left, right = (model.arms[name] for name in ("left", "right"))
    T_left, T_right = (
        pose(arm.predict(q[None])[0], arm.flange(q[None])[0][0]) for arm, q in ((left, q_left), (right, q_right))
    )
    first, relative = np.linalg.inv(left.geometry.T_M_B()) @ T_left, np.linalg.inv(T_left) @ T_right
    return Target(
        name=name,
        arm="left",
        position=tuple(first[:3, 3].tolist()),
        rpy=rpy_of(first),
        partner=Partner(arm="right", position=tuple(relative[:3, 3].tolist()), rpy=rpy_of(relative)),
    )


def rpy_of(T: np.ndarray) -> tuple[float, float, float]:
    R = T[:3, :3]
    return (
        math.atan2(R[2, 1], R[2, 2]),
        math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0])),
        math.atan2(R[1, 0], R[0, 0]),
    )


def safe_pairs(run: RunFile, model: CellModel, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Configurations of both arms that were measured together, and that the gate admits."""
    cell = cell_bodies(run.profile, model)
    left, right = run.readings("left"), run.readings("right")
    pairs = [(p, q) for p, q in zip(left.q, right.q, strict=True) if not refuse_stop(cell, {"left": p, "right": q})]
    return pairs[:n]


def test_both_arms_of_a_cooperative_target_hold_it(run: RunFile, model: CellModel) -> None:
    pairs = safe_pairs(run, model, 6)
    targets = [together(model, *pair, name=f"both-{k}") for k, pair in enumerate(pairs)]
    commands = compensate(run.profile, model, [TARGETS[0], *targets])
    assert [(command.target.name, command.arm) for command in commands][:3] == [
        (TARGETS[0].name, "left"),
        ("both-0", "left"),
        ("both-0", "right"),
    ]
    cell = cell_bodies(run.profile, model)
    reached = 0
    for one, other in zip(commands[1::2], commands[2::2], strict=True):
        assert (command_record(one).partner, command_record(other).partner) == ("right", "left")
        assert one.refusal == other.refusal
        if one.q_compensated is None or other.q_compensated is None:
            continue
        reached += 1
        assert one.q_nominal is not None
        assert other.q_nominal is not None
        assert refuse_stop(cell, {"left": one.q_compensated, "right": other.q_compensated}) == ""
        assert refuse_stop(cell, {"left": one.q_nominal, "right": other.q_nominal}) == ""
        assert_reached(model, one)
        assert_reached(model, other)
        assert one.expected_M is not None
        assert other.expected_M is not None
        wanted = np.linalg.norm(one.target.partner.position) if one.target.partner else 0.0
        assert np.linalg.norm(one.expected_M - other.expected_M) == pytest.approx(wanted)
        assert one.conditions is not None
        assert one.conditions.other_q is not None
        np.testing.assert_allclose(one.conditions.other_q[0], other.q_compensated, atol=5e-4, err_msg="but for play")
    assert reached >= 4
    records = compensate_result(commands).targets
    assert {entry.partner for entry in records} == {"", "left", "right"}


def assert_reached(model: CellModel, command: Command) -> None:
    assert command.q_compensated is not None
    assert command.expected_M is not None
    assert command.residual_um is not None
    predicted = model.arms[command.arm].predict(command.q_compensated[None], conditions=command.conditions)[0]
    assert np.linalg.norm(predicted - command.expected_M) < 1e-8
    assert command.residual_um < 1e-2


def test_arms_that_act_on_each_other_are_solved_together(run: RunFile, model: CellModel) -> None:
    coupled = {
        name: dataclasses.replace(arm, effects=(pedestal_coupling(model, name),)) for name, arm in model.arms.items()
    }
    changed = dataclasses.replace(model, arms=coupled)
    pairs = safe_pairs(run, model, 6)
    regular = (
        pair
        for pair in pairs
        if all(far_from_singular(arm.geometry, q[None])[0] for arm, q in zip(model.arms.values(), pair, strict=True))
    )
    target = together(changed, *next(regular))
    one, other = compensate(run.profile, changed, [target])
    assert one.refusal == ""
    assert_reached(changed, one)
    assert_reached(changed, other)
    assert one.conditions is not None
    alone = changed.arms["left"].predict(np.asarray(one.q_compensated)[None])[0]
    assert np.linalg.norm(alone - np.asarray(one.expected_M)) > 1e-6, "the other arm matters"


def pedestal_coupling(model: CellModel, name: str) -> EffectTerm:
    arm = model.arms[name]
    effect = EFFECTS["pedestal_coupling"]
    law = effect.law("", {"mean_x": 0.0, "mean_y": 0.0, "mean_z": 0.0})
    column = effect.columns(arm.context(np.zeros((1, arm.geometry.joints))), law)[0]
    return dataclasses.replace(term("backlash", **{column.name: 1e-6}), slug="pedestal_coupling", law=law)


def test_if_one_arm_cannot_both_are_refused(run: RunFile, model: CellModel) -> None:
    target = together(model, *safe_pairs(run, model, 1)[0])
    assert target.partner is not None
    far = target.model_copy(update={"partner": target.partner.model_copy(update={"position": (4.0, 0.0, 0.0)})})
    one, other = compensate(run.profile, model, [far])
    assert one.refusal == other.refusal
    assert one.refusal.startswith("arm right: out of reach")
    assert one.q_compensated is None
    assert other.q_compensated is None
    collision = target.model_copy(
        update={
            "name": "meet",
            "partner": target.partner.model_copy(update={"position": (0.0, 0.0, 0.01), "rpy": None}),
        }
    )
    meeting, _ = compensate(run.profile, model, [collision])
    assert "arms left and right" in meeting.refusal or "arm right" in meeting.refusal


def test_any_rotation(run: RunFile, model: CellModel) -> None:
    free = [target.model_copy(update={"rpy": None}) for target in TARGETS[:6]]
    bound = compensate(run.profile, model, TARGETS[:6])
    homes = home_positions(run.profile)
    nearer = seen = 0
    for command, with_rotation in zip(compensate(run.profile, model, free), bound, strict=True):
        assert command.refusal == ""
        assert command.residual_urad is None
        assert_reached(model, command)
        assert command.q_nominal is not None
        nominal = smr_positions(model.arms["left"].nominal, command.q_nominal[None])[0]
        np.testing.assert_allclose(nominal, np.asarray(command.nominal_M), atol=1e-8)
        seen += bool(command.visible)
        if with_rotation.q_nominal is not None:
            reach = [np.abs(one - homes["left"]).max() for one in (command.q_nominal, with_rotation.q_nominal)]
            nearer += int(reach[0] <= reach[1])
    assert seen >= 5, "the tracker sees each with some rotation"
    assert nearer >= 3, "freedom is used"


def test_one_arm_and_three(run: RunFile, model: CellModel) -> None:
    alone = run.profile.model_copy(update={"arms": {"left": run.profile.arms["left"]}})
    own = [target for target in TARGETS if target.arm == "left"][:4]
    for command in compensate(alone, CellModel(arms={"left": model.arms["left"]}), own):
        assert_reached(model, command)
    profile, three = with_third_arm(run.profile, model)
    for command in compensate(profile, three, [*own, own[0].model_copy(update={"name": "third", "arm": "third"})]):
        assert command.refusal == ""
        assert_reached(three, command)


def with_third_arm(profile: Profile, model: CellModel) -> tuple[Profile, CellModel]:
    """A copy of the left arm, ten metres to the side."""
    left = profile.arms["left"]
    assert left.base is not None
    x, y, z = left.base.position
    third = left.model_copy(update={"base": left.base.model_copy(update={"position": (x, y + 10.0, z)})})
    T = model.arms["left"].geometry.T_M_B()
    T[1, 3] -= 10.0
    moved = dataclasses.replace(
        model.arms["left"],
        geometry=model.arms["left"].geometry.with_T_M_B(T),
        nominal=model.arms["left"].nominal.with_T_M_B(T),
    )
    return (
        profile.model_copy(update={"arms": {**profile.arms, "third": third}}),
        dataclasses.replace(model, arms={**model.arms, "third": moved}),
    )


def test_reasons_name_joints_and_sizes(run: RunFile, model: CellModel) -> None:
    narrow = with_arms(run.profile, limits=((-0.1, 0.1),) * 6, home=(0.0,) * 6)
    (command,) = compensate(narrow, model, TARGETS[:1])
    assert command.refusal.startswith("beyond limits: joint ")
    assert "outside its limits -5.7 to 5.7 deg" in command.refusal
    assert command.branches == 0
    arm = model.arms["left"]
    q = np.array([0.3, -1.2, 0.9, -1.0, 1e-4, 0.2])  # axes 4 and 6 all but parallel
    T = np.linalg.inv(arm.nominal.T_M_B())
    R = T[:3, :3] @ rotation_of(arm.nominal, q)
    position = T[:3, :3] @ smr_positions(arm.nominal, q[None])[0] + T[:3, 3]
    target = Target(name="it", arm="left", position=tuple(position.tolist()), rpy=rpy_of(pose(position, R)))
    (singular,) = compensate(run.profile, model, [target])
    assert singular.refusal == "" or singular.refusal.startswith("singular: joints ")
    assert compensate(run.profile, model, []) == ()


def rotation_of(geometry: Geometry, q: np.ndarray) -> np.ndarray:
    return np.asarray(flange_poses(geometry, q[None])[0][0])


def test_stated_conditions_are_used_and_kept_for_the_way(run: RunFile, model: CellModel) -> None:
    arm = dataclasses.replace(
        model.arms["left"],
        effects=(term("backlash", half_play2=2e-4), term("joint_compliance", compliance2=1.0 / 6e4)),
        posterior=None,
    )
    changed = dataclasses.replace(model, arms={**model.arms, "left": arm})
    plain = TARGETS[0]
    heavy = plain.model_copy(update={"name": "heavy", "conditions": WorkingConditions(payload=8.0)})
    from_above = plain.model_copy(update={"name": "side", "approach": (0, 1, 0, 0, 0, 0)})
    first, loaded, sided = compensate(run.profile, changed, [plain, heavy, from_above])
    for command in (first, loaded, sided):
        assert_reached(changed, command)
    q, q_loaded, q_sided = (np.asarray(command.q_compensated) for command in (first, loaded, sided))
    assert np.abs(q_loaded - q).max() > 1e-5
    assert first.side == (0, int(np.sign(q[1] - home_positions(run.profile)["left"][1])), 0, 0, 0, 0)
    assert (q_sided - q)[1] == pytest.approx(2e-4 * (1 - first.side[1]), rel=0.01, abs=1e-6), "from above"
    here = q - 0.3
    for command in (first, loaded, sided):
        sent = with_approach(arm, np.asarray(command.q_compensated), here, command.conditions)
        assert command.conditions is not None
        driven = dataclasses.replace(command.conditions, approach=np.ones((1, 6)))
        reached = arm.predict(sent[None], conditions=driven)[0]
        np.testing.assert_allclose(reached, np.asarray(command.expected_M), atol=1e-9)
    assert compensate_result([sided]).targets[0].approach == (0, 1, 0, 0, 0, 0)


def test_outside_the_readings_is_a_note(run: RunFile, model: CellModel) -> None:
    q = run.readings("left").q
    ranges = {"left": ConditionRanges(q=np.stack([q.min(axis=0), np.minimum(q.max(axis=0), -0.5)]))}
    commands = compensate(run.profile, model, TARGETS[:8], ranges=ranges)
    notes = [command.note for command in commands if not command.refusal]
    assert any(note.startswith("outside the calibrated joint ranges: joint ") for note in notes)
    assert any("this adds" in note for note in notes)


def test_nominal_and_compensated_commands_are_of_the_same_branch(run: RunFile, model: CellModel) -> None:
    for command in compensate(run.profile, model, TARGETS[:10]):
        if command.q_nominal is None or command.q_compensated is None:
            continue
        assert np.abs(command.q_nominal - command.q_compensated).max() < 0.2
        assert command.target.rpy is not None
        roll, pitch, yaw = command.target.rpy
        nominal = model.arms[command.arm].nominal
        wanted = nominal.T_M_B()[:3, :3] @ rotation_zyx(yaw, pitch, roll)
        np.testing.assert_allclose(rotation_of(nominal, command.q_nominal), wanted, atol=1e-9)
        assert command.branches is not None
        assert 1 <= command.branches <= 8


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), None], ids=["pose", "position"])
def test_out_of_reach_by_how_much(run: RunFile, model: CellModel, rpy: tuple[float, float, float] | None) -> None:
    """A position three times as far from the shoulder as a stretched arm is."""
    nominal = model.arms["left"].nominal
    q = np.array([[0.3, -0.7, 1e-9, -1.5, 1.1, 0.4]])
    _, origins = frame_poses(nominal, q)
    smr = smr_positions(nominal, q)[0]
    outwards = smr - origins[1, 0]
    far = nominal.T_M_B()
    position = np.linalg.inv(far) @ np.append(smr + 2.0 * outwards, 1.0)
    target = Target(name="far", arm="left", position=tuple(position[:3].tolist()), rpy=rpy)
    (command,) = compensate(run.profile, model, [target])
    missed_mm = float(command.refusal.split(" mm")[0].split()[-1])
    assert command.refusal.startswith("out of reach")
    shortest = 1e3 * (3.0 * np.linalg.norm(outwards) - longest_reach(nominal))
    assert shortest - 1.0 < missed_mm
    if rpy is None:
        assert missed_mm < 1e3 * 2.0 * np.linalg.norm(outwards) + 1.0


def longest_reach(geometry: Geometry) -> float:
    """Upper bound on the distance of the SMR from the shoulder [m]: the length of the chain beyond it."""
    lengths = np.hypot(geometry.rows[1:, 1], geometry.rows[1:, 2])
    return float(lengths.sum() + np.linalg.norm(geometry.tool))
