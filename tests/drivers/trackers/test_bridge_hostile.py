"""Damaged lines, slow, silent and hostile clients: the client that holds the tracker goes on measuring."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.trackers import bridge_wire as wire
from tests.approved import assert_refused
from tests.drivers.trackers.bridged import NEST, client

TOKEN = "correct horse battery staple"
WAIT_S = 10.0


@pytest.fixture
def bridge(make_plant):
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}, hello_s=0.5, line_s=0.5) as served:
        yield served


@pytest.fixture
def bridge_with_token(make_plant):
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}, hello_s=0.5, line_s=0.5, token=TOKEN) as served:
        yield served


def holder(bridge, **options):
    return client(bridge.url, timeout_s=1.0, **options)


class Raw:
    """A connection that sends arbitrary bytes."""

    def __init__(self, bridge):
        self._link = socket.create_connection((bridge.host, bridge.port), WAIT_S)
        self._lines = self._link.makefile("rb")
        self.number = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._lines.close()
        self._link.close()

    def send(self, data):
        self._link.sendall(data)

    def send_command(self, word, **fields):
        self.number += 1
        self.send(wire.encode(self.number, word, fields))
        return self

    def next_line(self):
        """Return the next line; None if the bridge has hung up."""
        try:
            raw = self._lines.readline()
        except ConnectionError:
            return None
        return wire.decode(raw) if raw else None

    def ask(self, word, **fields):
        """Send a command and return its answer; skip other lines."""
        self.send_command(word, **fields)
        for _ in range(10_000):
            line = self.next_line()
            if line is None or (line.sequence == self.number and line.word != "wait"):
                return line
        raise AssertionError("the answer did not come")

    def hung_up(self):
        return any(self.next_line() is None for _ in range(1000))


def open_session(raw):
    assert raw.ask("sync", nonce="0123456789").fields["holding"] == "0"
    assert raw.ask("hello", protocol="1", client="a-raw-client").word == "ok"
    assert raw.ask("prepare").word == "ok"
    return raw


def measures(raw, id_):
    x, y, z = (repr(float(value)) for value in NEST)
    return raw.ask("measure", id=id_, x=x, y=y, z=z, averaging="1.0")


def test_a_huge_line_is_refused_and_forgotten(bridge):
    with Raw(bridge) as raw:
        open_session(raw)
        raw.send(b"x" * 3_000_000)
        line = raw.next_line()
        assert (line.sequence, line.fields["kind"]) == (0, "garbled")
        assert "longer than 2048 bytes" in line.fields["text"]
        raw.send(b"\n")
        assert measures(raw, "measurement-1").word == "ok"
        assert all(len(link.received) <= wire.LONGEST_LINE for link in bridge._links.links)


def test_a_slow_sender_is_cut_off_and_disturbs_nobody(bridge):
    with holder(bridge) as tracker, Raw(bridge) as slow:
        slow.send(b"1 hel")
        assert tracker.measure(NEST, 1.0).averaging_s == 1.0
        assert slow.hung_up()
        assert tracker.measure(NEST, 1.0).averaging_s == 1.0


def test_a_client_without_session_gets_nothing(bridge_with_token):
    with holder(bridge_with_token, token=TOKEN) as tracker:
        with Raw(bridge_with_token) as raw:
            for word in ("measure", "halt", "bye", "identify", "prepare", "ping", "nonsense", "auth"):
                answer = raw.ask(word, id="0123456789")
                assert (answer.word, answer.fields["kind"]) == ("error", "no-session")
            assert raw.hung_up()
        assert bridge_with_token.tracker.measured == 0
        tracker.measure(NEST, 1.0)
    assert bridge_with_token.tracker.measured == 1


def test_the_token_cannot_be_circumvented(bridge_with_token):
    client = "a-raw-client"

    def challenge(raw, name=client):
        return raw.ask("hello", protocol="1", client=name).fields["nonce"]

    with holder(bridge_with_token, token=TOKEN) as tracker:
        for case in ("wrong", "empty", "replayed", "other client", "the server's own", "without a challenge"):
            with Raw(bridge_with_token) as raw, Raw(bridge_with_token) as other:
                nonce = challenge(raw)
                proofs = {
                    "wrong": wire.proof("wrong horse battery staple", "client", client, nonce, "mine-mine"),
                    "empty": "",
                    "replayed": wire.proof(TOKEN, "client", client, challenge(other), "mine-mine"),
                    "other client": wire.proof(TOKEN, "client", "somebody-else", nonce, "mine-mine"),
                    "the server's own": wire.proof(TOKEN, "server", client, nonce, "mine-mine"),
                    "without a challenge": wire.proof(TOKEN, "client", "", "", "mine-mine"),
                }
                target = raw
                if case == "without a challenge":
                    target = stranger = other
                    stranger.ask("sync", nonce="0123456789")
                answer = target.ask("auth", nonce="mine-mine", proof=proofs[case])
                assert answer is None or answer.word == "error", case
                assert target.ask("measure", id="0123456789") is None or case == "without a challenge"
        assert bridge_with_token.tracker.measured == 0
        tracker.measure(NEST, 1.0)


def test_a_whole_line_that_makes_no_sense_is_answered_and_harmless(bridge):
    with Raw(bridge) as raw:
        open_session(raw)

        def refused(word: str, *fields: str) -> str:
            answer = raw.ask(word, **dict(one.split("=") for one in fields))
            assert answer.word == "error"
            assert raw.ask("prepare").word == "ok"
            assert measures(raw, "measurement-1").word == "ok"
            return f"{answer.fields['kind']}: {answer.fields['text']}"

        assert_refused(Path(__file__).parent / "approved" / "refused-lines.txt", refused)


def test_a_measurement_needs_a_prepared_tracker(bridge):
    with Raw(bridge) as raw:
        assert raw.ask("hello", protocol="1", client="a-raw-client").word == "ok"
        assert measures(raw, "measurement-1").fields["kind"] == "unprepared"
        assert raw.ask("prepare").word == "ok"
        assert measures(raw, "measurement-1").word == "ok"


def test_a_client_that_never_reads_loses_its_link_but_not_the_bridge(bridge):
    with Raw(bridge) as deaf:
        open_session(deaf)
        line = wire.encode(99, "identify") + wire.encode(98, "sync", {"nonce": "0123456789"})
        deaf._link.settimeout(WAIT_S)
        try:
            for _ in range(2000):
                deaf.send(line * 50)
        except OSError:
            pass
        else:
            pytest.fail("the bridge never dropped it")
        with holder(bridge) as tracker:
            assert tracker.measure(NEST, 1.0).averaging_s == 1.0
