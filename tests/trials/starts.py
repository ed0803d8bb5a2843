"""Starts of both arms' drivers with the real client, again and again: ``python -m tests.trials.starts --n 500``.

Each start has new worker processes, as the first one of a day. Failures are printed with what the worker wrote last;
any failure ends the command with exit code 1.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from statistics import median
from typing import Annotated

import typer

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


app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def starts(
    n: Annotated[int, typer.Option("--n", min=1, help="Starts of both arms.")] = 500,
    beside: Annotated[int, typer.Option("--busy", min=0, help="Processes that compute beside them.")] = 0,
) -> None:
    """Start both emulated arms' drivers again and again; exit code 1 if any start fails."""
    failed, took_s = 0, []
    with emulated_cell(), busy(beside):
        for number in range(1, n + 1):
            began_s = time.monotonic()
            failures = failures_of_one_start()
            took_s.append(time.monotonic() - began_s)
            failed += bool(failures)
            for name, reason in failures.items():
                say(f"start {number}, arm {name}: {reason}")
            if number % _SAY_EVERY == 0:
                say(f"{number} starts, {failed} failed")
    each = f"{median(took_s):.2f} s each, {max(took_s):.2f} s at most"
    say(f"{n} starts of {len(HOSTS)} arms, {failed} failed; {each}")
    if failed:
        raise typer.Exit(1)


if __name__ == "__main__":
    app()
