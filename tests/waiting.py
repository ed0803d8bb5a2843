"""Waits of all tests: none is longer than ``WAIT_S``, and each says what it waited for."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from tests.sure import sure

ROOT = Path(__file__).parents[1]
WAIT_S = 60.0
_LOOK_S = 0.005

T = TypeVar("T")


def until(holds: Callable[[], Any], what: str, wait_s: float = WAIT_S) -> float:
    """Ask again and again until a condition holds; return how long that took [s]."""
    began_s, pause = time.monotonic(), threading.Event()
    while not holds():
        if time.monotonic() - began_s > wait_s:
            pytest.fail(f"not within {wait_s:g} s: {what}")
        pause.wait(_LOOK_S)
    return time.monotonic() - began_s


@contextmanager
def process_of(*words: str, cwd: Path = ROOT, **how: Any) -> Iterator[subprocess.Popen[str]]:
    """A Python program, by its module and arguments, in a process of its own, which does not outlive its test."""
    command, path = [sys.executable, "-m", *words], {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "default"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **how}
    process = subprocess.Popen(command, cwd=cwd, env={**os.environ, **path}, text=True, **pipes)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=WAIT_S)


def within(call: Callable[[], T], what: str, wait_s: float = WAIT_S) -> T:
    """Return what a call returns that may block for ever: a line of a process, the end of a thread."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(call())
        except BaseException as error:  # noqa: BLE001 - raised again where it is waited for
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    try:
        return future.result(wait_s)
    except TimeoutError:
        if future.done():  # the call's own
            raise
        pytest.fail(f"not within {wait_s:g} s: {what}")


def next_line(process: subprocess.Popen[str]) -> str:
    """Return the next line that a process prints."""
    return within(sure(process.stdout).readline, "the next line of the job").strip()
