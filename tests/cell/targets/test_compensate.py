"""Inverting the calibrated model: exact in prediction, inside the limits, refused with a reason where it cannot be."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop, visible
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.targets import Partner, Target, load_targets
from cellapp.ground.errors import InputError
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.kinematics.transforms import rotation_zyx, zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.inverse import invert
from tests.postures import far_from_singular
from tests.sure import sure
from tests.twin import PROFILES, altered, small_twin, with_arms

TARGETS = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())


def term(slug: str, **values: float) -> EffectTerm:
    size = np.array(list(values.values()))
    return EffectTerm(slug, tuple(values), size, np.zeros(len(size)), ("",) * len(size), EFFECTS[slug].law())


COMPLIANCE = term("joint_compliance", compliance2=1.0 / 6e4, compliance3=1.0 / 3e4, compliance5=1.0 / 1e4)


def with_effects(model: CellModel, name: str, *terms: EffectTerm) -> ArmModel:
    return dataclasses.replace(model.arms[name], effects=terms)


def test_commands_are_inside_the_limits_safe_and_seen(
    run: RunFile, model: CellModel, commands: tuple[Command, ...]
) -> None:
    bodies, home = cell_bodies(run.profile, model), home_positions(run.profile)
    for one in (command.record for command in commands):
        others = {other: q[None] for other, q in home.items() if other != one.arm}
        for q in () if one.refusal else (one.q_nominal, one.q_compensated):
            assert refuse_stop(bodies, {**home, one.arm: np.array(sure(q))}) == ""
        if one.q_compensated is not None:
            assert one.visible == visible(bodies, one.arm, np.array([one.q_compensated]), others)[0]
    assert sum(command.record.visible or False for command in commands) >= 30


class Waves:
    """A correction in the base frame that varies with the joints, as a residual network's does."""

    def correct(self, q: np.ndarray) -> np.ndarray:
        return 3e-4 * np.sin(q[:, :3])


def test_what_the_network_adds_is_aimed_off_for(model: CellModel, commands: tuple[Command, ...]) -> None:
    network: Any = Waves()
    arm = dataclasses.replace(with_effects(model, "left", COMPLIANCE), network=network)
    q = np.array([c.record.q_nominal for c in commands if c.target.arm == "left" and c.record.q_nominal is not None])
    q = q[np.abs(np.sin(q[:, 4])) > 0.2]
    rotation, _ = arm.flange(q)
    back = invert(arm, arm.predict(q), rotation, q + 1e-3)
    bare = arm.predict(q) - with_effects(model, "left", COMPLIANCE).predict(q)
    assert np.linalg.norm(bare, axis=1).min() > 1e-5
    assert len(q) >= 5
    assert back.reached.all()
    np.testing.assert_allclose(arm.predict(back.q), arm.predict(q), atol=1e-9)


