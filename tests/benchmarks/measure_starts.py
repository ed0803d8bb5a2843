"""How reliably both arms connect, by command: ``python -m tests.benchmarks.measure_starts [STARTS] [BUSY]``.

Connects and disconnects two arms at emulated controllers, both at once, ``STARTS`` times (500), beside ``BUSY`` (0)
processes that compute without a pause. Prints every failure with its reason, then the times. Exits with 1 after one.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from drivers.arms.protocol import ArmError
from drivers.arms.ur import UrArm
from drivers.arms.ur_settings import UrSettings
from tests.drivers.arms.emulated_ur_cell import HOSTS, driven, emulated_cell

_BUSY = "while True: pass"


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Processes that compute without a pause."""
    started = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


class Starts:
    """Times of connecting [s], and why it failed."""

    def __init__(self) -> None:
        self.took_s: list[float] = []
        self.failures: list[str] = []

    def once(self, number: int, arm: UrArm) -> None:
        """Connect and disconnect an arm."""
        began_s = time.monotonic()
        try:
            arm.connect()
            self.took_s.append(time.monotonic() - began_s)
            arm.disconnect()
        except ArmError as error:
            after_s = time.monotonic() - began_s
            self.failures.append(f"start {number}, after {after_s:.2f} s: {error}")
            sys.stdout.write(f"{self.failures[-1]}\n")
            sys.stdout.flush()


def main(starts: int = 500, beside: int = 0) -> int:
    """Connect ``starts`` times and print; return the exit code."""
    seen = Starts()
    with ExitStack() as stack:
        stack.enter_context(emulated_cell(HOSTS))
        arms = {name: stack.enter_context(driven(name, UrSettings(host=host))) for name, host in HOSTS.items()}
        stack.enter_context(busy(beside))
        for number in range(1, starts + 1):
            threads = [threading.Thread(target=seen.once, args=(number, arm)) for arm in arms.values()]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    took_s = sorted(seen.took_s)
    sys.stdout.write(
        f"{starts} starts of {len(HOSTS)} arms beside {beside} busy processes: {len(seen.failures)} failed; connected"
        f" after {statistics.median(took_s):.2f} s (median), {took_s[-1]:.2f} s (longest)\n"
    )
    return int(bool(seen.failures))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:3])))
