"""Lines of the bridge protocol: values are transmitted bit for bit, damaged lines are refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_wire import BadField, Garbled
from drivers.trackers.protocol import (
    Inclination,
    NotReady,
    Point,
    Preparation,
    TargetLost,
    TrackerError,
    TrackerIdentity,
    TwoFace,
)

DOCUMENT = Path(wire.__file__).with_name("BRIDGE.md")

finite = st.floats(-100, 100)
spread = st.floats(0, 1e-3)
texts = st.text(st.characters(codec="utf-8"), max_size=80)


@st.composite
def points(draw):
    given_air = st.none() | st.floats(0, 90)
    spreads = np.array([draw(spread) for _ in range(6)])
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = spreads
    return Point(
        p_M=np.array([draw(finite) for _ in range(3)]),
        covariance_M=np.maximum(covariance, covariance.T),
        time_s=draw(st.floats(-1e9, 1e9)),
        averaging_s=draw(st.floats(1e-3, 600)),
        temperature_c=draw(given_air),
        pressure_hpa=draw(given_air),
        humidity_percent=draw(given_air),
        precision_M=draw(st.none() | st.just(spreads[:3])),
        face=draw(st.sampled_from([1, 2])),
        tracker_time_s=draw(st.none() | finite),
        host_time_s=draw(st.none() | finite),
        reflector=draw(st.sampled_from(["", "RRR 1.5 in", "0,5° Ø*"])),
        quality=draw(st.sampled_from([(), ("a warning",), ("one", "100 % humid = wet")])),
    )


def same_point(one: Point, other: Point) -> bool:
    arrays = ("p_M", "covariance_M", "precision_M")
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        if name in arrays and getattr(one, name) is not None
        else getattr(one, name) == getattr(other, name)
        for name in Point.__dataclass_fields__
    )


def over_the_wire(fields):
    return wire.decode(wire.encode(7, "ok", fields)).fields


@given(points(), points())
def test_points_arrive_bit_for_bit(one, other):
    assert same_point(wire.read_point(over_the_wire(wire.point_fields(one))), one)
    pair = wire.read_two_face(over_the_wire(wire.two_face_fields(TwoFace(one, other))))
    assert same_point(pair.first, one)
    assert same_point(pair.second, other)


keys = st.from_regex(r"[a-z][a-z0-9._]{0,9}", fullmatch=True)


@given(st.integers(0, wire.LAST_SEQUENCE), st.dictionaries(keys, texts))
def test_any_text_fits_a_field(sequence, fields):
    fields = {key: wire.text(value, 60) for key, value in fields.items()}
    assume(sum(len(key) + 62 for key in fields) < wire.LONGEST_LINE - 50)
    line = wire.encode(sequence, "ok", fields)
    assert re.fullmatch(rb"[\x20-\x7e]+\n", line)
    found = wire.decode(line)
    assert (found.sequence, found.word, found.fields) == (sequence, "ok", fields)


@given(texts, st.integers(4, 300))
def test_a_text_is_cut_to_the_allowed_length(words, most):
    cut = wire.text(words, most)
    line = wire.encode(1, "ok", {"t": cut})
    assert len(line) <= len(wire.encode(1, "ok", {"t": ""})) + most
    assert cut == words or cut.endswith("...")


GOOD = wire.encode(42, "measure", {"id": "0123456789abcdef", "x": "1.5", "y": "-2.25", "z": "0.1", "averaging": "1.0"})


@given(st.integers(0, len(GOOD) - 2), st.integers(1, 255), st.booleans(), st.booleans())
def test_a_damaged_line_is_no_line(place, change, cut, insert):
    damaged = bytearray(GOOD)
    if cut:
        del damaged[place:]
    elif insert:
        damaged.insert(place, change)
    else:
        damaged[place] ^= change
    assume(bytes(damaged).rstrip(b"\r\n").upper() != GOOD.rstrip(b"\n").upper())  # CRC digits may be of either case
    with pytest.raises(Garbled):
        wire.decode(bytes(damaged))


@given(st.binary(max_size=3000))
def test_noise_is_no_line(raw):
    with pytest.raises(Garbled):
        wire.decode(raw)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"1 ok a=1 a=2", "twice"),
        (b"01 ok", "not of the form"),
        (b"1 OK", "not of the form"),
        (b"1  ok", "not of the form"),
        (b"1 ok a", "not of the form"),
        (b"1 ok a=\xe4", "not of the form"),
        (b"1000000 ok", "not of the form"),
        (b"1 ok a=" + b"x" * 3000, "longer than 2048"),
    ],
)
def test_a_whole_line_must_also_be_well_formed(body, why):
    import zlib

    with pytest.raises(Garbled, match=why):
        wire.decode(b"%s*%08X\n" % (body, zlib.crc32(body)))


def test_a_line_that_is_too_long_is_never_written():
    with pytest.raises(ValueError, match="not a line of the bridge protocol"):
        wire.encode(1, "ok", {"a": "x" * 2048})
    with pytest.raises(ValueError, match="not a line of the bridge protocol"):
        wire.encode(1, "Not A Word", {})


@pytest.mark.parametrize("value", ["", "nan", "inf", "1e999", "1_000", "0x10", " 1", "1,5", "--1", "1e", "9" * 40])
def test_invalid_numbers_are_refused(value):
    with pytest.raises(BadField, match="expected a number"):
        wire.read_number({"x": value}, "x", -10, 10)


def test_fields_that_are_missing_or_out_of_range_are_named():
    fields = dict(wire.point_fields(Point(np.ones(3), np.eye(3) * 1e-10, 1.0, 1.0, 20.0)))
    for change, why in (
        ({"x": "1e4"}, "x is '1e4'"),
        ({"cxx": "-1e-12"}, "cxx is '-1e-12'"),
        ({"averaging": "-1"}, "averaging is '-1'"),
        ({"face": "3"}, "face is '3'"),
        ({"humidity": "101"}, "humidity is '101'"),
    ):
        with pytest.raises(BadField, match=re.escape(why)):
            wire.read_point(fields | change)
    for missing in ("z", "cyz", "time", "face"):
        with pytest.raises(BadField, match=f"'{missing}' is missing"):
            wire.read_point({key: value for key, value in fields.items() if key != missing})
    with pytest.raises(BadField, match="not a finite number"):
        wire.point_fields(Point(np.array([1.0, np.nan, 0.0]), np.eye(3), 1.0, 1.0, None))
    with pytest.raises(BadField, match="8 to 64 letters and digits"):
        wire.read_id({"id": "a b"})


def test_other_answers_are_transmitted():
    identity = TrackerIdentity("AT960 MR", "750 123", "LMF 1.10")
    assert wire.read_identity(over_the_wire(wire.identity_fields(identity))) == identity
    for settings in (Preparation(), Preparation("RRR 1.5 in", "precise", 21.25, 990.5, 40.0)):
        assert wire.read_preparation(over_the_wire(wire.preparation_fields(settings))) == settings
    for level in (None, Inclination((1e-5, -2e-5), 3e-6, 15e-6)):
        assert wire.read_inclination(over_the_wire(wire.inclination_fields(level))) == level
    assert wire.read_unmet(over_the_wire(wire.unmet_fields([]))) == []
    many = [f"reason {k}, ö " * 30 for k in range(12)]
    read = wire.read_unmet(over_the_wire(wire.unmet_fields(many)))
    assert read[0].startswith("reason 0, ö reason 0")
    assert read[-1] == "and 7 more"
    with pytest.raises(ValueError, match="accuracy is 'sloppy'"):
        wire.read_preparation({"accuracy": "sloppy"})
    with pytest.raises(ValueError, match="air pressure must lie between"):
        wire.read_preparation({"pressure": "1.01325"})  # bar


def test_errors_keep_their_kind():
    class OfADriver(TrackerError):
        pass

    class OfATarget(TargetLost):
        pass

    for error, kind in (
        (NotReady("a"), "not-ready"),
        (TargetLost("b"), "target-lost"),
        (OfADriver("c"), "failed"),
        (OfATarget("e"), "target-lost"),
        (ValueError("d"), "bad-field"),
    ):
        assert wire.error_fields(error) == {"kind": kind, "text": str(error)}
    for kind, raised in wire.ERRORS.items():
        if kind not in ("held", "version"):
            assert wire.error_fields(raised(""))["kind"] == kind


def test_a_proof_needs_the_token_and_both_nonces():
    proofs = {
        wire.proof(token, side, client, one, two)
        for token in ("a" * 16, "b" * 16)
        for side in ("client", "server")
        for client in ("client-1", "client-2")
        for one in ("n1", "n2")
        for two in ("m1", "m2")
    }
    assert len(proofs) == 32
    assert all(wire.proofs_equal(proof, proof.upper()) for proof in proofs)
    assert not wire.proofs_equal("", proofs.pop())
    assert not wire.proofs_equal("\xe9", "e")


def test_the_lines_in_the_document_are_lines():
    lines = re.findall(r"^    [<>] (.*\*[0-9A-F]{8})$", DOCUMENT.read_text("utf-8"), flags=re.MULTILINE)
    words = [wire.decode(line.encode("ascii")).word for line in lines]
    assert {"hello", "sync", "auth", "prepare", "measure", "wait", "ok", "error", "bye"} <= set(words)


def test_the_proofs_in_the_document_are_right():
    document = DOCUMENT.read_text("utf-8")
    (token,) = re.findall(r"with the token `([^`]+)`", document)
    lines = re.findall(r"^    [<>] (.*\*[0-9A-F]{8})$", document, flags=re.MULTILINE)
    said = [wire.decode(line.encode("ascii")) for line in lines]
    hello = next(line for line in said if line.word == "hello")
    challenge = next(line for line in said if line.fields.get("auth") == "hmac-sha256")
    auth = next(line for line in said if line.word == "auth")
    answer = next(line for line in said if line.word == "ok" and "proof" in line.fields)
    nonces = hello.fields["client"], challenge.fields["nonce"], auth.fields["nonce"]
    assert wire.proofs_equal(auth.fields["proof"], wire.proof(token, "client", *nonces))
    assert wire.proofs_equal(answer.fields["proof"], wire.proof(token, "server", *nonces))
