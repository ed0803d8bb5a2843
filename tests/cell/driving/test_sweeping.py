"""Sweeps from their plan to a calibration, on the simulated cell: seen, clear, recorded once, left out if refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from cellapp.cell.driving import sweeping
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.planned_stops import read_planned_stops, straight_stops
from cellapp.cell.planning.sweeps import SWEEPS_RESULT, plan_sweeps, read_sweeps, refuse_sweep
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of, recording_states
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import clear_stops, visible
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.plan.run import new_planned_run, plan_result
from cellapp.ground.control import JobControl, Stopped
from cellapp.ground.errors import InputError
from cellapp.ground.profile.sections import Plan
from cellapp.ground.progress import Progress, SweepLive
from tests.sure import sure
from tests.twin import altered, small_twin

STOPS = 2


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweeps") / "run"
    new_planned_run(small_twin(plan={"method": "random"}), folder, sweeps=STOPS).close()
    return folder


def copied(planned: Path, folder: Path) -> RunFile:
    (folder / "run").mkdir()
    (folder / "run" / "run.sqlite").write_bytes((planned / "run.sqlite").read_bytes())
    return RunFile.open(folder / "run", write=True)


@pytest.fixture(scope="module")
def swinging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stops, and about each a sweep of either arm, the other one swinging where there is room."""
    folder = tmp_path_factory.mktemp("swinging") / "run"
    new_planned_run(small_twin(plan={"method": "random", "other_arm": "swinging"}), folder, sweeps=STOPS).close()
    return folder


@pytest.mark.parametrize("plan", ["planned", "swinging"])
def test_every_sample_of_a_planned_sweep_is_seen_clear_and_slow(plan: str, request: pytest.FixtureRequest) -> None:
    with RunFile.open(request.getfixturevalue(plan)) as run:
        sweeps, stops, profile = read_sweeps(run), read_planned_stops(run), run.profile
        result = plan_result(run)
    cell = cell_bodies(profile)
    assert len(stops) == STOPS
    assert sum(its.n for its in sure(result.sweeps).values()) == len(sweeps) > len(stops)
    assert "sweeps about its stops" in str(PLAN.view(result).parts)
    swings = [sweep.beside for sweep in sweeps if sweep.beside is not None]
    assert bool(swings) == (plan == "swinging")
    assert ("swings beside" in str(PLAN.view(result).parts)) == bool(swings)
    for sweep in sweeps:
        at = stops.targets(sweep.stop)
        motions = sweep.motions(at)
        motion = motions[sweep.arm]
        assert refuse_sweep(cell, motions, at) == ""
        time_s = motion.times(0.02)
        q = motion.at(time_s)
        still = {name: np.broadcast_to(its, (len(q), len(its))) for name, its in at.items()}
        paths = {**still, **{name: its.at(time_s) for name, its in motions.items()}}
        assert (
            visible(cell, sweep.arm, q, {name: its for name, its in paths.items() if name != sweep.arm}).mean() > 0.99
        )
        if sweep.beside is not None:
            assert np.ptp(paths[sweep.beside.arm], axis=0).max() > 0.05
            for late in range(0, 11, 2):  # rows by which either arm is behind: 0.2 s
                for name in motions:
                    behind = {**paths, name: np.concatenate([np.repeat(paths[name][:1], late, axis=0), paths[name]])}
                    assert clear_stops(cell, {one: its[: len(q)] for one, its in behind.items()}).all()
        arm = profile.arms[sweep.arm]
        for order, limits in (
            (1, [joint.speed for joint in arm.type.joints]),
            (2, [joint.acceleration for joint in arm.type.joints]),
        ):
            assert (np.abs(motion.at(time_s, order)) <= np.array(limits) * arm.speed_scale).all()
        assert (np.ptp(q, axis=0) > 0.0).all()


def test_a_cell_without_room_for_a_sweep_is_refused() -> None:
    profile = small_twin(2, plan={"method": "random"})
    narrow = {name: altered(arm, smr={"acceptance": 0.0}) for name, arm in profile.arms.items()}
    home = {name: np.array(arm.home)[None] for name, arm in profile.arms.items()}
    with pytest.raises(InputError, match="no sweep keeps clear"):
        plan_sweeps(profile.model_copy(update={"arms": narrow}), straight_stops(home))


def test_who_cannot_swing_beside_is_refused() -> None:
    profile = small_twin(2, plan={"method": "random", "other_arm": "swinging"})
    alone = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    home = {"left": np.array(profile.arms["left"].home)[None]}
    with pytest.raises(InputError, match=r"plan\.other_arm: swinging is for cells of two arms, this one has 1"):
        plan_sweeps(alone, straight_stops(home))
    with pytest.raises(ValidationError, match="'resting' or 'swinging'"):
        Plan.model_validate({"other_arm": "dancing"})


def test_collecting_records_each_sweep_once_and_calibrates(planned: Path, tmp_path: Path) -> None:
    with copied(planned, tmp_path) as run:
        heard: list[Progress] = []
        collect_run(run, JobControl(heard.append))
        sweeps = read_sweeps(run)
        states = recording_states(run)
        assert {(one.arm, one.name) for one in states} == {(one.arm, one.name) for one in sweeps}
        for name in run.profile.arms:
            (recording,) = read_recordings_of(run, name)
            assert (np.diff(recording.joints.time_s) > 0.0).all()
            moved, time_s = (np.diff(its[::5], axis=0) for its in (recording.points.p_M, recording.points.time_s))
            speed = np.linalg.norm(moved, axis=1) / time_s
            assert 0.001 < speed.max() < 0.25 * 1.05, "what a sweep may have at most"
        live = [one.detail for one in heard if isinstance(one.detail, SweepLive) and one.detail.state == "done"]
        assert {(one.arm, one.name) for one in live} == {(one.arm, one.name) for one in states}
        result = calibrate_run(run)
        assert collect_run(run, resume=True).outcome == "complete"
        assert recording_states(run) == states
    rates = [clock.rate_ppm for arm in result.arms.values() for clock in (arm.clocks or {}).values()]
    errors = [c.rate_standard_error_ppm for arm in result.arms.values() for c in (arm.clocks or {}).values()]
    assert len(rates) == 2
    assert abs(rates[0] - rates[1]) < 6.0 * float(np.hypot(errors[0], errors[1])), "both arms have the same two clocks"


def test_a_sweep_that_the_gate_refuses_is_left_out_with_a_note(
    planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeping, "refuse_sweep", lambda *_: "too near")
    with copied(planned, tmp_path) as run:
        collect_run(run)
        assert recording_states(run) == ()
        assert any("is left out: too near" in event.text for event in run.events())


def test_a_person_stops_before_a_sweep(planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    control = JobControl()
    with copied(planned, tmp_path) as run:
        before = sweeping.Sweeps.at_stop

        def stopped(self, *rest):
            control.stop()
            return before(self, *rest)

        monkeypatch.setattr(sweeping.Sweeps, "at_stop", stopped)
        with pytest.raises(Stopped):
            collect_run(run, control=control)
        assert recording_states(run) == ()
        assert len(run.stops_done()) == 1


def test_damaged_sweeps_are_named(planned: Path, tmp_path: Path) -> None:
    with copied(planned, tmp_path) as run:
        run.write_document(SWEEPS_RESULT, "{")
        with pytest.raises(InputError, match="is damaged"):
            read_sweeps(run)
