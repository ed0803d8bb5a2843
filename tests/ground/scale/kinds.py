"""A kind of task for tests: it squares a number, or does what a task must not do."""

from __future__ import annotations

import math
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, Self

from cellapp.ground.errors import InputError
from cellapp.ground.results import Record
from cellapp.ground.scale.task import Batch, TaskKind

LONGEST_S = 30.0
"""How long anything is waited for at most."""


class Shared(Record):
    """``offset`` is added to every square; tasks count themselves in ``folder``, and call a test at ``port``."""

    folder: str
    port: int = 0
    offset: float = 0.0


class Number(Record):
    """One number, and what its task does: return, overflow, call the test and wait for it, fail, or end its process."""

    value: int
    deed: Literal["return", "overflow", "call", "fail", "die", "die once"] = "return"


class Square(Record):
    square: float


def _square(shared: Shared, number: Number) -> Square:
    place = Path(shared.folder) / f"begun-{number.value}"
    with place.open("a", encoding="ascii") as file:
        file.write(f"{os.getpid()}\n")
    first = len(place.read_text(encoding="ascii").splitlines()) == 1
    if number.deed == "fail":
        raise InputError(f"{number.value} has no square")
    if number.deed == "die" or (number.deed == "die once" and first):
        os._exit(9)
    if number.deed == "overflow":
        return Square(square=math.inf)
    if number.deed == "call":
        with socket.create_connection(("127.0.0.1", shared.port), timeout=LONGEST_S) as line:
            line.sendall(f"{number.value} {os.getpid()}\n".encode())
            line.recv(1)
    return Square(square=number.value**2 + shared.offset)


SQUARES = TaskKind("tests.ground.scale.kinds:SQUARES", Shared, Number, Square, lambda shared: shared, _square)


def squares(shared: Shared, *numbers: Number) -> Batch[Shared, Shared, Number, Square]:
    """A batch of tasks."""
    return Batch(SQUARES, shared, numbers, [f"number {one.value}" for one in numbers])


def begun(folder: Path) -> dict[int, int]:
    """Number -> how often its task was begun."""
    return {
        int(path.name.removeprefix("begun-")): len(path.read_text(encoding="ascii").splitlines())
        for path in folder.glob("begun-*")
    }


class Call:
    """A task that waits for the test: its number, and the process that computes it."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        with line.makefile(encoding="ascii") as text:
            value, pid = text.readline().split()
        self.value, self.pid = int(value), int(pid)

    def answer(self) -> None:
        """Let the task end."""
        self._line.close()

    def ended(self) -> bool:
        """Wait for the end of the process."""
        with self._line:
            return self._line.recv(1) == b""


class Switchboard:
    """Where tasks call."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self.port = int(listener.getsockname()[1])

    @classmethod
    @contextmanager
    def opened(cls) -> Iterator[Self]:
        """Listen on a free port of loopback."""
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.settimeout(LONGEST_S)
            yield cls(listener)

    def next_call(self) -> Call:
        """Wait for the next task that calls."""
        line, _ = self._listener.accept()
        line.settimeout(LONGEST_S)
        return Call(line)
