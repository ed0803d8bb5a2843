"""What ``push`` refuses before anything moves, and what it stops for when measurements contradict the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.target_visit import push
from cellapp.cell.driving.verification import Agreement
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.goals import UNPLACED, is_unplaced
from cellapp.cell.targets.prediction import Command
from cellapp.cell.targets.ranges import ConditionRanges, payload_covariance
from cellapp.cell.targets.targets import Target, WorkingConditions, load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.init.own_data import write_own_data
from cellapp.commands.init.request import InitRequest
from cellapp.commands.run_results import read_results
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.progress import Cancelled
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.effects.joint_compliance import LINEAR
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.transforms import rotation_from_vector, transform, zyx_angles
from cellapp.robot.model import CellModel
from drivers.arms.simulated import SimulatedArm
from drivers.findings import ArmIdentity
from tests.arms import UR5
from tests.sure import sure
from tests.twin import PROFILES, altered, plant_of, small_twin
from tests.verbs import export_as_run, import_new_run, push_run

ALL = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())
TARGETS = (*ALL[:4], *ALL[20:22])


def nothing_moved(cells: list[Any], run: RunFile) -> bool:
    """Whether the arms of the only cell that was opened still stand where a simulated cell begins: at home."""
    (cell,) = cells
    plant = plant_of(cell)
    return plant.clock_s < 1.0 and all(
        np.array_equal(plant.q(name), home) for name, home in home_positions(run.profile).items()
    )


# -- before anything moves --------------------------------------------------------------------------------------------


def test_empty_lists_and_other_arms_are_refused(
    run: RunFile, model: CellModel, commands: tuple[Command, ...], cells: list[Any]
) -> None:
    with pytest.raises(InputError, match="push: there are no targets"):
        push(run.profile, model, (), verify=True)
    with pytest.raises(InputError, match="push: there are no targets"):
        push_run(run, (), verify=True)
    with pytest.raises(InputError, match="target 'left-01' is for arm 'third', the profile has arms left, right"):
        push(run.profile, model, [commands[0].recording(arm="third")], verify=True)
    alone = replace(model, arms={"left": model.arms["left"]})
    with pytest.raises(InputError, match="the calibration is of arms left, the profile of arms left, right"):
        push(run.profile, alone, commands, verify=True)
    assert cells == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"offset": (0.045, 0.020, 0.070)},
            r"smr.offset is \(45.000, 20.000, 70.000\) mm in the profile, \(45.000, 20",
        ),
        ({"normal": (0.0, 1.0, 0.0)}, r"smr.normal is \(0, 1, 0\) in the profile, \(0, 0, 1\) when"),
    ],
)
def test_another_smr_mount_is_refused(
    run: RunFile, model: CellModel, commands: tuple[Command, ...], cells: list[Any], changes: dict[str, Any], words: str
) -> None:
    left = run.profile.arms["left"]
    edited = altered(left, smr=changes)
    profile = run.profile.model_copy(update={"arms": {**run.profile.arms, "left": edited}})
    with pytest.raises(InputError, match=f"arm left: {words}"):
        push(profile, model, commands, verify=True)
    assert cells == []


def test_another_dh_checksum_is_refused_unless_one_insists(
    run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        SimulatedArm,
        "identify",
        lambda self: ArmIdentity("simulated", f"SIM-{self.name}", "simulated", None, "0000000b"),
    )
    with pytest.raises(HardwareError, match="arm left: the checksum of the controller's D-H was none, now it is 0000"):
        push_run(run, TARGETS[:1], verify=True)
    assert nothing_moved(cells, run)
    found = push_run(run, TARGETS[:1], verify=True, out_of_date=True)
    assert found.targets[0].compensated_mm is not None
    assert any("checksum of the controller's D-H" in note for note in found.notes)


@pytest.mark.parametrize(
    ("set_kg", "stated_kg", "words"),
    [
        (2.0, None, "a payload of 2.000 kg, the run was measured with 0.300 kg; nothing was moved"),
        (0.3, 2.0, "a payload of 0.300 kg, target 'left-01' states 2.000 kg; nothing was moved"),
        (2.0, 2.0, ""),
    ],
)
def test_a_payload_that_fits_no_target_is_refused(
    run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch, set_kg: float, stated_kg: float | None, words: str
) -> None:
    """The controller of the left arm says another payload; the load itself is not simulated."""
    tool = SimulatedArm.tool
    monkeypatch.setattr(
        SimulatedArm, "tool", lambda self: replace(tool(self), payload_kg=set_kg) if self.name == "left" else tool(self)
    )
    target = TARGETS[0].model_copy(update={"conditions": WorkingConditions(payload=stated_kg)})
    if not words:
        assert push_run(run, (target,), verify=False).targets[0].note == ""
        return
    with pytest.raises(HardwareError, match=f"arm left: its controller is set to {words}"):
        push_run(run, (target,), verify=False)
    assert nothing_moved(cells, run)


# -- while measuring --------------------------------------------------------------------------------------------------


def moved_tracker(model: CellModel, off_m: float) -> CellModel:
    """The model as if the tracker had been moved along its x axis since the calibration."""
    arms = {}
    for name, arm in model.arms.items():
        T_M_B = arm.geometry.T_M_B()
        T_M_B[0, 3] += off_m
        arms[name] = replace(arm, geometry=arm.geometry.with_T_M_B(T_M_B))
    return replace(model, arms=arms)


@pytest.mark.parametrize("off_m", [0.01, 0.2], ids=["a centimetre", "out of sight"])
def test_a_moved_tracker_ends_the_job_after_two_targets(
    run: RunFile, model: CellModel, cells: list[Any], off_m: float
) -> None:
    moved = moved_tracker(model, off_m)
    commands = compensate(run.profile, moved, [target for target in TARGETS if target.arm == "left"])
    found = push(run.profile, moved, commands, verify=True)
    assert len(found.targets) == 2
    assert "the tracker was moved, the SMR was mounted anew, or the arm has changed" in found.stopped
    assert "cellapp check DIR --tracker-moved" in found.stopped
    assert found.complaints()[0] == found.stopped
    (cell,) = cells
    for name, home in home_positions(run.profile).items():
        np.testing.assert_array_equal(plant_of(cell).q(name), home)


def test_a_single_outlier_does_not_end_the_job() -> None:
    agreement = Agreement()
    agreement.add({"left": "off"})
    assert agreement.broken() == ""
    agreement.add({"left": "", "right": "off"})
    assert agreement.broken() == ""
    for _ in range(4):
        agreement.add({"left": "off"})
        assert agreement.broken(ended=True).startswith("arm right: off")
        assert agreement.broken() == ""
    agreement.add({"left": "off"})
    assert agreement.broken().startswith("arm left: off")


# -- what a stop leaves -----------------------------------------------------------------------------------------------


def test_what_was_measured_before_a_stop_is_kept(run: RunFile, cells: list[Any]) -> None:
    control = JobControl(lambda event: control.stop() if event.done == 3 else None)
    with pytest.raises(Cancelled):
        push_run(run, TARGETS, control, verify=True)
    stored = sure(read_results(run).verify)
    assert [target.name for target in stored.targets] == [target.name for target in TARGETS[:3]]
    assert stored.stopped.startswith("stopped after 3 of 6 targets: ")
    assert stored.complaints()[0] == stored.stopped
    assert all(target.compensated_mm is not None for target in stored.targets)


# -- Commands for an arm of which only readings are known: they bring the true arm to its targets; nothing is driven ---

RNG = np.random.default_rng(5)
TRUE = nominal_geometry(
    UR5 + RNG.normal(0.0, [1e-3, 5e-4, 5e-4, 1e-3], (6, 4)),
    np.array([0.01, 0.02, 0.08]),
    transform(rotation_from_vector(RNG.normal(size=3)), RNG.uniform(-2.0, 2.0, 3)),
)
"""Where the floor of a cell would be, nobody knows: the base stands anyhow."""


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    q = np.random.default_rng(6).uniform(-2.0, 2.0, (120, 6))
    p_M = smr_positions(TRUE, q) + np.random.default_rng(7).normal(0.0, 1e-5, (120, 3))
    rows = [",".join(f"{v:.9f}" for v in (*a, *b)) for a, b in zip(q, p_M, strict=True)]
    (folder / "mine.csv").write_text("\n".join(["q1,q2,q3,q4,q5,q6,x_m,y_m,z_m", *rows]))
    written = write_own_data(InitRequest(folder=folder, readings=folder / "mine.csv", arm="ur5"))
    import_new_run(load_profile(Path(written.profile)), Path(written.readings or ""), folder / "run")
    with RunFile.open(folder / "run", write=True) as run:
        calibrate_run(run)
    return folder / "run"


def test_the_commands_bring_the_true_arm_to_its_targets(calibrated: Path) -> None:
    q = np.array([[0.3, -1.1, 1.4, -0.6, 1.2, 0.4], [-0.8, -0.7, 1.1, 0.5, -1.3, 0.9]])
    wanted = smr_positions(TRUE, q)
    targets = [Target(name=f"t{i}", arm="robot", frame="tracker", position=tuple(p)) for i, p in enumerate(wanted)]
    with RunFile.open(calibrated, write=True) as run:
        assert is_unplaced(run.profile)
        found = compensate_run(run, targets)
        assert UNPLACED in found.notes
        commands = np.array([one.q_compensated for one in found.targets])
        errors_mm = 1e3 * np.linalg.norm(smr_positions(TRUE, commands) - wanted, axis=1)
        assert errors_mm.max() < 0.1
        assert not any("tracker" in one.note or one.visible is not None for one in found.targets)


def test_a_table_is_written_and_a_program_refused(calibrated: Path, tmp_path: Path) -> None:
    target = Target(name="t", arm="robot", frame="robot", position=(-0.4, -0.3, 0.4))
    with RunFile.open(calibrated, write=True) as run:
        compensate_run(run, [target])
        export_as_run(run, "commands", tmp_path / "commands.csv")
        assert "\nt,robot," in (tmp_path / "commands.csv").read_text("utf-8")
        with pytest.raises(InputError, match="no motion can be checked"):
            export_as_run(run, "urscript", tmp_path / "program.script")
    assert not (tmp_path / "program.script").exists()


# -- Commands for a payload that no reading had: the bound covers what the arm really does, and says what it adds ------

LOAD_KG = 2.0
"""The readings of the twin have 0.3 kg."""


def errors_and_parts(
    run: RunFile, model: CellModel, ranges: dict[str, ConditionRanges], load_kg: float
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """True errors (n, 3) [mm] of the left arm, whose joints give way, where its planned stops were; the uncertainty
    (n,) of its position, notes."""
    plan = sure(run.read_plan())
    p_M = model.arms["left"].predict(plan["left"])
    rotation_M, _ = model.arms["left"].flange(plan["left"])
    loaded = WorkingConditions(payload=load_kg)
    targets = [
        Target(name=f"stop-{k}", arm="left", position=p, rpy=zyx_angles(R)[::-1], frame="tracker", conditions=loaded)
        for k, (p, R) in enumerate(zip(p_M.tolist(), rotation_M, strict=True))
    ]
    commands = [one for one in compensate(run.profile, model, targets, ranges=ranges) if not one.record.refusal]
    records = [one.record for one in commands]
    q = np.array([one.q_compensated for one in records])
    sides = np.array([one.approach or (0,) * 6 for one in records], dtype=float)
    true_M = build_plant(run.profile).smr_positions("left", q, approach=sides, payload=np.full(len(q), load_kg))
    errors = (true_M - np.array([one.expected_M for one in commands])) * 1e3
    parts = [one.parts for one in records if one.parts is not None]
    own = [np.hypot(np.hypot(one.parameters, one.effects), np.hypot(one.network, one.extrapolation)) for one in parts]
    return errors, np.array(own), [one.note for one in records]


def normalised(errors: np.ndarray, own: np.ndarray) -> float:
    """Root mean square of coordinates in units of their standard uncertainty, without noise of measuring: some 1."""
    return float(np.sqrt(np.mean(errors**2 / own[:, None] ** 2)))


def test_a_payload_that_was_never_measured_widens_the_bound_to_what_the_arm_does(
    run: RunFile, model: CellModel
) -> None:
    ranges = {name: ConditionRanges.of(run.readings(name), arm) for name, arm in model.arms.items()}
    silent = {name: replace(one, elasticity=None) for name, one in ranges.items()}
    errors, own, notes = errors_and_parts(run, model, ranges, LOAD_KG)
    _, narrow, _ = errors_and_parts(run, model, silent, LOAD_KG)
    assert normalised(errors, own) < 1.2
    assert np.mean(own) > 1.2 * np.mean(narrow)
    assert np.mean(np.linalg.norm(errors, axis=1) <= 2.8 * own) >= 0.93, "95 % of three coordinates"
    words = "payload 2 kg was never measured (the readings had 0.3 kg); this adds "
    assert [note for note in notes if words not in note] == []
    measured, as_measured, silent_notes = errors_and_parts(run, model, ranges, 0.3)
    assert [note for note in silent_notes if "payload" in note] == []
    assert np.mean(as_measured) < np.mean(own)
    assert len(measured) == len(errors)


def test_a_law_that_only_the_measured_load_makes_true_is_doubted_under_another_one(
    run: RunFile, model: CellModel
) -> None:
    """A correction by the load stands for the joint's compliance where all readings have one load: it grows with it."""
    arm, readings = model.arms["left"], run.readings("left")
    rest = [term for term in arm.effects if term.slug != "joint_compliance"]
    (term,) = [term for term in arm.effects if term.slug == "joint_compliance"]
    wrong = replace(
        term,
        names=("load2", *term.names),
        values=np.array([3e-4, *term.values]),
        standard_errors=np.array([1e-6, *term.standard_errors]),
        units=("rad/Nm", *term.units),
        law=LINEAR.law(),
        modulations=(),
    )
    q, load_kg = readings.q[:20], np.full(20, 5.0)
    far_F = np.tile([0.0, 0.0, 0.4], (20, 1))
    asked = MeasurementConditions(payload_kg=load_kg, payload_center_F=far_F)
    sizes = {}
    for name, its in {"right": arm, "wrong": replace(arm, effects=(*rest, wrong))}.items():
        ranges = ConditionRanges.of(readings, its)
        near = ranges.nearest_loaded(its, q, asked)
        assert near.payload_center_F is not None
        assert not (near.payload_center_F == far_F).any(), "the centre of what was measured, not of what is asked"
        found = payload_covariance(its, q, asked, near, ranges.elasticity)
        assert not payload_covariance(its, q, near, near, ranges.elasticity).any()
        sizes[name] = np.sqrt(np.trace(found, axis1=1, axis2=2))
    assert np.median(sizes["wrong"]) > 3.0 * np.median(sizes["right"])
