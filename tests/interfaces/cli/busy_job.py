"""A job whose main thread is busy, with arms that note when they brake. Run as a program: its load is the argument.

It prints ``ready``, then a line for each brake and each request with the time on the system's monotonic clock.
"""

from __future__ import annotations

import itertools
import socket
import sqlite3
import sys
import time

import numpy as np

from cellapp.ground.control import Request
from cellapp.interfaces.cli.job import CommandJob
from cellapp.interfaces.cli.program import run_program


def say(line: str) -> None:
    """Write a line; whole, from any thread."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def spin(job: CommandJob) -> None:
    """Pure Python: the main thread gives the interpreter lock away only when asked."""
    for number in itertools.count():
        if number % 1000 == 0:
            job.control.check()


def multiply(job: CommandJob) -> None:
    """Long calls of numpy."""
    matrix = np.ones((1200, 1200))
    while True:
        job.control.check()
        for _ in range(10):
            matrix @ matrix


def query(job: CommandJob) -> None:
    """Long calls of SQLite."""
    connection = sqlite3.connect(":memory:")
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 5000000) SELECT max(i) FROM n"
    while True:
        job.control.check()
        connection.execute(endless).fetchone()


def receive(job: CommandJob) -> None:
    """A socket that nobody writes to."""
    silent, _other = socket.socketpair()
    silent.settimeout(2.0)
    while True:
        job.control.check()
        try:
            silent.recv(1)
        except TimeoutError:
            continue


def persist(job: CommandJob) -> None:
    """A job that a stop alone does not end: it waits for an abort."""
    job.control.wait_while("none", "stop")
    job.control.check()


def hold(job: CommandJob) -> None:
    """Rest, and say when a pause begins and ends."""
    request: Request = "none"
    while True:
        job.control.check()
        before, request = request, job.control.wait_while(request, timeout_s=1.0)
        if request != before and request in ("none", "pause"):
            say(f"request {request}")


def main() -> None:
    """Be busy until a signal ends it."""

    def brake(verb: str) -> None:
        say(f"brake {verb} {time.monotonic()}")

    with CommandJob(None) as job, job.control.brakes(brake):
        say("ready")
        {load.__name__: load for load in (spin, multiply, query, receive, persist, hold)}[sys.argv[1]](job)


if __name__ == "__main__":
    run_program(main)
