"""The twin through the wire: arms over ur_rtde, tracker over the bridge; the results are the in-process ones."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import PlannedStops, write_planned_stops
from cellapp.cell.planning.sweeps import SWEEPS_RESULT, PlannedSweeps, read_sweeps
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of, recording_states
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.motion.tracks import track_of
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm
from drivers.arms.ur_settings import UrSettings
from drivers.plant.sweep import recorder_of
from tests.cell.targets.pairs import pair_targets, stops_with_room
from tests.commands.emulated_cell import behind_bridge, emulated, patiently, stalled
from tests.loopback import free_port, own_address, own_arms
from tests.sure import sure
from tests.twin import PROFILES, altered, small_twin, with_arm
from tests.verbs import push_run
from tests.waiting import WAIT_S, within

pytestmark = pytest.mark.waits

PACE = 200.0
STOPS = 20
SETTLE_S = 0.05
"""Wall time, of which the emulated arms need less: a second of theirs is 0.02 s at this pace."""
HOSTS, CLI_HOSTS = own_arms(53), own_arms(55)


def collected(
    profile: Profile, folder: Path, plan: PlannedStops
) -> tuple[dict[str, Readings], CalibrateResult, VerifyResult]:
    """What was read, its calibration, and a cooperative target at a stop with room that is measured and corrected."""
    with RunFile.create(folder, profile, lambda run: write_planned_stops(run, plan)) as run:
        collect_run(run)
        readings, calibrated = {name: run.readings(name) for name in run.arms()}, calibrate_run(run)
        model = CellModel.load(folder / CALIBRATION_FILE)
        targets = pair_targets(run, model, stops_with_room(run, model, 1))
        return readings, calibrated, push_run(run, targets, verify=True, iterate=1)


@pytest.mark.slow
def test_the_twin_over_the_wire_gives_the_readings_and_the_calibration_of_the_twin(tmp_path: Path) -> None:
    # the right one has an e-Series controller: 500 Hz, remote control, other dashboard
    e_series = load_profile(PROFILES / "ur10e-ur5e.yaml").arms["right"].type
    twin = with_arm(small_twin(STOPS), "right", type=e_series)
    twin = altered(twin, network={"kind": "none"})
    plan, _ = make_stops(twin)
    direct, its, verified = collected(twin, tmp_path / "direct", plan)
    arms = {
        name: arm.model_copy(update={"driver": UrSettings(host=HOSTS[name], settle_time=SETTLE_S, watchdog_hz=2.0)})
        for name, arm in twin.arms.items()
    }

    def on_the_wire(attempt: int) -> tuple[dict[str, Readings], CalibrateResult, VerifyResult]:
        with emulated(behind_bridge(twin), HOSTS, PACE) as port:
            at_port = behind_bridge(twin, f"socket://127.0.0.1:{port}").model_copy(update={"arms": arms})
            return collected(at_port, tmp_path / f"wired-{attempt}", plan)

    wired, ours, over_wire = patiently(on_the_wire)
    assert list(wired) == list(direct) == ["left", "right"]
    for name in direct:
        assert len(wired[name].q) == STOPS
        assert np.abs(wired[name].q - direct[name].q).max() < 1e-9
        assert np.abs(wired[name].p_M - direct[name].p_M).max() < 1e-9
        assert np.array_equal(wired[name].approach, direct[name].approach)
        assert wired[name].covariance_M == pytest.approx(direct[name].covariance_M, rel=1e-6)
        assert (np.diff(wired[name].time_s) > 0.0).all()
        found, expected = ours.arms[name].identified, its.arms[name].identified
        assert list(found) == list(expected)
        for parameter, estimate in expected.items():
            assert abs(found[parameter].value - estimate.value) < 1e-3 * sure(estimate.standard_error)
            assert found[parameter].standard_error == pytest.approx(sure(estimate.standard_error), rel=1e-3)
    for verification in (verified, over_wire):
        assert [target.note for target in verification.targets] == ["", ""]
        assert max(target.final_mm for target in verification.targets if target.final_mm is not None) < 0.1
        assert sure(verification.pairs[0].final_mm) < 0.1


# -- as a user does it -------------------------------------------------------------------------------------------------

CLI_TRACKER_HOST = own_address(55)
FEW = {"stops": 16, "identify": 11, "train": 1, "validate": 4, "pair_identify": 8, "pair_validate": 4}


def wire_profile(folder: Path) -> Path:
    """A copy of ``twin-rtde.yaml`` at addresses of its own, with fewer stops and targets."""
    shutil.copytree(PROFILES, folder, dirs_exist_ok=True)
    path = folder / "twin-rtde.yaml"
    text = path.read_text("utf-8")
    for key, size in FEW.items():
        text, found = re.subn(rf"^  {key}: \d+ *", f"  {key}: {size} ", text, flags=re.MULTILINE)
        assert found == 1, key
    text += "network: {kind: none}\ndiscovery: {null_simulations: 50}\n"
    for name, usual in (("left", "127.0.0.2"), ("right", "127.0.0.3")):
        text = text.replace(f"host: {usual}", f"host: {CLI_HOSTS[name]}, settle_time: {SETTLE_S}")
    path.write_text(text.replace("127.0.0.1:50960", f"{CLI_TRACKER_HOST}:{free_port(CLI_TRACKER_HOST)}"), "utf-8")
    targets = folder / "targets" / "twin.yaml"
    head, _, listed = targets.read_text("utf-8").partition("targets:\n")
    rows = [row for row in listed.splitlines() if "arm: " in row]
    few = [row for name in CLI_HOSTS for row in [row for row in rows if f"arm: {name}" in row][:2]]
    targets.write_text("\n".join([f"{head}targets:", *few, ""]), "utf-8")
    return path


@pytest.mark.slow
def test_a_user_emulates_the_cell_in_one_shell_and_runs_it_in_another(tmp_path: Path) -> None:
    wire_profile(tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(PROFILES.parent)}

    def command(*words: str) -> list[str]:
        return [sys.executable, "-m", "cellapp", *words, "twin-rtde.yaml"]

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command(*words), cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=240, check=False
        )

    def run_all(attempt: int) -> subprocess.CompletedProcess[str]:
        done = call("run", "--json", "-", "--run", f"all-{attempt}")
        if done.returncode and stalled(done.stderr):
            raise HardwareError(done.stderr)
        return done

    with subprocess.Popen(
        [*command("emulate"), "--pace", f"{PACE:g}"],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as emulator:
        try:
            said = [within(sure(emulator.stdout).readline, "the addresses") for _ in range(4)]
            assert [line.partition(":")[0] for line in said[:3]] == ["arm left", "arm right", "tracker"], said
            looked = call("doctor")
            assert looked.returncode == 0, looked.stdout + looked.stderr
            assert "arm left: motion: no check failed" in looked.stdout
            assert "; ready\n" in looked.stdout
            done = patiently(run_all)
            assert done.returncode == 0, done.stderr
            moved = json.loads(done.stdout)
            emulator.send_signal(signal.SIGINT)
            assert emulator.wait(WAIT_S) == 0
        finally:
            emulator.kill()
    for name in CLI_HOSTS:
        stages = moved["calibrate"]["arms"][name]["validate"]
        assert stages["geometry"]["position_mm"]["mean"] < stages["nominal"]["position_mm"]["mean"]
    looked = call("doctor")  # nobody is there now
    assert looked.returncode == 1
    assert "failed   arm left: link: " in looked.stdout
    assert "failed   tracker: " in looked.stdout


# -- Sweeps over the wire: arms over ur_rtde, the tracker's stream over the bridge, both clocks and a trigger ----------

HOSTS_OF_EMULATE_SWEEPS = own_arms(73)
PERIOD_S, SHARE = 4.5, 0.2
"""Of the sweeps: what is planned takes 16 s and more."""
ARM, RATE_HZ = "left", 200.0


def served_cell() -> Profile:
    """The twin behind emulated devices."""
    twin = behind_bridge(small_twin(1, plan={"method": "random"}))
    return altered(
        twin,
        arms={name: {"driver": UrSettings(host=HOSTS_OF_EMULATE_SWEEPS[name], watchdog_hz=2.0)} for name in twin.arms},
        collection={"motion_rate": RATE_HZ},
    )


def planned(folder: Path) -> Path:
    """One stop, and a short sweep of one arm about it."""
    with new_planned_run(served_cell(), folder, sweeps=1) as run:
        sweeps = tuple(
            one.model_copy(
                update={
                    "period_s": PERIOD_S,
                    **{
                        which: tuple(tuple(SHARE * value for value in row) for row in getattr(one, which))
                        for which in ("sine", "cosine")
                    },
                }
            )
            for one in read_sweeps(run)
            if one.arm == ARM
        )
        assert len(sweeps) == 1
        run.write_document(SWEEPS_RESULT, PlannedSweeps(sweeps=sweeps).model_dump_json())
    return folder


@pytest.mark.slow
def test_sweeps_are_recorded_over_the_wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = planned(tmp_path / "run")
    with RunFile.open(folder, write=True) as run:
        profile = run.profile
        clocks = recorder_of(build_plant(profile))
        with emulated(profile, HOSTS_OF_EMULATE_SWEEPS, 1.0) as port:
            monkeypatch.setattr(run, "profile", behind_bridge(profile, f"socket://127.0.0.1:{port}"))
            assert patiently(lambda attempt: collect_run(run, resume=attempt > 0)).stops == 1
        assert [state.arm for state in recording_states(run) if state.reached_s is None] == [ARM]
        (recording,) = read_recordings_of(run, ARM)
        joints, points = recording.joints, recording.points
        assert np.median(np.diff(joints.time_s)) == pytest.approx(0.008, rel=1e-3)
        assert np.median(np.diff(points.time_s)) == pytest.approx(1.0 / RATE_HZ, rel=1e-3)
        assert joints.qd is not None
        track = track_of(recording, nominal_arm(profile.arms[ARM]), tool_unknown=False, seed=1)
        true_s = clocks.offset_s + 1e-6 * clocks.rate_ppm * float(joints.time_s[0])
        assert track.start.offset_s == pytest.approx(true_s, abs=5e-3)
