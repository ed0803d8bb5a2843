"""A session that pauses, holds, suspends and resumes; references, repeats, reserves, warm-up; what the run records."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.records import CollectResult
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.run.measured_again import earlier_readings, missing_share, reference_drifts
from cellapp.estimation.readings import Readings
from cellapp.ground.control import JobControl, Request, Stopped
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Collection, Reference, Repeat, Suspend, Suspension
from cellapp.ground.progress import Progress, ReferenceReport, StateChange
from drivers.arms.protocol import ArmError, HostStalled, LinkLost
from drivers.arms.simulated import SimulatedArm
from drivers.trackers.protocol import TrackerLinkLost
from drivers.trackers.simulated import SimulatedTracker
from tests.sure import sure
from tests.twin import plant_of, small_twin
from tests.verbs import collect_by

STOPS, RESERVE = 8, 3
Act = Callable[["Bench"], None]


@pytest.fixture(scope="module")
def planned() -> tuple[Profile, dict[str, np.ndarray]]:
    profile = small_twin(STOPS, plan={"reserve": RESERVE})
    return profile, plan_stops(profile)


class Person(JobControl):
    """A person who attends the job and acts when it waits for one."""

    def __init__(self, act: Callable[[Request], None], *, holds: bool = True) -> None:
        super().__init__(holds=holds)
        self.waited: list[Request] = []
        self._act = act

    def wait_while(self, *requests: Request, timeout_s: float | None = None) -> Request:
        assert len(self.waited) < 100, "the job waits for ever"
        self.waited.append(self.request)
        self._act(self.request)
        return self.request


class Bench:
    """A run on the simulated cell, with something done before each measurement or motion."""

    def __init__(self, run: RunFile) -> None:
        self.run = run
        self.heard: list[Progress] = []
        self.cell: Cell | None = None
        self.measured = 0
        self.before_measuring: dict[int, Act] = {}
        self.control: JobControl = JobControl()
        self.shift_M = np.zeros(3)

    @contextmanager
    def opened(self, profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options) as cell:
            self.cell = cell
            measure = cell.tracker.measure

            def acting(expected_M: np.ndarray, averaging_s: float) -> Any:
                self.measured += 1
                self.before_measuring.get(self.measured, lambda bench: None)(self)
                point = measure(expected_M, averaging_s)
                return replace(point, p_M=point.p_M + self.shift_M)

            cell.tracker.measure = acting  # type: ignore[method-assign]
            yield cell

    def collect(self, **options: Any) -> CollectResult:
        with self.control.heard_by(lambda event, _: self.heard.append(event)):
            return collect_by(self.opened, self.run, self.control, **options)

    @property
    def tracker(self) -> SimulatedTracker:
        assert self.cell is not None
        assert isinstance(self.cell.tracker, SimulatedTracker)
        return self.cell.tracker

    def arm(self, name: str) -> SimulatedArm:
        arm = sure(self.cell).arms[name]
        assert isinstance(arm, SimulatedArm)
        return arm

    @property
    def states(self) -> list[str]:
        return [event.detail.state for event in self.heard if isinstance(event.detail, StateChange)]

    @property
    def requests(self) -> list[str]:
        return [request.kind for request in self.run.sessions()[-1].requests]


@pytest.fixture
def bench(planned: tuple[Profile, dict[str, np.ndarray]], tmp_path: Path) -> Iterator[Bench]:
    with RunFile.create(tmp_path / "run", planned[0]) as run:
        run.write_plan(planned[1])
        yield Bench(run)


def practise(bench: Bench, **settings: Any) -> None:
    bench.run.profile = bench.run.profile.model_copy(update={"collection": Collection(**settings)})


def complete(bench: Bench) -> bool:
    return bench.run.stops_done() >= set(range(STOPS))


# -- stops again ------------------------------------------------------------------------------------------------------


def test_stops_are_measured_again_as_planned_and_nothing_else_is_visited(bench: Bench) -> None:
    bench.collect()
    before, measured = {name: bench.run.readings(name) for name in bench.run.arms()}, bench.measured
    bench.shift_M = np.array([1e-3, 0.0, 0.0])
    result = bench.collect(again=[5, 2])
    assert (result.replaced, result.outcome) == (4, "complete")
    assert bench.measured == measured + 4
    for name, old in before.items():
        new, (earlier, _) = bench.run.readings(name), earlier_readings(bench.run, name)
        again = np.isin(new.configuration, [2, 5])
        np.testing.assert_array_equal(new.p_M[~again], old.p_M[~again])
        np.testing.assert_allclose(new.p_M[again] - old.p_M[again], [bench.shift_M] * 2, atol=3e-4)
        np.testing.assert_allclose(new.q[again], old.q[again], atol=1e-4)
        np.testing.assert_array_equal(earlier.p_M, old.p_M[again])
        assert new.time_s[again].min() > old.time_s.max()
    assert [one.again for one in bench.run.sessions()] == ["", "3, 6"]


def test_nothing_moves_if_the_disk_cannot_take_the_whole_plan(bench: Bench) -> None:
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bench.run.path.stat().st_size + 100_000, unlimited[1]))
    try:
        with pytest.raises(InputError, match=r"run: collecting 11 stops needs 0.8 MB there, which cannot be written"):
            bench.collect()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert (bench.cell, bench.run.sessions()) == (None, [])


# -- persons ----------------------------------------------------------------------------------------------------------


def test_pause_finishes_the_stop_and_resume_continues(bench: Bench) -> None:
    paused_at: list[set[int]] = []

    def act(request: Request) -> None:
        assert request == "pause"
        assert not any(plant_of(sure(bench.cell)).moving(name) for name in sure(bench.cell).arms)
        paused_at.append(bench.run.stops_done())
        if len(paused_at) == 3:
            bench.control.resume()

    bench.control = Person(act)
    bench.before_measuring[6] = lambda bench: bench.control.pause()
    assert bench.collect().outcome == "complete"
    assert paused_at == [{0, 1, 2}] * 3, "the stop during which the person asked is finished"
    assert bench.states == ["paused", "running"]
    assert bench.requests == ["pause", "resume"]
    assert complete(bench)
    assert bench.run.sessions()[-1].outcome == "complete"


def test_stop_holds_where_a_person_attends_and_resume_measures_the_stop_again(bench: Bench) -> None:
    bench.control = Person(lambda request: bench.control.resume())
    bench.before_measuring[6] = lambda bench: bench.control.stop()
    assert bench.collect().outcome == "complete"
    assert bench.states == ["stopped", "stopped", "running"]
    assert bench.requests == ["stop", "resume"]
    assert complete(bench)
    assert len(bench.run.sessions()) == 1


def test_a_safety_stop_waits_for_the_repair_and_for_the_person(bench: Bench) -> None:
    asked: list[Request] = []

    def act(request: Request) -> None:
        asked.append(request)
        if len(asked) == 2:
            bench.control.resume()  # too early: the arm is not released yet
        if len(asked) == 3:
            bench.arm("left").release()
            bench.control.resume()

    bench.control = Person(act)
    bench.before_measuring[6] = lambda bench: bench.arm("left").protective_stop()
    assert bench.collect().outcome == "complete"
    assert asked == ["stop"] * 3
    assert bench.requests == ["safety stop", "not released", "resume"]
    assert complete(bench)


# -- causes that pass -------------------------------------------------------------------------------------------------


def test_a_broken_beam_is_waited_for(bench: Bench) -> None:
    def cover(bench: Bench) -> None:
        bench.tracker.covered |= {"left"}

    bench.before_measuring[5] = cover
    bench.before_measuring[10] = lambda bench: bench.tracker.covered.clear()
    summary = bench.collect()
    assert (summary.outcome, summary.missing, summary.notes) == ("complete", (), ())
    assert bench.states == ["suspended", "running"]
    assert bench.requests == ["suspend", "resume"]


def test_suspensions_are_bounded_and_reserves_take_the_place(bench: Bench) -> None:
    practise(bench, suspend=Suspend(target=Suspension(times=1, wait=5.0, retry=1.0)))
    covered: list[int] = []

    class Covered(set[str]):
        def __contains__(self, name: object) -> bool:
            stops = len(bench.run.stops_done())
            hidden = name == "left" and stops in (2, 3) and len(covered) < 40
            covered.extend([stops] * hidden)
            return hidden

    def cover(bench: Bench) -> None:
        bench.tracker.covered = Covered()

    bench.before_measuring[1] = cover
    summary = bench.collect()
    assert bench.requests == ["suspend", "give up"]
    assert [(one.stop, one.arm, one.kind) for one in summary.missing] == [
        (2, "left", "not measured"),
        (3, "left", "not measured"),
    ]
    assert bench.run.stops_done() == set(range(STOPS + 2)), "two reserves"
    assert missing_share(bench.run, summary.missing) == 0.0
    assert [event.done for event in bench.heard if event.total][-1] == STOPS + 2
    assert bench.collect(again=[2, 3]).missing == (), "what was covered is seen now"
    assert bench.run.stops_done() == set(range(STOPS + 2)), "no further reserve"
    assert earlier_readings(bench.run, "left")[1] == ()
    assert earlier_readings(bench.run, "right")[0].configuration.tolist() == [2, 3]


def test_a_stalled_computer_resumes_only_where_the_profile_allows_it(bench: Bench) -> None:
    bench.before_measuring[6] = stall
    with pytest.raises(HardwareError, match=r"this computer was silent for 0.4 s; a stop was sent to all arms"):
        bench.collect()
    assert bench.requests == ["host stalled"]
    practise(bench, suspend=Suspend(host_stall=Suspension(times=1, wait=5.0, retry=1.0)))
    bench.before_measuring = {bench.measured + 2: stall}
    bench.collect(resume=True)
    assert bench.requests == ["host stalled", "suspend", "resume"]
    assert complete(bench)


# -- measuring practice -----------------------------------------------------------------------------------------------


def test_references_are_measured_every_k_stops_and_stored(bench: Bench) -> None:
    practise(bench, reference=Reference(every=3, drift=0.001))
    bench.collect()
    assert [(row.name, row.stops_done) for row in bench.run.references()] == [
        (f"arm {name}", stops) for stops in (0, 3, 6, STOPS) for name in ("left", "right")
    ]
    reports = [event.detail for event in bench.heard if isinstance(event.detail, ReferenceReport)]
    assert len(reports) == 4
    assert reports[0].drift_mm == {"arm left": 0.0, "arm right": 0.0}
    assert all(0.0 < drift < 0.1 for report in reports[1:] for drift in report.drift_mm.values())
    assert [one.drift_mm for one in reference_drifts(bench.run)][-2:] == list(reports[-1].drift_mm.values())


def test_drift_above_the_limit_ends_the_session_and_a_person_may_accept_it(bench: Bench) -> None:
    practise(bench, reference=Reference(every=3, drift=150e-6), suspend=Suspend(drift=Suspension(times=0)))

    def bump(bench: Bench) -> None:
        bench.shift_M = np.array([0.0, 0.0, 4e-4])

    bench.before_measuring[6] = bump
    with pytest.raises(HardwareError, match=r"reference arm (left|right): 0\.[34]\d* mm from its first measurement"):
        bench.collect()
    with pytest.raises(HardwareError, match="continue with --resume --accept-drift"):
        bench.collect(resume=True)
    bench.collect(resume=True, accept_drift=True)
    assert complete(bench)


@pytest.mark.parametrize(("precision", "repeats"), [(1e-9, 4), (1e-3, 2)])
def test_repeats_stop_when_the_mean_is_precise_enough(bench: Bench, precision: float, repeats: int) -> None:
    practise(bench, repeat=Repeat(precision=precision, times=4))
    bench.collect()
    assert bench.measured == repeats * 2 * STOPS


def test_stops_that_the_controller_forbids_are_left_out_before_anything_moves(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbids(self: SimulatedArm, q: np.ndarray) -> np.ndarray:
        refused = np.zeros(len(q), dtype=np.bool_)
        refused[3] = self.name == "left"  # the first row is home
        return refused

    monkeypatch.setattr(SimulatedArm, "refused_by_controller", forbids)
    summary = bench.collect()
    assert {(one.stop, one.kind) for one in summary.missing} == {(2, "left out")}
    assert "arm left: the controller's safety limits forbid these joint positions" in summary.missing[0].reason
    assert bench.run.stops_done() == {*range(STOPS + 1)} - {2}


# -- disk, and nothing measured ---------------------------------------------------------------------------------------


def test_a_full_disk_holds_the_reading_until_a_person_freed_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    add_stop = RunFile.add_stop
    full = [True]

    def refused(self: RunFile, stop: int, rows: dict[str, Readings], *others: Any) -> None:
        if stop == 3 and full[0]:
            raise InputError("run.sqlite: database or disk is full")
        add_stop(self, stop, rows, *others)

    def free(request: Request) -> None:
        full[0] = False
        bench.control.resume()

    monkeypatch.setattr(RunFile, "add_stop", refused)
    bench.control = Person(free)
    assert bench.collect().missing == ()
    assert bench.measured == 2 * STOPS, "nothing is measured twice"
    full[0] = True
    assert complete(bench)


def test_nothing_measured_is_a_failure(bench: Bench) -> None:
    practise(bench, suspend=Suspend(target=Suspension(times=0)))
    bench.before_measuring[1] = lambda bench: bench.tracker.covered.update({"left", "right"})
    with pytest.raises(HardwareError, match=r"nothing could be measured: .*something covers it|10 stops in a row"):
        bench.collect()
    assert bench.run.sessions()[-1].outcome == "failed"


def test_an_arm_that_fails_to_brake_is_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(self: SimulatedArm) -> None:
        raise ArmError(f"arm {self.name}: it could not be seen at rest")

    def strike(bench: Bench) -> None:
        monkeypatch.setattr(SimulatedArm, "stop", lost)
        bench.arm("left").protective_stop()

    bench.before_measuring[3] = strike
    with pytest.raises(HardwareError, match=r"NOT SEEN AT REST: arm left[^N]*; arm right"):
        bench.collect()


# -- a stop that comes at an awkward moment ---------------------------------------------------------------------------


def stall(bench: Bench) -> None:
    """The computer was silent, so that the right arm's controller stopped its program."""
    arm = bench.arm("right")
    arm._plant.stop("right")
    arm._listener(HostStalled("arm right: this computer was silent for 0.4 s"))


