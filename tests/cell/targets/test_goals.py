"""Goals: one physical point given in every frame leads to the same place; nominal bases move what rests on a base."""

from __future__ import annotations

import csv
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.exports.arm_export import lost_by, workspace
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.goals import work_frame_pose
from cellapp.cell.targets.records import VerifyResult
from cellapp.cell.targets.targets import FramePoint, WorkFrame, definition, load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.certificate.view import certificate_sections, certificate_tables
from cellapp.commands.compensate.tables import measured_tables, predicted_tables
from cellapp.commands.compensate.target_list import target_states
from cellapp.commands.compensate.view import view as compensated_view
from cellapp.commands.discover.run import discover_run
from cellapp.commands.run_results import read_results
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from cellapp.interfaces.page.page import certificate_page
from cellapp.robot.kinematics.transforms import Array, apply, transform
from cellapp.robot.model import CellModel
from tests.sure import sure
from tests.twin import HIDDEN, PROFILES, altered, finished_twin, small_twin
from tests.verbs import certificate_run, export_as_run, push_run

coordinates = st.floats(-5.0, 5.0)
points = st.tuples(coordinates, coordinates, coordinates)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
poses = st.builds(lambda p, q: transform(Rotation.from_quat(q).as_matrix(), p), points, quaternions)


def work_frame(T_parent_W: Array, parent: str) -> WorkFrame:
    nominal = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.1], [0.0, 0.4, 0.0], [0.3, 0.2, -0.5]])
    return WorkFrame(
        name="fixture",
        parent=parent,
        points=tuple(
            FramePoint(nominal=tuple(at), measured=tuple(there))
            for at, there in zip(nominal.tolist(), apply(T_parent_W, nominal).tolist())
        ),
    )


@given(poses, st.floats(-1e-3, 1e-3))
def test_a_work_frame_is_where_its_points_were_measured(T: Array, off: float) -> None:
    frame = work_frame(T, "tracker")
    T_parent_W, rms = work_frame_pose(frame)
    np.testing.assert_allclose(T_parent_W, T, atol=1e-11)
    assert rms < 1e-12
    first, *rest = frame.points
    x, y, z = first.measured
    touched = first.model_copy(update={"measured": (x, y, z + off)})
    _, rms = work_frame_pose(frame.model_copy(update={"points": (touched, *rest)}))
    assert rms <= abs(off) / 2.0 + 1e-12  # four points, and registration only makes the sum of squares smaller


# -- Orientation at targets where a probe on the flange measures it: predicted, judged, verified, certified, exported --

TOLERANCE = 0.5e-3
LEFT = tuple(
    target.model_copy(update={"orientation_tolerance": TOLERANCE, "tolerance": 0.2e-3})
    for target in load_targets(PROFILES / "targets" / "twin.yaml", small_twin())
    if target.arm == "left" and target.partner is None
)[:20]


