"""A relay passes what comes, takes nothing while silent, refuses while closed, and works again afterwards."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from tests.trials.tcp_relay import TcpRelay

pytestmark = pytest.mark.fast

WAIT_S = 10.0


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that answers what it is sent, one client after the other."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            while True:
                try:
                    client, _ = listening.accept()
                except OSError:
                    return  # the fixture ends
                with client:
                    while data := client.recv(1024):
                        client.sendall(data)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listening.getsockname()[:2]
        listening.shutdown(socket.SHUT_RDWR)
    thread.join(WAIT_S)


def client_of(relay: TcpRelay) -> socket.socket:
    return socket.create_connection((relay.host, relay.port), WAIT_S)


def echoed(client: socket.socket, text: bytes) -> bytes:
    client.sendall(text)
    return client.recv(1024)


def sent_often(client: socket.socket, text: bytes) -> None:
    for _ in range(100):
        echoed(client, text)


def test_what_is_sent_in_silence_arrives_when_it_ends(echo: tuple[str, int]) -> None:
    with TcpRelay(echo) as relay, client_of(relay) as client:
        assert echoed(client, b"one") == b"one"
        relay.set("silent")
        client.settimeout(0.1)
        with pytest.raises(TimeoutError):
            sent_often(client, b"two")  # what comes before the relay has noticed is still answered
        relay.set("open")
        client.settimeout(WAIT_S)
        assert client.recv(1024) == b"two"


def test_a_closed_relay_ends_connections_and_refuses_until_it_opens(echo: tuple[str, int]) -> None:
    with TcpRelay(echo) as relay:
        with client_of(relay) as client:
            assert echoed(client, b"one") == b"one"
            relay.set("closed")
            assert client.recv(1024) == b""
        with pytest.raises(ConnectionRefusedError):
            client_of(relay)
        relay.set("open")
        for _ in range(1000):
            try:
                client = client_of(relay)
                break
            except ConnectionRefusedError:
                threading.Event().wait(0.01)
        with client:
            assert echoed(client, b"two") == b"two"


def test_a_device_that_is_not_there_ends_the_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        address = gone.getsockname()[:2]
    with TcpRelay(address) as relay, client_of(relay) as client:
        assert client.recv(1024) == b""