class Waiting:
    """Does something in the middle of the retry after a stall."""

    def __init__(self, bench: Bench, act: Act) -> None:
        practise(bench, suspend=Suspend(host_stall=Suspension(times=3, wait=30.0, retry=7.0)))
        self.bench, self.act = bench, act
        bench.before_measuring[6] = self.begin

    def begin(self, bench: Bench) -> None:
        stall(bench)
        clock = sure(bench.cell).clock
        wait = clock.wait

        def waits(duration_s: float, sleep: Any) -> None:
            if duration_s == 7.0:
                clock.wait = wait  # type: ignore[method-assign]
                self.act(bench)
            wait(duration_s, sleep)

        clock.wait = waits  # type: ignore[method-assign]


def test_a_stop_during_the_retry_after_a_stall_is_obeyed(bench: Bench) -> None:
    asked: list[Request] = []

    def act(request: Request) -> None:
        asked.append(request)
        if len(asked) > 3:
            bench.control.resume()

    bench.control = Person(act)
    Waiting(bench, lambda bench: bench.control.stop())
    assert bench.collect().outcome == "complete"
    assert asked == ["stop"] * 4
    assert bench.requests[-1:] == ["resume"]
    assert bench.run.sessions()[-1].requests[-1].reason == "resumed by a person"