def probed(stops: int) -> Profile:
    """The twin's left arm alone, with a probe."""
    profile = finished_twin(stops)
    left = profile.arms["left"]
    smr = Smr.model_validate({**left.smr.model_dump(), "probe": {"rpy": (0.0, 0.0, 0.3), "sigma": 4e-5}})
    arms = {"left": left.model_copy(update={"smr": smr})}
    return altered(
        profile, arms=arms, tolerances={"orientation": TOLERANCE}, plant={"effects": {"left": HIDDEN["left"]}}
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunFile]:
    profile = probed(100)
    with RunFile.create(tmp_path_factory.mktemp("turned") / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        calibrate_run(made)
        discover_run(made)
        yield made


@pytest.fixture(scope="module")
def model(run: RunFile) -> CellModel:
    return model_of(run, stage_in_force(run, read_stages(run)))


@pytest.fixture(scope="module")
def verified(run: RunFile) -> VerifyResult:
    return push_run(run, LEFT, verify=True)


def test_what_is_predicted_of_the_rotation_holds_when_it_is_measured(run: RunFile, verified: VerifyResult) -> None:
    rotations = [one.orientation for one in verified.targets]
    assert all(rotation is not None for rotation in rotations)
    kept = [its.final_mrad <= its.within_mrad for its in rotations if its and its.final_mrad and its.within_mrad]
    assert len(kept) == len(LEFT)
    assert np.mean(kept) >= 0.85  # of 20 bounds of 95 %, fewer than 17 hold in 1 of 400 cases
    arm = verified.arms["left"]
    assert sure(arm.nominal_mrad).mean > 10.0 * sure(arm.compensated_mrad).mean
    assert {rotation.verdict for rotation in rotations if rotation is not None} == {"in"}
    assert verified.complaints() == []
    (table,) = measured_tables(verified)
    place = table.headings.index("rotation met")
    assert [row[place] for row in table.rows] == ["in"] * len(LEFT)


def test_the_nominal_command_is_off_by_what_was_predicted(run: RunFile, verified: VerifyResult) -> None:
    stored = sure(read_results(run).compensate)
    for command, measured in zip(stored.targets, verified.targets, strict=True):
        assert measured.orientation is not None
        assert sure(command.orientation).nominal_mrad == pytest.approx(measured.orientation.nominal_mrad, abs=0.3)
    (table,) = predicted_tables(stored)
    assert "rotation before [mrad]" in table.headings
    assert any("95 % bound of the measured rotation" in str(part) for part in compensated_view(stored).parts)


def test_verdicts_follow_the_one_rule(run: RunFile, model: CellModel) -> None:
    tight = [LEFT[0].model_copy(update={"orientation_tolerance": limit}) for limit in (5e-3, 5e-5)]
    named = [one.model_copy(update={"name": f"t{k}"}) for k, one in enumerate(tight)]
    named.append(LEFT[0].model_copy(update={"name": "free", "rpy": None, "orientation_tolerance": None}))
    found = [one.record for one in compensate(run.profile, model, named)]
    rotations = [one.orientation for one in found]
    assert rotations[2] is not None
    assert (sure(rotations[0]).verdict, sure(rotations[1]).verdict, rotations[2].verdict) == ("in", "not decided", "")
    assert rotations[2].nominal_mrad is None
    assert rotations[2].within_mrad > 0.0


def test_a_stored_measurement_is_not_one_of_another_tolerance(run: RunFile, verified: VerifyResult) -> None:
    target = LEFT[0].model_copy(update={"orientation_tolerance": 1e-6})
    known, other = target_states([LEFT[0], target], read_results(run))
    assert known.is_measured
    assert not other.measured
    assert definition(target) != verified.targets[0].definition


def test_an_error_beyond_its_tolerance_is_a_complaint(verified: VerifyResult) -> None:
    first = verified.targets[0]
    assert first.orientation is not None
    beyond = altered(first, orientation={"final_mrad": 0.9, "verdict": "not decided"})
    result = verified.model_copy(update={"targets": (beyond, *verified.targets[1:])})
    (complaint,) = result.complaints()
    assert f"{first.name} (0.900 mrad, tolerance 0.5 mrad)" in complaint
    assert "1 of these not proven" in complaint


def test_the_certificate_states_rotations_with_their_own_budget(run: RunFile, verified: VerifyResult) -> None:
    made = certificate_run(run, certificate_page)
    errors = made.arms["left"].errors
    assert errors.left_mrad == verified.arms["left"].compensated_mrad
    assert errors.predicted_left_mrad is not None
    assert sure(made.orientation_contributions)[0].source == "6-D probe"
    assert made.arms["left"].expanded_mrad == pytest.approx(
        2.0 * np.linalg.norm([one.standard_mrad or np.nan for one in sure(made.orientation_contributions)])
    )
    titles = [table.title for table in certificate_tables(made)]
    assert "Errors of orientation as found and as left [mrad]" in titles
    assert "Uncertainty of a measured error of orientation [mrad]" in titles
    assert any(
        section.title.startswith("Uncertainty of a measured error of o") for section in certificate_sections(made)
    )


def test_commands_are_exported_with_what_is_known_of_the_rotation(run: RunFile, verified: VerifyResult) -> None:
    out = run.folder / "commands.csv"
    export_as_run(run, "commands", out)
    rows = list(csv.DictReader(line for line in out.read_text("utf-8").splitlines() if not line.startswith("#")))
    assert [row["orientation_verdict"] for row in rows] == ["in"] * len(LEFT)
    assert all(float(row["orientation_within_mrad"]) < 0.5 < float(row["nominal_mrad"]) for row in rows)


def test_what_a_rigid_chain_loses_is_stated_of_the_rotation_too(run: RunFile, model: CellModel) -> None:
    readings, arm = run.readings("left"), model.arms["left"]
    space = workspace(readings.q, measurement_conditions(readings), 0)
    lost = lost_by(arm.geometry, arm, space)
    assert sure(lost.rms_mrad) > 0.05
    assert "mrad rms" in lost.words
    assert lost_by(arm.of_positions().geometry, arm.of_positions(), space).rms_mrad is None
