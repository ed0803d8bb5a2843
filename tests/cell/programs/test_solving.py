"""Corrections of single targets: exact by the model, on the branch of the controller, refused with a reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cellapp.cell.programs.records import CorrectedTarget, CorrectResult
from cellapp.cell.programs.script_targets import read_script
from cellapp.cell.programs.solving import (
    Workplace,
    aim,
    controller_chain,
    flange_of,
    nearest_vector,
    outside,
    rewritten,
    solve_targets,
    true_flange,
)
from cellapp.cell.programs.urscript import pose_matrix, pose_numbers
from cellapp.commands.correct import correct_table
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import rotation_vectors
from cellapp.robot.model import ArmModel
from tests.arms import OFF_AXIS, UR10, UR10_CENTERS, UR10_MASSES, at_station, true_geometry

pytestmark = pytest.mark.fast

Array = NDArray[np.float64]
HOME = np.array([0.3, -1.4, 1.6, -1.7, 1.2, 0.4])
TCP = (0.02, -0.03, 0.15, 0.1, 0.2, 0.3)
LIMITS = np.tile([-2.0 * np.pi, 2.0 * np.pi], (6, 1))


def term(slug: str, **values: float) -> EffectTerm:
    size = np.array(list(values.values()))
    return EffectTerm(slug, tuple(values), size, np.zeros(len(size)), ("",) * len(size), EFFECTS[slug].law())


COMPLIANCE = term("joint_compliance", compliance2=1.0 / 6e4, compliance3=1.0 / 3e4, compliance5=1.0 / 1e4)
ECCENTRICITY = term("encoder_eccentricity", cos1q1=8e-5, sin1q1=-5e-5, sin1q4=2e-4)
SCALE = term("tracker_scale", scale=1e-5)


def arm_model(seed: int | None = 1, *effects: EffectTerm, network: Any = None) -> ArmModel:
    nominal = at_station(UR10, OFF_AXIS)
    true = nominal if seed is None else true_geometry(nominal, np.random.default_rng(seed))
    bodies = Bodies(UR10_MASSES, UR10_CENTERS, 2.0, np.array([0.0, 0.0, 0.05]))
    return ArmModel(true, nominal, bodies, np.array([0.1, 0.0, 0.99498744]), effects, network)


def place(arm: ArmModel, **changes: Any) -> Workplace:
    own = Workplace(arm, LIMITS, HOME, np.array([HOME - 1.0, HOME + 1.0]), 7, None, extrapolate=False)
    return replace(own, **changes)


def tcp_pose(q: Array) -> tuple[float, ...]:
    return pose_numbers(flange_of(controller_chain(arm_model()), q[None])[0] @ pose_matrix(TCP))


def solved(source: str, workplace: Workplace) -> list[CorrectedTarget]:
    return solve_targets(workplace, read_script(source.encode(), "a", TCP).targets)


def pose_text(q: Array) -> str:
    return f"p{[round(value, 9) for value in tcp_pose(q)]}"


def joints(result: CorrectedTarget) -> Array:
    assert result.q_new is not None, result.reason
    return np.array(result.q_new)


class Waves:
    """A correction in the base frame that varies with the joints, as a residual network's does."""

    def correct(self, q: Array) -> Array:
        return 3e-4 * np.sin(q[:, :3])

    def spread(self, q: Array) -> Array:
        return np.zeros((len(q), 3))


MODELS = [arm_model(), arm_model(2, COMPLIANCE, ECCENTRICITY), arm_model(3, COMPLIANCE, network=Waves())]


@pytest.mark.slow
@pytest.mark.parametrize("arm", MODELS)
def test_the_model_puts_the_flange_where_the_program_means(arm: ArmModel) -> None:
    q = HOME + np.random.default_rng(0).uniform(-0.5, 0.5, (20, 6))
    results = solved("\n".join(f"movel({pose_text(one)})\nmovej({one.tolist()})" for one in q), place(arm))
    assert not any(one.reason for one in results)
    reached = true_flange(arm, np.array([one.q_new for one in results]), MeasurementConditions())
    wanted = arm.nominal.T_M_B() @ flange_of(controller_chain(arm), np.repeat(q, 2, axis=0))
    assert np.linalg.norm(reached[:, :3, 3] - wanted[:, :3, 3], axis=1).max() < 1e-8
    turn = rotation_vectors(wanted[:, :3, :3].transpose(0, 2, 1) @ reached[:, :3, :3])
    assert np.abs(turn).max() < 1e-8
    for pose, same in zip(results[::2], results[1::2], strict=True):
        np.testing.assert_allclose(joints(pose), joints(same), atol=1e-7)
        told = pose_numbers(flange_of(controller_chain(arm), np.array([pose.q_new]))[0] @ pose_matrix(TCP))
        np.testing.assert_allclose(pose_matrix(pose.new or ()), pose_matrix(told), atol=1e-9)


@pytest.mark.slow
@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), length=st.floats(0.0, 2e-3), angle=st.floats(0.0, 3e-3))
def test_any_arm_is_inverted_below_a_micrometre(seed: int, length: float, angle: float) -> None:
    nominal = at_station(UR10, OFF_AXIS)
    rng = np.random.default_rng(seed)
    arm = replace(arm_model(), geometry=true_geometry(nominal, rng, length, angle), effects=(COMPLIANCE,))
    q = HOME + rng.uniform(-0.4, 0.4, (5, 6))
    found = aim(arm, arm.nominal.T_M_B() @ flange_of(controller_chain(arm), q), q, MeasurementConditions())
    assert found.residual_m.max() < 1e-6
    assert found.residual_rad.max() < 1e-6
    assert np.abs(found.q - q).max() < 0.1


