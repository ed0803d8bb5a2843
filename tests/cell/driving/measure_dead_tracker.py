"""How soon a tracker whose bridge dies is reported while the arms move; prints a table.

    python -m tests.cell.driving.measure_dead_tracker [TRIES] [QUIET_S]

Exits with 1 where a bar is missed, or where a tracker that lives was reported.
"""

from __future__ import annotations

import queue
import random
import signal
import statistics
import sys
import threading
import time

from cellapp.cell.driving.tracker_watch import monitored, watched
from drivers.trackers.bridge import BridgeTracker
from tests.cell.driving.test_tracker_processes import BRIDGE, first_line, process

_FAULTS = (
    ("killed", signal.SIGKILL, 0.1),
    ("ended", signal.SIGTERM, 0.1),
    ("hung", signal.SIGSTOP, 0.5),
)
"""What happens to the bridge, and the bar of the report [s]."""


def reported_after_s(how: signal.Signals, draw: random.Random) -> float:
    """Return how long after a signal to the bridge the tracker was reported dead [s]."""
    died = queue.SimpleQueue[float]()
    with process(BRIDGE, "127.0.0.1") as bridge:
        tracker = BridgeTracker(first_line(bridge))
        tracker.connect()
        with monitored(tracker) as monitor, watched(monitor, lambda reason: died.put(time.monotonic())):
            threading.Event().wait(draw.uniform(0.2, 0.3))
            began_s = time.monotonic()
            bridge.send_signal(how)
            after_s = died.get(timeout=20.0) - began_s
        tracker.disconnect()
    return after_s


def false_alarms(quiet_s: float) -> tuple[int, float]:
    """Return how often a living tracker was reported in motions of 5 s, and the greatest age of its data [s]."""
    reasons: list[str] = []
    worst_s, until_s = 0.0, time.monotonic() + quiet_s
    with process(BRIDGE, "127.0.0.1") as bridge:
        tracker = BridgeTracker(first_line(bridge))
        tracker.connect()
        with monitored(tracker) as monitor:
            while time.monotonic() < until_s:
                with watched(monitor, reasons.append):
                    for _ in range(250):
                        threading.Event().wait(0.02)
                        worst_s = max(worst_s, monitor.data_age_s())
        tracker.disconnect()
    return len(reasons), worst_s


def main(tries: int = 30, quiet_s: float = 60.0) -> int:
    """Measure, print, and return the exit code."""
    draw, missed = random.Random(1), False
    print("| the bridge's process is | n | median | worst | bar |\n| --- | --- | --- | --- | --- |")
    for words, how, bar_s in _FAULTS:
        times_s = [reported_after_s(how, draw) for _ in range(tries)]
        median, worst = (round(1e3 * value) for value in (statistics.median(times_s), max(times_s)))
        print(f"| {words} | {tries} | {median} ms | {worst} ms | {1e3 * bar_s:.0f} ms |", flush=True)
        missed = missed or max(times_s) > bar_s
    alarms, worst_s = false_alarms(quiet_s)
    print(f"\n{alarms} false alarms in {quiet_s:g} s; greatest age of a sign of life {worst_s:.2f} s")
    return int(missed or alarms > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(word) for word in sys.argv[1:])))
