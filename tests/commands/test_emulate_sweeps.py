"""Sweeps over the wire: arms over ur_rtde, the tracker's stream over the bridge, both clocks and a trigger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.iso9283.programme import published_cell
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.driving.tracked_path import INTERVAL_S, MOST_RUNS, PathDriver, TrackedPath
from cellapp.cell.planning.sweeps import SWEEPS_RESULT, PlannedSweeps, read_sweeps
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of, recording_states
from cellapp.cell.targets.path import PathSpec, plan_path
from cellapp.commands.plan.run import new_planned_run
from cellapp.estimation.motion.tracks import track_of
from cellapp.ground.control import JobControl
from cellapp.ground.profile import Profile
from cellapp.robot.model.nominal import nominal_arm
from drivers.arms.ur_settings import UrSettings
from drivers.plant.sweep import recorder_of
from drivers.trackers.protocol import TargetLost
from tests.commands.emulated_cell import behind_bridge, emulated, patiently
from tests.loopback import own_arms
from tests.twin import small_twin

pytestmark = pytest.mark.waits

HOSTS = own_arms(73)
PERIOD_S, SHARE = 4.5, 0.2
"""Of the sweeps: what is planned takes 16 s and more."""
ARM, RATE_HZ = "left", 200.0
LOST_PER_MIN, MOST_DRIVEN = 20.0, 30
"""The beam breaks in every third to fourth drive."""


def served_cell() -> Profile:
    """The twin behind emulated devices."""
    twin = behind_bridge(small_twin(1, plan={"method": "random"}))
    return twin.model_copy(
        update={
            "arms": {
                name: arm.model_copy(
                    update={"driver": UrSettings(host=HOSTS[name], watchdog_hz=2.0, trigger_output=number)}
                )
                for number, (name, arm) in enumerate(twin.arms.items())
            },
            "collection": twin.collection.model_copy(update={"motion_rate": RATE_HZ}),
        }
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
        run.write_result(SWEEPS_RESULT, PlannedSweeps(sweeps=sweeps).model_dump_json())
    return folder


def test_sweeps_are_recorded_over_the_wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = planned(tmp_path / "run")
    with RunFile.open(folder, write=True) as run:
        profile = run.profile
        clocks = recorder_of(build_plant(profile))
        with emulated(profile, HOSTS, 1.0) as port:
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
        assert track.trigger is not None, "pulses of both recordings belong together"
        assert track.trigger.offset_s == pytest.approx(true_s, abs=0.010)


def test_a_path_on_which_the_beam_broke_is_driven_again_over_the_wire() -> None:
    profile = served_cell()
    model = published_cell(profile, {})
    poses = [{"position": [-0.1, -0.75, 0.55], "rpy": ["90 deg", 0, 0]}, {"position": [0.1, -0.75, 0.55]}]
    spec = PathSpec.model_validate({"name": "line", "arm": ARM, "tolerance": 1e-3, "speed": 0.25, "poses": poses})
    plan = plan_path(profile, model, spec, 0.008)
    path, trajectory = plan.path, plan.trajectory
    assert plan.refusal == ""
    assert path is not None
    assert trajectory is not None
    start_M = path.positions(np.zeros(1))[0]

    def driven(_: int) -> list[TrackedPath]:
        found: list[TrackedPath] = []
        control = JobControl()
        with moving_cell(at_port, model, control, slow_visits=None) as moving:
            driver = PathDriver(moving.cell, moving.mover, moving.reaction, control)
            moving.mover.speed = 1.0

            def begin() -> None:
                moving.mover.move({ARM: trajectory.q[0]})

            for _ in range(MOST_DRIVEN):
                try:
                    found.append(driver.drive(ARM, trajectory, begin, start_M))
                except TargetLost as error:  # by chance the beam breaks in one drive after the other
                    if f"each of the {MOST_RUNS} times" not in str(error):
                        raise
                    continue
                if found[-1].lost_beams:
                    break
        return found

    with emulated(profile, HOSTS, 1.0, LOST_PER_MIN) as port:
        at_port = behind_bridge(profile, f"socket://127.0.0.1:{port}")
        found = patiently(driven)
    assert found[-1].lost_beams > 0
    for one in found:
        assert len(one.track.p_M) >= trajectory.duration_s / INTERVAL_S - 10
        assert path.distances(one.track.p_M).max() < 0.02, "as far as nominal arms are off"
