"""Requests of a person: pause, resume, stop, abort, and the way to the brakes."""

from __future__ import annotations

import threading

import pytest

from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.progress import Cancelled


def test_stop_calls_the_brakes_in_the_callers_thread_when_the_request_stands() -> None:
    control, braked = JobControl(), list[tuple[str, str, int]]()
    with control.brakes(lambda verb: braked.append((verb, control.request, threading.get_ident()))):
        control.stop()
    assert braked == [("stop", "stop", threading.get_ident())]
    assert control.request == "stop"


def test_a_job_that_nobody_attends_ends_with_stop() -> None:
    control = JobControl()
    with control.brakes(lambda verb: None):
        control.stop()
        with pytest.raises(Stopped):
            control.check()
    assert control.cancelled


def test_an_attended_job_holds_and_resumes() -> None:
    control = JobControl(holds=True)
    with control.brakes(lambda verb: None):
        control.stop()
        control.check()
        requests = [control.request]
        control.resume()
        assert [*requests, control.request] == ["stop", "none"]


def test_an_attended_job_without_arms_has_nothing_to_hold() -> None:
    control = JobControl(holds=True)
    control.stop()
    with pytest.raises(Stopped):
        control.check()


def test_abort_ends_every_job_and_cannot_be_taken_back() -> None:
    control = JobControl(holds=True)
    with control.brakes(lambda verb: None):
        control.stop()
        control.abort()
        control.resume()
        control.stop()
        control.pause()
        with pytest.raises(Aborted):
            control.check()
    assert issubclass(Aborted, Cancelled)


def test_pause_does_not_brake_and_stop_goes_before_pause() -> None:
    control, braked = JobControl(), list[str]()
    with control.brakes(braked.append):
        control.pause()
        control.check()
        assert (control.request, braked) == ("pause", [])
        control.stop()
        control.pause()
        assert (control.request, braked) == ("stop", ["stop"])


def test_a_request_that_stands_brakes_a_cell_that_opens_later() -> None:
    control, braked = JobControl(), list[str]()
    control.stop()
    with control.brakes(braked.append):
        assert braked == ["stop"]


def test_waiting_ends_with_the_request() -> None:
    control = JobControl()
    control.pause()
    threading.Timer(0.01, control.resume).start()
    assert control.wait_while("pause", timeout_s=30.0) == "none"
    threading.Timer(0.01, control.stop).start()
    assert control.wait(30.0)


def test_who_leaves_is_named_once_and_nothing_resumes() -> None:
    control, braked = JobControl(holds=True), list[tuple[str, str]]()
    with control.brakes(lambda verb: braked.append((verb, control.left))):
        control.leave("the terminal was closed")
        control.leave("the application ended")
        control.resume()
        with pytest.raises(Stopped, match="the terminal was closed"):
            control.check()
    assert braked == [("stop", "the terminal was closed")]
    assert (control.request, control.left) == ("stop", "the terminal was closed")
