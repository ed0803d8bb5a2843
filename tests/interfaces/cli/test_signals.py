"""Signals of a person reach the brakes at once, whatever the main thread does, and end the job as they should."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from tests.latency import attempts
from tests.waiting import WAIT_S, next_line, process_of

BAR_S = 0.1
LOADS = ("spin", "multiply", "query", "receive")

pytestmark = [
    pytest.mark.waits,
    pytest.mark.timeout(120),
    pytest.mark.skipif(sys.platform == "win32", reason="a parent cannot send these signals on Windows"),
]


@contextmanager
def busy(load: str) -> Iterator[subprocess.Popen[str]]:
    """The job as a process, ready."""
    with process_of("tests.interfaces.cli.busy_job", load) as process:
        assert next_line(process) == "ready"
        yield process


def brake_after(process: subprocess.Popen[str], number: int) -> tuple[str, float]:
    """Send a signal; return with which verb the arms braked, and after which time [s]."""
    sent_s = time.monotonic()
    process.send_signal(number)
    _, verb, braked_s = next_line(process).split()
    return verb, float(braked_s) - sent_s


@pytest.mark.parametrize("load", LOADS)
def test_ctrl_c_brakes_within_the_bar_whatever_the_main_thread_does(load: str) -> None:
    for took in attempts(braked=BAR_S):
        with busy(load) as process:
            verb, took["braked"] = brake_after(process, signal.SIGINT)
            assert verb == "stop"
            _, said = process.communicate(timeout=WAIT_S)
            assert process.returncode == 4
            assert "stop: all arms brake now" in said
            assert "'cellapp collect DIR --resume'" in said


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_other_ways_to_end_a_program_stop_too(number: int) -> None:
    with busy("hold") as process:
        assert brake_after(process, number)[0] == "stop"
        process.communicate(timeout=WAIT_S)
        assert process.returncode == 4


def test_the_second_interrupt_aborts_at_once() -> None:
    with busy("persist") as process:
        assert brake_after(process, signal.SIGINT)[0] == "stop"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=WAIT_S)
        assert process.returncode == 4
        assert "aborted" in said


@pytest.mark.parametrize("load", ["query", "hold"])
def test_a_hangup_that_comes_twice_stays_a_stop(load: str) -> None:
    with busy(load) as process:
        assert brake_after(process, signal.SIGHUP)[0] == "stop"
        ended_s = time.monotonic() + WAIT_S
        while process.poll() is None and time.monotonic() < ended_s:  # at every step until it is gone
            process.send_signal(signal.SIGHUP)
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.001)
        _, said = process.communicate(timeout=WAIT_S)
        assert process.returncode == 4
        assert "aborted" not in said


def test_ctrl_z_pauses_instead_of_freezing_a_program_whose_arms_move() -> None:
    with busy("hold") as process:
        for number, request in (
            (signal.SIGTSTP, "pause"), (signal.SIGTSTP, "none"), (signal.SIGTSTP, "pause"),
        ):  # fmt: skip
            process.send_signal(number)
            assert next_line(process) == f"request {request}"
        process.send_signal(signal.SIGCONT)  # no person beside the cell: the pause stands
        assert brake_after(process, signal.SIGINT)[0] == "stop"
        _, said = process.communicate(timeout=WAIT_S)
        assert "pause: the arms rest after this stop" in said
        assert "resume: the job continues" in said


def test_a_stop_is_not_resumed_by_a_signal() -> None:
    with busy("query") as process:
        brake_after(process, signal.SIGINT)
        process.send_signal(signal.SIGCONT)
        process.communicate(timeout=WAIT_S)
        assert process.returncode == 4