def one(arm: str, position: tuple[float, float, float], rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Target:
    return Target(name="it", arm=arm, position=position, rpy=rpy)


def test_out_of_reach_out_of_sight_and_unsafe(run: RunFile, model: CellModel) -> None:
    looking_away = []
    for target in TARGETS[:8]:
        roll, pitch, yaw = target.rpy or (0.0, 0.0, 0.0)
        z, y, x = zyx_angles(rotation_zyx(yaw, pitch, roll) @ np.diag([1.0, -1.0, -1.0]))
        looking_away.append(target.model_copy(update={"rpy": (x, y, z)}))
    refused = compensate(run.profile, model, [*looking_away, one("left", (3.0, 0.0, 0.5))])
    assert refused[-1].record.refusal.startswith("out of reach: ")
    assert refused[-1].expected_M is None
    hidden = [command for command in refused[:-1] if not command.record.refusal]
    assert len(hidden) >= 3, "production needs no tracker"
    assert not any(command.record.visible for command in hidden)
    high = altered(run.profile, plan={"floor": 0.05})
    refusals = [command.record.refusal for command in compensate(high, model, TARGETS)]
    assert any("the floor" in refusal for refusal in refusals)
    entry = json.loads(refused[-1].record.model_dump_json())
    place = {"name": "it", "arm": "left", "position": [3.0, 0.0, 0.5], "rpy": [0.0, 0.0, 0.0], "tolerance_mm": None}
    nothing = {"q_nominal": None, "q_compensated": None, "uncertainty_mm": None, "verdict": ""}
    expected = {**place, **nothing}
    assert {name: entry[name] for name in expected} == expected
    assert entry["refusal"] == refused[-1].record.refusal


@pytest.mark.parametrize("middle", [-1.5 * math.pi, 1.5 * math.pi])
def test_whole_turns_bring_a_joint_into_its_limits(run: RunFile, model: CellModel, middle: float) -> None:
    """The last joint may only stand beyond half a turn: the same postures, a turn further on."""
    limits = tuple([(-2 * math.pi, 2 * math.pi)] * 5 + [(middle - 0.5 * math.pi, middle + 0.5 * math.pi)])
    profile = altered(run.profile, arms={"left": {"limits": limits}})
    reached = 0
    for command in compensate(profile, model, TARGETS[:10]):
        if command.record.q_compensated is not None and command.record.q_nominal is not None:
            reached += 1
            for q in (command.record.q_compensated, command.record.q_nominal):
                assert abs(q[5] - middle) <= 0.5 * math.pi
            predicted = model.predict(command.target.arm, np.array([command.record.q_compensated]))[0]
            np.testing.assert_allclose(predicted, sure(command.expected_M), atol=1e-9)
        else:
            assert command.record.refusal
    assert reached >= 3


def test_a_profile_or_calibration_that_does_not_fit(run: RunFile, model: CellModel) -> None:
    with pytest.raises(InputError, match=r"arms\.left\.home is needed"):
        compensate(with_arms(run.profile, home=None), model, TARGETS)
    with pytest.raises(InputError, match=r"arms\.left\.base and tracker\.pose are needed"):
        compensate(with_arms(run.profile, base=None), model, TARGETS)
    with pytest.raises(InputError, match="the calibration is of arms left, the profile of arms left, right"):
        compensate(run.profile, CellModel(arms={"left": model.arms["left"]}), TARGETS)


# -- Which solution is commanded: both arms of a cooperative target together, any rotation, several arms, the reasons --


def pose(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


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
    assert [(command.target.name, command.record.arm) for command in commands][:3] == [
        (TARGETS[0].name, "left"),
        ("both-0", "left"),
        ("both-0", "right"),
    ]
    cell = cell_bodies(run.profile, model)
    reached = 0
    for one, other in zip(commands[1::2], commands[2::2], strict=True):
        left, right = one.record, other.record
        assert (left.partner, right.partner) == ("right", "left")
        assert left.refusal == right.refusal
        if left.q_compensated is None or right.q_compensated is None:
            continue
        reached += 1
        assert refuse_stop(cell, {"left": np.array(left.q_compensated), "right": np.array(right.q_compensated)}) == ""
        assert refuse_stop(cell, {one.arm: np.array(sure(one.q_nominal)) for one in (left, right)}) == ""
        assert_reached(model, one)
        assert_reached(model, other)
        wanted = np.linalg.norm(one.target.partner.position) if one.target.partner else 0.0
        assert np.linalg.norm(sure(one.expected_M) - sure(other.expected_M)) == pytest.approx(wanted)
        assert one.conditions is not None
        assert one.conditions.other_q is not None
        np.testing.assert_allclose(one.conditions.other_q[0], right.q_compensated, atol=5e-4, err_msg="but for play")
    assert reached >= 4
    assert {one.record.partner for one in commands} == {"", "left", "right"}


def assert_reached(model: CellModel, command: Command) -> None:
    q = np.array([command.record.q_compensated])
    predicted = model.arms[command.record.arm].predict(q, conditions=command.conditions)[0]
    assert np.linalg.norm(predicted - sure(command.expected_M)) < 1e-8
    assert sure(command.record.residual_um) < 1e-2


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
    assert one.record.refusal == ""
    assert_reached(changed, one)
    assert_reached(changed, other)
    assert one.conditions is not None
    alone = changed.arms["left"].predict(np.asarray(one.record.q_compensated)[None])[0]
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
    far = altered(target, partner={"position": (4.0, 0.0, 0.0)})
    one, other = compensate(run.profile, model, [far])
    assert one.record.refusal == other.record.refusal
    assert one.record.refusal.startswith("arm right: out of reach")
    assert one.record.q_compensated is None
    assert other.record.q_compensated is None
    collision = altered(target, name="meet", partner={"position": (0.0, 0.0, 0.01), "rpy": None})
    meeting, _ = compensate(run.profile, model, [collision])
    assert "arms left and right" in meeting.record.refusal or "arm right" in meeting.record.refusal
