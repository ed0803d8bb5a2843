"""Sweeps driven and recorded through the drivers, in the simulated cell: whole, with lost beams, stopped, resumed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.planning.sweeps import SWEEPS_RESULT, PlannedSweep, PlannedSweeps, Swing, read_sweeps, refuse_sweep
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of, read_stream, recording_states
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.commands.plan.run import new_planned_run
from cellapp.estimation.motion.tracks import track_of
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Collection
from cellapp.ground.progress import Progress, SweepLive
from cellapp.robot.model.nominal import nominal_arm
from drivers.arms.protocol import ArmError
from drivers.arms.simulated import SimulatedArm
from drivers.clock import SimulatedClock
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import StreamLimits
from drivers.trackers.simulated import SimulatedTracker
from tests.cell.driving.test_sweeping import copied
from tests.crossed_beam import crossed_beam
from tests.sure import sure
from tests.twin import altered, plant_of, small_twin
from tests.verbs import Opened, collect_by

CLOCK = Imperfections(clock_offset_s=321.0, clock_rate=20e-6, packet_jitter_s=0.04)
PERIOD_S = 4.0
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stops, and about the first one a short sweep of each arm."""
    folder = tmp_path_factory.mktemp("sweeps") / "run"
    profile = small_twin(2, plan={"method": "random"})
    with new_planned_run(altered(profile, collection={"motion_rate": RATE_HZ}), folder, sweeps=2) as run:
        sweeps = [one for one in read_sweeps(run) if one.stop == 0]
        assert {one.arm for one in sweeps} == {"left", "right"}
        short = tuple(
            one.model_copy(
                update={
                    "period_s": PERIOD_S,
                    "sine": tuple(tuple(0.2 * value for value in row) for row in one.sine),
                    "cosine": tuple(tuple(0.2 * value for value in row) for row in one.cosine),
                }
            )
            for one in sweeps
        )
        run.write_document(SWEEPS_RESULT, PlannedSweeps(sweeps=short).model_dump_json())
    return folder


