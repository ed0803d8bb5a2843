"""Result of ``init``."""

from __future__ import annotations

from cellapp.ground.results import Result


class InitResult(Result, schema="cellapp-init"):
    """``init``: the profile that was written, and what is to be known about it; ``readings`` are the converted ones,
    ``joints`` the file of joint positions of a motion, ``points`` that of its points, where it is known."""

    profile: str
    notes: tuple[str, ...] = ()
    readings: str | None = None
    joints: str | None = None
    points: str | None = None
    omitted_when_none = frozenset({"readings", "joints", "points"})
