"""The dashboard connection for stops, against dashboards that behave badly: what is taken for a loss, and how soon."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_stop_line import StopLine
from drivers.patience import Patience
from tests.drivers.arms.emulated_ur_cell import PATIENT_S, pause
from tests.waiting import until

pytestmark = pytest.mark.fast

HOST = "127.0.0.1"
GREETING = b"Connected: Universal Robots Dashboard Server\n"
Answer = Callable[[socket.socket, str], bool]
"""Answers one line; whether to serve on."""


def well(link: socket.socket, line: str) -> bool:
    link.sendall(b"Stopped\n" if line == "stop" else b"Program running: false\n")
    return True


def slow(link: socket.socket, line: str) -> bool:
    pause(0.02)
    return well(link, line)


def hang_up(link: socket.socket, line: str) -> bool:
    return False


def chatter(link: socket.socket, line: str) -> bool:
    link.sendall(b"Program running: false\nand nobody asked for this\n")
    return True


@contextmanager
def dashboard(answer: Answer) -> Iterator[int]:
    """A dashboard on a port of its own; ends with its clients."""
    server = socket.create_server((HOST, 0))
    links: list[socket.socket] = []

    def serve(link: socket.socket) -> None:
        with link, suppress(OSError):
            link.sendall(GREETING)
            for line in link.makefile(encoding="ascii"):
                if not answer(link, line.strip()):
                    link.shutdown(socket.SHUT_RDWR)
                    return

    def accept() -> None:
        with suppress(OSError):
            while True:
                links.append(server.accept()[0])
                threading.Thread(target=serve, args=(links[-1],), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield server.getsockname()[1]
    finally:
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join(PATIENT_S)
        for link in links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            link.close()


@contextmanager
def opened(port: int) -> Iterator[tuple[StopLine, list[str]]]:
    lost: list[str] = []
    line = StopLine(HOST, lost.append, port=port)
    line.open()
    try:
        yield line, lost
    finally:
        line.close()


def test_a_dashboard_that_answers_is_no_loss_and_stops() -> None:
    with dashboard(well) as port, opened(port) as (line, lost):
        for _ in range(10):
            line.confirm(Patience(0.3))
            line.stop()
            pause(0.03)
        assert lost == []


def test_answers_reach_those_who_asked_in_order() -> None:
    """Stops of many threads among questions: none gets the answer to another line."""
    with dashboard(slow) as port, opened(port) as (line, lost):
        sent = line._line
        assert sent is not None
        waiting = [(text, sent.send(text)) for text in ("running", "stop", "running", "stop", "stop")]
        for text, answer in waiting:
            assert answer.get(timeout=PATIENT_S) == ("Stopped" if text == "stop" else "Program running: false")
        assert lost == []


@pytest.mark.parametrize("answer", [hang_up, chatter])
def test_a_peer_that_ends_every_connection_is_lost_and_not_asked_without_pause(answer: Answer) -> None:
    asked: list[float] = []

    def counted(link: socket.socket, line: str) -> bool:
        asked.append(time.monotonic())
        return answer(link, line)

    with dashboard(counted) as port, opened(port) as (_, lost):
        until(lambda: answer is chatter or bool(lost), "it is lost")
        pause(0.5)
        assert len(asked) < 25


def test_after_its_end_it_is_not_opened_again() -> None:
    with dashboard(well) as port:
        with opened(port) as (line, lost):
            pass
        assert not [thread for thread in threading.enumerate() if thread.name == f"dashboard of {HOST}"]
        assert lost == []
    with pytest.raises(LinkLost):
        line.stop()
    with pytest.raises(LinkLost):
        line.open()