def test_a_safety_stop_during_the_retry_needs_a_person(bench: Bench) -> None:
    def guard_opened(bench: Bench) -> None:
        bench.arm("left").protective_stop()
        bench.arm("left").release()  # the light curtain is free again

    Waiting(bench, guard_opened)
    with pytest.raises(HardwareError, match=r"silent for 0.4 s"):
        bench.collect()
    assert "resume" not in bench.requests


def test_a_point_that_was_measured_through_a_stop_is_not_stored(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedTracker, "halt", lambda self: None)  # the halt came before the measurement
    measure = SimulatedTracker.measure

    def through(self: SimulatedTracker, *arguments: Any) -> Any:
        point = measure(self, *arguments)
        if self.measured == 6:
            bench.arm("left").emergency_stop()
        return point

    monkeypatch.setattr(SimulatedTracker, "measure", through)
    with pytest.raises(HardwareError, match="emergency stop"):
        bench.collect()
    assert bench.run.stops_done() == {0, 1}


def test_where_no_stop_is_left_nothing_moves_and_nobody_is_asked(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    practise(bench, warm_up=60.0, reference=Reference(every=2))

    def all_but_home(self: SimulatedArm, q: np.ndarray) -> np.ndarray:
        return np.arange(len(q)) > 0

    def refuse_to_move(self: SimulatedArm, *arguments: Any) -> None:
        pytest.fail("an arm was moved")

    monkeypatch.setattr(SimulatedArm, "refused_by_controller", all_but_home)
    monkeypatch.setattr(SimulatedArm, "start_move", refuse_to_move)
    with pytest.raises(HardwareError, match="nothing could be measured: arm left: the controller's safety limits"):
        bench.collect(confirm=lambda start, targets: pytest.fail("a person was asked"))


def test_a_forbidden_stop_is_not_driven_to_by_warm_up_or_reference(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    practise(bench, warm_up=60.0, reference=Reference(every=2, drift=0.001))
    went: list[np.ndarray] = []
    start_move = SimulatedArm.start_move

    def noted(self: SimulatedArm, q: np.ndarray, *rates: Any) -> None:
        went.append(q)
        start_move(self, q, *rates)

    def first_forbidden(self: SimulatedArm, q: np.ndarray) -> np.ndarray:
        return np.arange(len(q)) == (1 if self.name == "left" else -1)

    monkeypatch.setattr(SimulatedArm, "start_move", noted)
    monkeypatch.setattr(SimulatedArm, "refused_by_controller", first_forbidden)
    shown: list[Any] = []

    def confirm(start: Any, targets: Any) -> bool:
        shown.append(targets)
        return True

    bench.collect(confirm=confirm)
    plan = bench.run.read_plan()
    assert not any(np.array_equal(q, plan["left"][0]) for q in went)
    np.testing.assert_array_equal(shown[0]["left"], plan["left"][1])
    np.testing.assert_array_equal(went[0], plan["left"][1])
    assert {row.name for row in bench.run.references()} == {"arm left", "arm right"}


def test_a_motion_that_is_not_confirmed_is_not_made(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedArm, "start_move", lambda *arguments: pytest.fail("an arm was moved"))
    with pytest.raises(InputError, match="the first motion was not confirmed; nothing was moved"):
        bench.collect(confirm=lambda start, targets: False)


def test_arms_that_are_not_at_home_are_confirmed_to_go_there_before_a_reference(bench: Bench) -> None:
    practise(bench, reference=Reference(every=4, drift=0.001))
    homes = {name: np.array(arm.home) for name, arm in bench.run.profile.arms.items()}
    shown: list[Any] = []

    @contextmanager
    def away(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options) as cell:
            arm = cell.arms["left"]
            arm.start_move(homes["left"] + np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]), np.full(6, 0.5), np.full(6, 0.5))
            arm.wait_settled(60.0)
            yield cell

    def confirm(start: Any, targets: Any) -> bool:
        shown.append(targets)
        return False

    with pytest.raises(InputError, match="not confirmed"):
        collect_by(away, bench.run, control=bench.control, confirm=confirm)
    for name, home in homes.items():
        np.testing.assert_array_equal(shown[0][name], home)