@pytest.fixture(scope="module")
def swinging(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same plan, with the sweep of the left arm only, beside which the right one swings."""
    with copied(planned, tmp_path_factory.mktemp("swinging")) as run:
        left, right = sorted(read_sweeps(run), key=lambda one: one.arm)
        beside = Swing.of("right", right.motion(np.zeros(6)).scaled(0.5))
        pair = left.model_copy(update={"beside": beside})
        assert refuse_sweep(cell_bodies(run.profile), pair.motions(at := read_planned_stops(run).targets(0)), at) == ""
        run.write_document(SWEEPS_RESULT, PlannedSweeps(sweeps=(pair,)).model_dump_json())
        return run.folder


def two_seconds_after_it_sets_out(cell: Cell, name: str, act: Callable[[SimulatedArm], None]) -> SimulatedArm:
    """Act on an arm while it follows its path; return the arm."""
    arm = cell.arms[name]
    assert isinstance(arm, SimulatedArm)
    start, plant = arm.start_path, plant_of(cell)

    def started(q: Any, period_s: float) -> None:
        plant.schedule.at(plant.clock_s + 2.0, lambda: act(arm))
        start(q, period_s)

    arm.start_path = started  # type: ignore[method-assign]
    return arm


def driven_cell(errors: Imperfections = CLOCK, prepare: Callable[[Cell], Any] = lambda cell: None) -> Opened:
    """Opens the simulated cell as one whose devices are all that there is: nothing is calculated at once."""

    @contextmanager
    def opened(profile: Profile, **_: Any) -> Iterator[Cell]:
        with open_cell(profile) as cell:
            assert isinstance(cell.clock, SimulatedClock)
            tracker = SimulatedTracker(cell.clock.plant, errors)
            tracker.connect()
            driven = replace(cell, tracker=tracker, record_sweep=None)
            prepare(driven)
            yield driven

    return opened


def sweeps_in(heard: Sequence[Progress], arm: str) -> list[SweepLive]:
    """What those who look on heard of the sweeps of an arm."""
    return [one.detail for one in heard if isinstance(one.detail, SweepLive) and one.detail.arm == arm]


def names(run: RunFile) -> set[tuple[str, str]]:
    return {(one.arm, one.part_of) for one in recording_states(run) if one.reached_s is None}


def test_sweeps_are_driven_and_recorded_with_both_clocks(planned: Path, tmp_path: Path) -> None:
    heard: list[Progress] = []
    with copied(planned, tmp_path) as run:
        assert collect_by(driven_cell(), run, JobControl(heard.append)).outcome == "complete"
        sweeps = read_sweeps(run)
        assert len(sweeps) >= 2
        assert names(run) == {(one.arm, one.name) for one in sweeps}
        for state in recording_states(run):
            assert state.joints.rate_hz == pytest.approx(125.0, rel=1e-3)
            assert state.points.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
            assert state.joints.gaps == state.points.gaps == 0
            assert PERIOD_S < state.points.seconds < PERIOD_S + 2.0
        recording = read_recordings_of(run, sweeps[0].arm)[0]
        told = sweeps_in(heard, recording.arm)
        assert len(told) <= 3 + 4 * (PERIOD_S + 1.0), "few enough to be looked at"
        assert [one.state for one in told] == ["moving"] * (len(told) - 1) + ["done"]
        shares = [one.done_s for one in told]
        assert shares == sorted(shares)
        assert len(set(shares)) > 2 * (PERIOD_S - 1.0)
        assert told[-1].done_s == PERIOD_S
        assert f"sweep of {recording.arm} 100%, 4 of 4 s" in next(e.note for e in heard if e.detail is told[-1])
        assert np.median(recording.points.time_s - recording.joints.time_s[0]) > 320.0
        nominal = nominal_arm(run.profile.arms[recording.arm])
        start = track_of(recording, nominal, tool_unknown=False, seed=1).start
        assert start.offset_s == pytest.approx(321.0, abs=3e-3)
        states = recording_states(run)
        assert collect_by(driven_cell(), run, resume=True).outcome == "complete"
        assert recording_states(run) == states


def test_a_lost_beam_slows_the_arm_down_and_the_rest_is_a_recording_of_its_own(
    planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells: list[Cell] = []
    crossed = crossed_beam(monkeypatch, cells, "left", 2.0)
    heard: list[Progress] = []
    with copied(planned, tmp_path) as run:
        collect_by(driven_cell(CLOCK, cells.append), run, JobControl(heard.append))
        assert len(crossed) == 1
        told = sweeps_in(heard, "left")
        searching = next(place for place, one in enumerate(told) if one.state == "searching")
        assert {one.lost_beams for one in told[:searching]} == {0}
        assert {one.lost_beams for one in told[searching:]} == {1}
        assert 2.0 < told[searching].done_s < told[-1].done_s == PERIOD_S
        parts = [one for one in recording_states(run) if one.arm == "left" and one.part_of == "sweep-1"]
        assert [one.name for one in parts] == ["sweep-1", "sweep-1.2"]
        assert 2.0 < sure(parts[0].reached_s) < 3.2
        assert parts[1].reached_s is None
        assert any("beam broke" in event.text for event in run.events())
        first, second = (one.joints.seconds for one in parts)
        assert first + second == pytest.approx(PERIOD_S + 4 * 0.5 + 2.0, abs=1.5)
        assert names(run) == {(one.arm, one.name) for one in read_sweeps(run)}


def test_a_beam_that_stays_lost_ends_the_recording_and_the_arm_comes_back(planned: Path, tmp_path: Path) -> None:
    def prepare(cell: Cell) -> None:
        tracker = cell.tracker
        assert isinstance(tracker, SimulatedTracker)
        two_seconds_after_it_sets_out(cell, "left", lambda arm: tracker.covered.add("left"))

    heard: list[Progress] = []
    with copied(planned, tmp_path) as run:
        collect_by(driven_cell(CLOCK, prepare), run, JobControl(heard.append))
        told = sweeps_in(heard, "left")
        states = list(dict.fromkeys(one.state for one in told))
        assert states == ["moving", "searching", "unrecorded", "done"]
        rest = [one for one in told if one.state == "unrecorded"]
        assert "1 lost beam, the rest is not recorded" in rest[-1].words()
        assert any("the rest of its sweep is not recorded" in event.text for event in run.events())
        assert ("left", "sweep-1") not in names(run)
        assert {arm for arm, _ in names(run)} == {"right"}
        assert len(run.stops_done()) == 2


def test_a_fault_in_a_sweep_stops_all_and_resuming_records_what_is_missing(planned: Path, tmp_path: Path) -> None:
    faults: list[ArmError] = []

    def prepare(cell: Cell) -> None:
        two_seconds_after_it_sets_out(cell, "right", SimulatedArm.protective_stop).watch(faults.append)

    with copied(planned, tmp_path) as run:
        with pytest.raises(HardwareError, match="protective stop"):
            collect_by(driven_cell(CLOCK, prepare), run)
        before = names(run)
        assert "right" not in {arm for arm, _ in before}
        collect_by(driven_cell(), run, resume=True)
        assert before < names(run) == {(one.arm, one.name) for one in read_sweeps(run)}


def plan_of(run: RunFile) -> tuple[PlannedSweep, dict[str, np.ndarray]]:
    (sweep,) = read_sweeps(run)
    return sweep, dict(read_planned_stops(run).targets(0))


def test_both_arms_are_driven_at_once_and_the_joints_of_both_recorded(swinging: Path, tmp_path: Path) -> None:
    with copied(swinging, tmp_path) as run:
        assert collect_by(driven_cell(), run).outcome == "complete"
        sweep, at = plan_of(run)
        (state,) = recording_states(run)
        columns, _ = read_stream(run, state, "joints")
        q, other_q = (
            np.column_stack([columns[f"{stem}{joint}"] for joint in range(1, 7)]) for stem in ("q", "other_q")
        )
        motions = sweep.motions(at)
        time_s = np.linspace(0.0, PERIOD_S, 2000)
        for name, its in (("left", q), ("right", other_q)):
            assert np.abs(its[[0, -1]] - at[name]).max() < 2e-3, "from rest to rest at the stop"
            assert np.ptp(its, axis=0).max() > 0.01
        path = np.hstack([motions["left"].at(time_s), motions["right"].at(time_s)])
        off = [np.abs(path - row).max(axis=1).min() for row in np.hstack([q, other_q])[::10]]
        assert max(off) < 0.01, "at each sample both are at one time of their motions"


def test_an_arm_that_falls_behind_the_other_stops_both(swinging: Path, tmp_path: Path) -> None:
    def prepare(cell: Cell) -> None:
        late = cell.arms["right"]
        assert isinstance(late, SimulatedArm)
        start = late.start_path

        def started(q: np.ndarray, period_s: float) -> None:
            start(np.concatenate([np.repeat(q[:1], 125, axis=0), q]), period_s)  # it sets out a second later

        late.start_path = started  # type: ignore[method-assign]

    with copied(swinging, tmp_path) as run:
        with pytest.raises(HardwareError, match="apart from where both should be; one of them was late"):
            collect_by(driven_cell(CLOCK, prepare), run)
        assert recording_states(run) == ()


@pytest.mark.parametrize(("rate", "words"), [(RATE_HZ, "does not measure"), (900.0, r"collection\.motion_rate")])
def test_a_cell_that_cannot_record_says_why(
    planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: float, words: str
) -> None:
    limits = None if rate < 300.0 else StreamLimits(0.002, 1.0)
    monkeypatch.setattr(SimulatedTracker, "stream_limits", lambda self: limits)
    with copied(planned, tmp_path) as run:
        monkeypatch.setattr(run, "profile", altered(run.profile, collection={"motion_rate": rate}))
        collect_by(driven_cell(), run)
        assert recording_states(run) == ()
        assert any(re.search(f"sweeps are left out: .*{words}", event.text) for event in run.events())


@pytest.mark.parametrize("wrong", [0.0, 1001.0, "fast"])
def test_rates_that_no_tracker_has_are_refused_by_the_profile(wrong: object) -> None:
    with pytest.raises(ValidationError):
        Collection.model_validate({"motion_rate": wrong})