def test_an_arm_without_errors_leaves_the_program_byte_for_byte() -> None:
    source = f"movej({HOME.tolist()})\nmovel({pose_text(HOME + 0.1)}, v = .1)\n"
    program = read_script(source.encode(), "a", TCP)
    results = solve_targets(place(arm_model(None)), program.targets)
    assert [one.correction_mm for one in results] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert rewritten(program.text, program.targets, results) == source


def test_the_rotation_of_the_flange_follows_from_four_points() -> None:
    arm = arm_model(4, COMPLIANCE, ECCENTRICITY)
    q = HOME + np.random.default_rng(1).uniform(-0.6, 0.6, (10, 6))
    rotations, origins = arm.flange(q)
    poses = true_flange(arm, q, MeasurementConditions())
    np.testing.assert_allclose(poses[:, :3, :3], rotations, atol=1e-10)
    np.testing.assert_allclose(poses[:, :3, 3], origins, atol=1e-10)


def test_the_branch_is_the_one_the_controller_takes() -> None:
    other = np.array([0.3, -0.35, -1.6, 0.1, -1.2, 0.4 + np.pi])
    arm, wide = arm_model(), {"measured": np.array([HOME - 4.0, HOME + 4.0])}
    source = f"movel({pose_text(HOME)})"
    (near_home,) = solved(source, place(arm, **wide))
    assert near_home.nearest_to == "home"
    np.testing.assert_allclose(joints(near_home), HOME, atol=0.02)
    turned = HOME + np.array([0, 0, 0, 0, 0, -2.0 * np.pi])
    first, second = solved(f"movej({turned.tolist()})\n{source}", place(arm, **wide))
    assert second.nearest_to == "line 1"
    np.testing.assert_allclose(joints(second), turned, atol=0.02)
    (asked,) = solved(f"movej(get_inverse_kin({pose_text(other)}, qnear={other.tolist()}))", place(arm, **wide))
    assert asked.nearest_to == "qnear"
    np.testing.assert_allclose(joints(asked), other, atol=0.02)
    assert first.nearest_to == ""


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("movel(p[3, 0, 0, 0, 0, 0])", "out of reach"),
        ("movej([7, -1.4, 1.6, -1.7, 1.2, 0.4])", "position of joint 1, 401.070 deg, is beyond its limits"),
        ("movej([0.3, -1.4, 1.6, -1.7, 0.0, 0.4])", "singular posture"),
        ("movej([0.3, -1.4, 1.6, -1.7, -1.2, 0.4])", "outside the calibrated range: joint 5 at"),
    ],
)
def test_targets_without_a_correction_say_why(source: str, words: str) -> None:
    (result,) = solved(source, place(arm_model()))
    assert result.new is None
    assert words in result.reason


def test_a_shorter_arm_does_not_reach_what_the_published_one_just_does() -> None:
    arm = arm_model(None)
    rows = arm.geometry.rows.copy()
    rows[1, 2] += 2e-3
    short = replace(arm, geometry=replace(arm.geometry, rows=rows))
    (result,) = solved("movej([0.3, -1.4, 0.0, -1.7, 1.2, 0.4])", place(short, extrapolate=True))
    assert "edge of the reach: the calibrated arm stays" in result.reason


def test_only_the_position_of_the_point_on_the_way_changes() -> None:
    q = HOME + np.array([0.1, 0.05, 0, 0, 0, 0])
    via = [*tcp_pose(q)[:3], 0.0, 0.0, 0.0]
    first, second = solved(f"movec(p{via}, {pose_text(HOME)})", place(arm_model()))
    assert first.new is not None
    assert first.new[3:] == (0.0, 0.0, 0.0)
    assert first.correction_mm is not None
    assert 0.1 < first.correction_mm < 20.0
    assert second.new is not None


def test_what_moves_only_the_reading_is_not_corrected() -> None:
    source = f"movej({HOME.tolist()})"
    assert solved(source, place(arm_model(5, SCALE)))[0].new == solved(source, place(arm_model(5)))[0].new


def test_the_payload_of_the_program_counts() -> None:
    source, arm = f"movej({HOME.tolist()})", arm_model(6, COMPLIANCE)
    none, same, heavy = (solved(source, place(arm, payload_kg=mass))[0].new for mass in (None, 2.0, 9.0))
    assert none == same
    assert heavy != same


def test_ranges_count_whole_turns_away() -> None:
    measured = np.array([[-0.5, 3.0], [0.5, 4.0]])
    assert outside(np.array([2.0 * np.pi, 3.5 - 2.0 * np.pi]), measured) == []
    assert outside(np.array([0.6, 3.5]), measured) == [0]


def test_a_rotation_vector_stays_near_the_old_one() -> None:
    here = nearest_vector([0.0, 0.0, -3.1], [0.0, 0.0, 3.2])
    np.testing.assert_allclose(here, [0.0, 0.0, 2.0 * np.pi - 3.1], atol=1e-12)
    np.testing.assert_allclose(nearest_vector([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]), [0.1, 0.2, 0.3])


def test_the_table_has_old_and_new_numbers() -> None:
    targets = solved(f"movej({HOME.tolist()})\nmovel(p[3, 0, 0, 0, 0, 0])", place(arm_model()))
    result = CorrectResult(program="a", out=None, arm="left", targets=tuple(targets), left=(), assumptions=())
    rows = correct_table(result).text_rows()
    assert [row[0] for row in rows] == ["1", "", "2", ""]
    assert rows[0][2] == "0.300,-1.400,1.600,-1.700,1.200,0.400"
    assert float(rows[1][3]) == pytest.approx(targets[0].correction_mm, abs=6e-4)
    assert rows[3][2] == "not corrected, see below"