@pytest.mark.parametrize("name", ["left", "right", "tracker"])
def test_no_motion_begins_while_a_link_is_unconfirmed(bench: Bench, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Neither arm moves, also if only the link of the other one is in doubt."""
    began: list[str] = []

    def silence(bench: Bench) -> None:
        def silent(*_: object) -> None:
            if name == "tracker":
                raise TrackerLinkLost("tracker: no answer")
            raise LinkLost(f"arm {name}: the dashboard does not answer")

        device = bench.tracker if name == "tracker" else bench.arm(name)
        monkeypatch.setattr(device, "confirm", silent)
        for arm in ("left", "right"):
            monkeypatch.setattr(bench.arm(arm), "start_move", lambda *_, arm=arm: began.append(arm))

    bench.before_measuring[2] = silence  # the last measurement of a stop: a motion comes next
    with pytest.raises(HardwareError, match=r"no answer|does not answer"):
        bench.collect()
    assert began == []


def test_a_stop_while_the_cell_is_opened_ends_the_job(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing moved yet, so there is nothing to hold, also where a person attends the job."""
    control = JobControl(holds=True)
    connect, connected = SimulatedArm.connect, []

    def stopped_meanwhile(arm: SimulatedArm) -> None:
        connect(arm)
        connected.append(arm.name)
        control.stop()

    monkeypatch.setattr(SimulatedArm, "connect", stopped_meanwhile)
    with pytest.raises(Stopped):
        collect_run(bench.run, control=control)
    assert bench.run.stops_done() == set()
    assert bench.run.sessions() == [], "no session began"
