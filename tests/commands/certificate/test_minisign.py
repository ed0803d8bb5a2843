"""Signatures in minisign's format, against the vector that its implementations test with."""

from __future__ import annotations

import base64

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from cellapp.commands.sign_key.minisign import FormatError, PublicKey, Signature, sign

pytestmark = pytest.mark.fast

PUBLISHED_KEY = "RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3"
PUBLISHED_ID = "E7620F1842B4E81F"
PUBLISHED_SIGNATURE = """untrusted comment: signature from minisign secret key
RUQf6LRCGA9i559r3g7V1qNyJDApGip8MfqcadIgT9CuhV3EMhHoN1mGTkUidF/z7SrlQgXdy8ofjb7bNJJylDOocrCo8KLzZwo=
trusted comment: timestamp:1556193335\tfile:test
y/rUw2y8/hOUYjZU71eHp/Wo1KZ40fGy2VJEDl34XMJM+TX48Ss/17u3IvIfbVR1FkZZSNCisQbuQY+bHwhEBg==
"""
"""Of the four bytes "test"; from the tests of minisign-verify, https://github.com/jedisct1/rust-minisign-verify."""
PUBLISHED_LEGACY = """untrusted comment: signature from minisign secret key
RWQf6LRCGA9i59SLOFxz6NxvASXDJeRtuZykwQepbDEGt87ig1BNpWaVWuNrm73YiIiJbq71Wi+dP9eKL8OC351vwIasSSbXxwA=
trusted comment: timestamp:1555779966\tfile:test
QtKMXWyYcwdpZAlPF7tE2ENJkRd1ujvKjlj1m9RtHTBnZPa5WKU5uWRs5GoP5M/VqE81QFuMKI5k/SfNQUaOAA==
"""
PRIVATE = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
COMMENT = "timestamp:1\tfile:certificate.json\tnumber:7"


def test_the_published_signature_holds_and_nothing_else_does() -> None:
    key, signature = PublicKey.parse(PUBLISHED_KEY), Signature.parse(PUBLISHED_SIGNATURE)
    assert key.id_text == PUBLISHED_ID == signature.id_text
    assert key.line == PUBLISHED_KEY
    assert signature.is_by(key)
    assert signature.holds(b"test", key)
    assert not signature.holds(b"tesT", key)
    assert not signature.holds(b"test", PublicKey.of(PRIVATE))


def test_the_signed_comment_cannot_be_changed() -> None:
    changed = Signature.parse(PUBLISHED_SIGNATURE.replace("1556193335", "1556193336"))
    assert not changed.holds(b"test", PublicKey.parse(PUBLISHED_KEY))


def test_a_signature_of_the_file_itself_is_refused() -> None:
    with pytest.raises(FormatError, match="hashed"):
        Signature.parse(PUBLISHED_LEGACY)


@given(st.binary(max_size=200), st.text(st.characters(exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=50))
def test_what_is_written_is_read_again_and_holds(content: bytes, comment: str) -> None:
    public = PublicKey.of(PRIVATE)
    signature = sign(content, PRIVATE, comment)
    assert Signature.parse(signature.text()) == signature
    assert PublicKey.parse(public.text()) == public
    assert signature.is_by(public)
    assert signature.holds(content, public)
    assert not signature.holds(content + b" ", public)


@given(st.integers(0, 63), st.integers(1, 255))
def test_no_byte_of_a_signature_may_change(place: int, change: int) -> None:
    content, public = b"certificate", PublicKey.of(PRIVATE)
    signature = sign(content, PRIVATE, COMMENT)
    for field in ("signature", "global_signature"):
        raw = bytearray(getattr(signature, field))
        raw[place] ^= change
        parts = {"signature": signature.signature, "global_signature": signature.global_signature, field: bytes(raw)}
        changed = Signature(signature.key_id, parts["signature"], COMMENT, parts["global_signature"])
        assert not changed.holds(content, public)


def test_a_comment_has_one_line() -> None:
    with pytest.raises(FormatError, match="one line"):
        sign(b"", PRIVATE, "one\ntwo")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "untrusted comment: a\n",
        PUBLISHED_SIGNATURE.replace("trusted comment: timestamp", "comment: timestamp"),
        PUBLISHED_SIGNATURE.replace("RUQf", "R%Qf"),
        PUBLISHED_SIGNATURE.replace("RUQf", ""),
        PUBLISHED_SIGNATURE + "more\n",
    ],
    ids=["empty", "one line", "no trusted comment", "not base64", "too short", "five lines"],
)
def test_what_is_no_signature_is_refused(text: str) -> None:
    with pytest.raises(FormatError):
        Signature.parse(text)


@pytest.mark.parametrize(
    "text",
    ["", "RWQ", PUBLISHED_KEY[:-4], base64.b64encode(b"ED" + bytes(40)).decode(), f"{PUBLISHED_KEY}\n{PUBLISHED_KEY}"],
    ids=["empty", "short", "cut", "other algorithm", "two lines"],
)
def test_what_is_no_public_key_is_refused(text: str) -> None:
    with pytest.raises(FormatError):
        PublicKey.parse(text)
