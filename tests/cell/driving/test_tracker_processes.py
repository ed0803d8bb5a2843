"""The tracker's bridge is a process of its own that dies, hangs or restarts while the arms move."""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from cellapp.cell.driving.tracker_watch import TrackerMonitor
from drivers.trackers.bridge import BridgeTracker
from tests.latency import attempts
from tests.sure import sure
from tests.waiting import within

pytestmark = pytest.mark.waits

_PATIENT_S = 20.0

BRIDGE = """
import sys
import threading
from drivers.trackers.bridge_server import TrackerService

class There:
    data_age_s = lambda self: 0.0
    connect = disconnect = halt = lambda self: None
    confirm = lambda self, within_s: None

with TrackerService(There(), host=sys.argv[1]) as service:
    print(service.url, flush=True)
    sys.stdin.read()
"""

_WATCHER = """
import sys
import threading
from cellapp.cell.driving.tracker_watch import TrackerMonitor
from drivers.trackers.bridge import BridgeTracker

tracker = BridgeTracker(sys.argv[1])
tracker.connect()
with TrackerMonitor(tracker) as monitor, monitor.watching(lambda reason: print(reason, flush=True)):
    print("watching", flush=True)
    sys.stdin.readline()
tracker.disconnect()
"""


@contextmanager
def process(program: str, argument: str) -> Iterator[subprocess.Popen[str]]:
    """A Python program that ends when its standard input does."""
    with subprocess.Popen(
        [sys.executable, "-c", program, argument], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as running:
        try:
            yield running
        finally:
            running.kill()


def first_line(running: subprocess.Popen[str]) -> str:
    return within(sure(running.stdout).readline, "the first line of the process").strip()


@pytest.mark.parametrize(
    ("how", "within_s", "words"),
    [
        (signal.SIGKILL, 0.3, "see that the tracker's computer runs 'cellapp tracker-bridge PROFILE'"),
        (signal.SIGSTOP, 0.8, "no answer"),
    ],
)
def test_a_bridge_that_dies_or_hangs_while_the_arms_move(how: signal.Signals, within_s: float, words: str) -> None:
    for took in attempts(known=within_s):
        died = queue.SimpleQueue[str]()
        with process(BRIDGE, "127.0.0.1") as bridge:
            tracker = BridgeTracker(first_line(bridge))
            tracker.connect()
            with TrackerMonitor(tracker) as monitor, monitor.watching(died.put):
                began_s = time.monotonic()
                monitor.confirm(_PATIENT_S)
                assert monitor.data_age_s() <= time.monotonic() - began_s
                assert died.empty()
                began_s = time.monotonic()
                bridge.send_signal(how)
                assert words in died.get(timeout=_PATIENT_S)
                took["known"] = time.monotonic() - began_s
            tracker.disconnect()


def test_a_program_that_was_suspended_does_not_take_the_tracker_for_dead() -> None:
    with process(BRIDGE, "127.0.0.1") as bridge, process(_WATCHER, first_line(bridge)) as watcher:
        assert first_line(watcher) == "watching"
        for _ in range(3):
            watcher.send_signal(signal.SIGSTOP)
            threading.Event().wait(0.7)  # longer than any silence that is allowed
            watcher.send_signal(signal.SIGCONT)
            threading.Event().wait(0.1)
        sure(watcher.stdin).write("\n")
        sure(watcher.stdin).close()
        assert within(sure(watcher.stdout).read, "the end of the process") == ""
