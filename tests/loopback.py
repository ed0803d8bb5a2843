"""Loopback addresses of this test process: a controller has fixed ports, so each process has addresses of its own."""

from __future__ import annotations

import os
import socket

_NET = os.environ.setdefault("CELLAPP_TESTS_NET", str(1 + os.getpid() % 250))
"""Of a test run, so that two of them on one computer share no address; processes that a test starts inherit it."""
_FIRST_NET = 80


def own_address(number: int) -> str:
    """A loopback address that no other process uses.

    ``number`` (2 to 254) belongs to one module; 41 to 68, 71 to 77 are taken. pytest-xdist names its workers gw0, gw1
    ... in the environment, which the processes that a test starts inherit.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    return f"127.{_NET}.{_FIRST_NET + int(worker.removeprefix('gw'))}.{number}"


def own_arms(number: int) -> dict[str, str]:
    """The addresses ``number`` and the next, of the left and the right arm."""
    return {"left": own_address(number), "right": own_address(number + 1)}


def free_port(host: str) -> int:
    """A port that nobody listens on. At an own address nobody else takes it before the test does."""
    with socket.create_server((host, 0)) as server:
        return int(server.getsockname()[1])
