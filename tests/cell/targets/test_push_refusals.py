"""What ``push`` refuses before anything moves, and what it stops for when measurements contradict the model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell_checks import require_same_arms
from cellapp.cell.driving.push import push
from cellapp.cell.driving.verification import Agreement
from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import recorded_controllers
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.records import VerifyResult
from cellapp.cell.targets.targets import WorkingConditions, load_targets
from cellapp.commands.push.run import push_run
from cellapp.commands.report.result import read_results
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.progress import Cancelled
from cellapp.robot.model import CellModel
from drivers.arms.protocol import ArmIdentity
from drivers.arms.simulated import SimulatedArm
from tests.twin import PROFILES, plant_of, small_twin

ALL = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())
TARGETS = (*ALL[:4], *ALL[20:22])


@pytest.fixture(scope="module")
def commands(run: RunFile, model: CellModel) -> tuple[Command, ...]:
    return compensate(run.profile, model, TARGETS)


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
        push(run.profile, model, [replace(commands[0], arm="third")], verify=True)
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
    edited = left.model_copy(update={"smr": left.smr.model_copy(update=changes)})
    profile = run.profile.model_copy(update={"arms": {**run.profile.arms, "left": edited}})
    with pytest.raises(InputError, match=f"arm left: {words}"):
        push(profile, model, commands, verify=True)
    assert cells == []


def test_an_unknown_smr_offset_is_no_other_mount(run: RunFile, model: CellModel, commands: tuple[Command, ...]) -> None:
    left = run.profile.arms["left"]
    unknown = left.model_copy(update={"smr": left.smr.model_copy(update={"offset": "unknown"})})
    require_same_arms(run.profile.model_copy(update={"arms": {**run.profile.arms, "left": unknown}}), model, commands)


def test_another_controller_is_refused(run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(recorded_controllers(run)) == {"left", "right"}
    other = ArmIdentity(model="UR10", serial="SIM-other", software="simulated")
    monkeypatch.setattr(SimulatedArm, "identify", lambda self: other)
    with pytest.raises(HardwareError, match="began with controller SIM-left, this one is SIM-other; nothing was moved"):
        push_run(run, TARGETS, verify=True)
    assert nothing_moved(cells, run)


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


def test_where_readings_had_several_loads_a_target_is_for_one_of_them(
    run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    readings = RunFile.readings
    with_several = np.array([0.3, 5.0])
    monkeypatch.setattr(
        RunFile,
        "readings",
        lambda self, name: replace(its := readings(self, name), payload_kg=np.resize(with_several, len(its))),
    )
    tool = SimulatedArm.tool
    monkeypatch.setattr(SimulatedArm, "tool", lambda self: replace(tool(self), payload_kg=5.0))
    words = "5.000 kg, the readings had several, and target 'left-01', which states none, is for 0.300 kg"
    with pytest.raises(HardwareError, match=words):
        push_run(run, TARGETS[:1], verify=False, out_of_date=True)
    assert nothing_moved(cells, run)


@pytest.mark.parametrize(
    ("set_kg", "stated_kg", "words"),
    [
        (2.0, None, "a payload of 2.000 kg, the run was measured with 0.300 kg; nothing was moved"),
        (0.3, 2.0, "a payload of 0.300 kg, target 'left-01' states 2.000 kg; nothing was moved"),
        (2.0, 2.0, ""),
    ],
)
def test_a_payload_that_fits_no_target_is_refused(
    run: RunFile,
    cells: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    set_kg: float,
    stated_kg: float | None,
    words: str,
) -> None:
    """The controller of the left arm says another payload; the load itself is not simulated."""
    tool = SimulatedArm.tool
    monkeypatch.setattr(
        SimulatedArm,
        "tool",
        lambda self: replace(tool(self), payload_kg=set_kg) if self.name == "left" else tool(self),
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
    assert "cellapp locate DIR" in found.stopped
    assert found.complaints()[0] == found.stopped
    (cell,) = cells
    for name, home in home_positions(run.profile).items():
        np.testing.assert_array_equal(plant_of(cell).q(name), home)


def test_one_target_is_enough_at_the_end_of_the_list(run: RunFile, model: CellModel) -> None:
    moved = moved_tracker(model, 0.01)
    found = push(run.profile, moved, compensate(run.profile, moved, TARGETS[:1]), verify=True)
    assert found.stopped.startswith("arm left: measured 10.")


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
    control = JobControl()
    with pytest.raises(Cancelled):
        push_run(run, TARGETS, lambda event: control.stop() if event.done == 3 else None, control, verify=True)
    stored = read_results(run).verify
    assert stored is not None
    assert [target.name for target in stored.targets] == [target.name for target in TARGETS[:3]]
    assert stored.stopped.startswith("stopped after 3 of 6 targets: ")
    assert stored.complaints()[0] == stored.stopped
    assert all(target.compensated_mm is not None for target in stored.targets)


def test_a_stop_before_the_first_target_stores_nothing(run: RunFile, cells: list[Any]) -> None:
    before = read_results(run).verify
    control = JobControl()
    with pytest.raises(Cancelled):
        push_run(run, TARGETS, lambda event: control.stop(), control, verify=True)
    assert read_results(run).verify == before


def test_results_without_the_new_keys_are_read() -> None:
    old = '{"schema": "cellapp-verify", "version": 1, "arms": {}, "targets": [], "notes": []}'
    found = VerifyResult.from_json(old, "old")
    assert (found.stopped, found.pairs, found.cooperative) == ("", (), None)
