"""A job with arms in a process of its own, in the run whose folder is the argument; ``batch``: nobody attends it.

It prints ``ready``, then a line for each brake with the time on the system's monotonic clock, and ends by itself when
its standard input is closed.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

from cellapp.cell.driving.requests import taking_requests
from cellapp.ground.control import JobControl
from cellapp.ground.progress import Cancelled, MotionBegun, StateChange
from tests.interfaces.cli.busy_job import say

Q = {"left": (0.1, 0.2), "right": (0.0, 0.0, 0.0)}


def main() -> int:
    """Move until somebody ends it."""
    folder, control, over = Path(sys.argv[1]), JobControl(holds="batch" not in sys.argv), threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        over.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    try:
        with (
            taking_requests(folder, control, "collect"),
            control.brakes(lambda verb: say(f"brake {verb} {time.monotonic()}")),
        ):
            control.tell("collect", 2, 30, detail=MotionBegun(2, Q, Q, 4.0))
            say("ready")
            told = "none"
            while not over.wait(0.005):
                control.check()
                if control.request != told:
                    told = control.request
                    state = StateChange({"none": "running", "pause": "paused"}.get(told, "stopped"), "a person asked")  # type: ignore[arg-type]  # one of its words
                    control.tell("collect", 2, 30, detail=state)
    except Cancelled:
        return 4
    return 0


if __name__ == "__main__":
    sys.exit(main())
