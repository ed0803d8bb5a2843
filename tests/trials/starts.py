"""Starts of both arms' drivers with the real client, again and again: ``python -m tests.trials.starts --n 500``.

Each start has new worker processes, as the first one of a day. Failures are printed with what the worker wrote last;
any failure ends the command with exit code 1.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from statistics import median

from drivers.arms.ur import UrArm
from tests.drivers.arms.emulated_ur_cell import HOSTS, drivers_of, emulated_cell

_SAY_EVERY = 50


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Processes that compute without a pause."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def failure_of(arm: UrArm) -> str:
    """Connect an arm that is closed; return why that failed, or an empty text."""
    try:
        arm.connect()
    except Exception as error:  # noqa: BLE001 - every failure is what is looked for
        return f"{type(error).__name__}: {error}"
    return ""


def failures_of_one_start(hosts: Mapping[str, str] = HOSTS) -> dict[str, str]:
    """Connect and disconnect both arms at the same time; return the reasons of failures by arm."""
    with drivers_of(hosts) as arms, ThreadPoolExecutor(len(hosts)) as pool:
        reasons = dict(zip(arms, pool.map(failure_of, arms.values()), strict=True))
    return {name: reason for name, reason in reasons.items() if reason}


def say(line: str) -> None:
    """Show a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(arguments: list[str] | None = None) -> int:
    """Start ``--n`` times beside ``--busy`` processes that compute; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=500, help="starts of both arms")
    parser.add_argument("--busy", type=int, default=0, help="processes that compute beside them")
    asked = parser.parse_args(arguments)
    failed, took_s = 0, []
    with emulated_cell(), busy(asked.busy):
        for number in range(1, asked.n + 1):
            began_s = time.monotonic()
            failures = failures_of_one_start()
            took_s.append(time.monotonic() - began_s)
            failed += bool(failures)
            for name, reason in failures.items():
                say(f"start {number}, arm {name}: {reason}")
            if number % _SAY_EVERY == 0:
                say(f"{number} starts, {failed} failed")
    each = f"{median(took_s):.2f} s each, {max(took_s):.2f} s at most"
    say(f"{asked.n} starts of {len(HOSTS)} arms, {failed} failed; {each}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
