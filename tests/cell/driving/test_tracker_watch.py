"""The tracker is asked whether it answers, between the job's calls, and watched while the arms move."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

import numpy as np
import pytest

from cellapp.cell.driving.live_model import Suspicions
from cellapp.cell.driving.measuring import ReferenceSmr, reference_jumps
from cellapp.cell.driving.tracker_watch import TrackerMonitor, unwatched
from cellapp.estimation.calibration.online import OnlineFit
from cellapp.ground.progress import Suspicion
from cellapp.robot.kinematics.transforms import rotation_from_vector
from drivers.trackers.protocol import StreamLimits, Tracker, TrackerLinkLost, TrackerTimeout, stream_of
from tests.latency import attempts
from tests.series import Array, Series, series, twin

_PATIENT_S = 20.0


def slept(duration_s: float) -> Callable[[], list[str]]:
    """An answer that takes its time."""

    def answer() -> list[str]:
        threading.Event().wait(duration_s)
        return []

    return answer


class Answering:
    """A tracker that answers with ``answer()``, and complains when two calls overlap."""

    def __init__(self, answer: Callable[[], Any] = list) -> None:
        self.answer = answer
        self.asked = threading.Semaphore(0)
        self.overlapped = False
        self._at_work = threading.Lock()

    def confirm(self, within_s: float) -> None:
        self._call(self.answer)
        self.asked.release()

    def unmet(self) -> list[str]:
        return cast(list[str], self._call(slept(0.02)))

    def data_age_s(self) -> float:
        return 0.0

    def _call(self, act: Callable[[], Any]) -> Any:
        if not self._at_work.acquire(blocking=False):
            self.overlapped = True
            return None
        try:
            return act()
        finally:
            self._at_work.release()


def as_tracker(double: Answering) -> Tracker:
    return cast(Tracker, double)


def is_lost() -> None:
    raise TrackerLinkLost("tracker: the link is cut")


def test_a_link_lost_while_the_arms_move_is_reported_at_once_and_once() -> None:
    for took in attempts(reported=0.5):
        tracker, died = Answering(), queue.SimpleQueue[str]()
        with TrackerMonitor(as_tracker(tracker)) as monitor, monitor.watching(died.put):
            tracker.answer = is_lost
            began_s = time.monotonic()
            assert died.get(timeout=_PATIENT_S) == "tracker: the link is cut"
            took["reported"] = time.monotonic() - began_s
            for _ in range(2):
                tracker.asked = threading.Semaphore(0)
                tracker.answer = lambda: None
                assert tracker.asked.acquire(timeout=_PATIENT_S)
        assert died.empty()


@pytest.mark.parametrize("error", [TrackerLinkLost("tracker: gone"), TrackerTimeout("tracker: still at work")])
def test_a_tracker_that_is_not_confirmed_is_reported_before_the_arms_move(error: Exception) -> None:
    def fails() -> None:
        raise error

    tracker, died = as_tracker(Answering(fails)), list[str]()
    with unwatched(tracker, died.append), TrackerMonitor(tracker) as monitor, monitor.watching(died.append):
        assert died == [str(error)] * 2


def test_silence_is_reported_while_the_question_still_hangs() -> None:
    for took in attempts(reported=1.0):
        hanging, tracker, died = threading.Event(), Answering(), queue.SimpleQueue[str]()
        with TrackerMonitor(as_tracker(tracker)) as monitor, monitor.watching(died.put):
            tracker.answer = partial(hanging.wait, _PATIENT_S)
            began_s = time.monotonic()
            assert died.get(timeout=_PATIENT_S) == "tracker: no answer for 0.4 s while the arms moved"
            took["reported"] = time.monotonic() - began_s
            assert took["reported"] > 0.3
            hanging.set()
        assert died.empty()


def test_questions_and_calls_never_overlap_and_both_go_on() -> None:
    tracker = Answering(lambda: threading.Event().wait(0.005))
    with TrackerMonitor(as_tracker(tracker)) as monitor:
        for _ in range(15):
            assert monitor.unmet() == []
            monitor.confirm(1.0)
        assert tracker.asked.acquire(timeout=_PATIENT_S)
    assert not tracker.overlapped


def test_a_call_of_the_job_is_no_silence() -> None:
    tracker, died = Answering(), queue.SimpleQueue[str]()
    with TrackerMonitor(as_tracker(tracker)) as monitor, monitor.watching(died.put):
        tracker.unmet = slept(0.8)  # type: ignore[method-assign]
        monitor.unmet()
    assert died.empty()


def test_a_silent_tracker_at_rest_is_seen_only_and_reported_at_the_next_motion() -> None:
    tracker, died = Answering(), queue.SimpleQueue[str]()
    with TrackerMonitor(as_tracker(tracker)) as monitor:
        with monitor.watching(died.put):
            assert tracker.asked.acquire(timeout=_PATIENT_S)
        tracker.answer = is_lost
        assert not tracker.asked.acquire(timeout=0.6)
        assert died.empty()
        with monitor.watching(died.put):
            assert died.get(timeout=0.0) == "tracker: the link is cut"
        tracker.answer = lambda: None
        with monitor.watching(died.put):
            assert died.empty()


class Streaming(Answering):
    """It measures moving SMRs, as it says."""

    def stream_limits(self) -> StreamLimits:
        return cast(StreamLimits, self._call(lambda: StreamLimits(0.001, 1.0)))

    def start_track(self, expected_M: Any, interval_s: float, lost: Any, received: Any) -> None:
        self._call(lambda: None)

    def end_track(self) -> str:
        return cast(str, self._call(lambda: "a track"))


def test_a_monitor_can_do_what_its_tracker_can() -> None:
    assert stream_of(TrackerMonitor(as_tracker(Answering()))) is None
    monitor = TrackerMonitor(as_tracker(Streaming()))
    monitor.start_track(np.zeros(3), 0.01, lambda error: None)
    assert stream_of(monitor) is monitor
    assert monitor.end_track() == "a track"  # type: ignore[comparison-overlap]
    assert monitor.data_age_s() == 0.0


# -- Suspicions: none in a clean series with gravity and backlash; faults are named within a few stops, and once -------

STOPS, BEGIN = 130, 80
SEEDS = [11, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (12, 13))]
Fault = Callable[[Mapping[str, Series]], None]


def raised(
    seed: int, fault: Fault | None = None, stops: int = STOPS, *, short_ways: bool = False
) -> list[tuple[int, Suspicion]]:
    """Suspicions of a series by the stop at which they were raised; ``fault`` changes its measured points."""
    readings = series(seed, stops, short_ways=short_ways)
    if fault is not None:
        fault(readings)
    profile = twin()
    fits = {name: OnlineFit(profile, name, one.q) for name, one in readings.items()}
    watch = Suspicions({name: np.array(arm.smr.normal) for name, arm in profile.arms.items()})
    found = []
    for stop in range(stops):
        for name, one in readings.items():
            fits[name].add([stop], one.q[[stop]], one.p_M[[stop]], one.covariance_M[[stop]])
        found += [(stop, one) for one in watch.at_stop(stop, {name: fit.innovation for name, fit in fits.items()})]
    return found


def slip(arm: str, offset_F: Array) -> Fault:
    """The SMR of an arm moves on its flange."""

    def put(readings: Mapping[str, Series]) -> None:
        readings[arm].p_M[BEGIN:] += readings[arm].R_M_F[BEGIN:] @ offset_F

    return put


def bump(readings: Mapping[str, Series]) -> None:
    """The tracker tilts by 0.2 mrad."""
    tilt = rotation_from_vector([0.12e-3, 0.16e-3, 0.0])
    for one in readings.values():
        one.p_M[BEGIN:] = one.p_M[BEGIN:] @ tilt.T


def play(readings: Mapping[str, Series]) -> None:
    """The left SMR is elsewhere on its flange at every stop."""
    left = readings["left"]
    offsets_F = np.random.default_rng(0).normal(0.0, 0.2e-3, (STOPS - BEGIN, 3))
    left.p_M[BEGIN:] += np.einsum("nij,nj->ni", left.R_M_F[BEGIN:], offsets_F)


def other_smr(readings: Mapping[str, Series]) -> None:
    """At one stop the tracker measures the right SMR for the left one."""
    readings["left"].p_M[BEGIN] = readings["right"].p_M[BEGIN] + 20e-6


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_gravity_and_backlash_raise_nothing(seed):
    assert raised(seed, stops=200) == []


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 4))])
def test_an_eccentric_encoder_raises_nothing_where_stops_follow_each_other_on_short_ways(seed):
    assert raised(seed, stops=200, short_ways=True) == []


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("arm", ["left", "right"])
def test_an_smr_that_slips_is_named_within_five_stops_and_once(seed, arm):
    [(stop, suspicion)] = raised(seed, slip(arm, np.array([0.18e-3, -0.24e-3, 0.0])))
    assert BEGIN < stop <= BEGIN + 4
    assert (suspicion.kind, suspicion.arm) == ("loose SMR", arm)
    assert f"arm {arm}: since stop {BEGIN + 1} its SMR is 0." in suspicion.text
    size_mm = float(suspicion.text.split(" its SMR is ")[1].split(" mm")[0])
    assert size_mm == pytest.approx(0.3, abs=0.12)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bumped_tracker_is_named_within_five_stops_and_once(seed):
    [(stop, suspicion)] = raised(seed, bump)
    assert BEGIN <= stop <= BEGIN + 4
    assert (suspicion.kind, suspicion.arm) == ("tracker moved", None)
    assert "was the tracker touched?" in suspicion.text


def test_an_smr_with_play_is_named():
    stop, suspicion = raised(14, play)[0]
    assert BEGIN < stop <= BEGIN + 10
    assert (suspicion.kind, suspicion.arm) == ("loose SMR", "left")
    assert "scatter more than before" in suspicion.text


def test_the_other_arms_smr_is_named_at_once():
    [(stop, suspicion)] = raised(15, other_smr)
    assert stop == BEGIN
    assert (suspicion.kind, suspicion.arm) == ("wrong SMR", "left")
    assert f"the reading of stop {BEGIN + 1} is" in suspicion.text
    assert "where the SMR of arm right should be" in suspicion.text


def test_an_smr_of_another_size_is_a_wrong_one():
    [(stop, suspicion)] = raised(16, slip("right", np.array([0.0, 0.0, 3.2e-3])))
    assert stop <= BEGIN + 4
    assert (suspicion.kind, suspicion.arm) == ("wrong SMR", "right")
    assert "3.2 mm off along its axis" in suspicion.text


def test_smrs_that_are_swapped_from_the_start_fit_no_geometry():
    def swap(readings: Mapping[str, Series]) -> None:
        left, right = readings["left"].p_M.copy(), readings["right"].p_M.copy()
        readings["left"].p_M[:], readings["right"].p_M[:] = right, left

    found = raised(17, swap, stops=40)
    assert {(one.kind, one.arm) for _, one in found} == {("wrong SMR", "left"), ("wrong SMR", "right")}
    assert all("fit no geometry" in one.text for _, one in found)


NESTS = {"n1": np.array([1.0, 0.0, 0.0]), "n2": np.array([0.0, 2.0, 0.0])}
HOMES = {"arm left": np.array([3.0, 1.0, 0.0]), "arm right": np.array([3.0, -1.0, 0.0])}


def references(*shifts: Mapping[str, float]) -> list[list[tuple[str, str | None]]]:
    """Kind and arm of what is raised at each reference measurement; shifts [m] of references from their places."""
    found: list[list[tuple[str, str | None]]] = []
    before: dict[ReferenceSmr, np.ndarray] = {}
    for shift in shifts:
        points = {name: p + np.array([0.0, 0.0, shift.get(name, 0.0)]) for name, p in (NESTS | HOMES).items()}
        named = {
            ReferenceSmr("nest" if one in NESTS else "arm", one.removeprefix("arm ")): p for one, p in points.items()
        }
        found.append([(one.kind, one.arm) for one in reference_jumps(before, named, 100e-6)])
        before = named
    return found


def test_references_that_stand_still_raise_nothing():
    assert references({}, {"n1": 50e-6}, {"arm left": -50e-6}) == [[], [], []]
    creep = [dict.fromkeys(NESTS, size) for size in (0.0, 60e-6, 120e-6, 130e-6)]
    assert references(*creep) == [[], [], [], []], "a drift suspends the job"


def test_all_references_that_jump_mean_the_tracker_and_once():
    jump = dict.fromkeys(NESTS | HOMES, 0.5e-3)
    assert references({}, jump, jump) == [[], [("tracker moved", None)], []]


def test_one_reference_that_jumps_means_its_own_smr():
    assert references({}, {"arm left": 0.3e-3}) == [[], [("loose SMR", "left")]]
    assert references({}, {"n1": 0.3e-3}) == [[], [("loose SMR", None)]]
