"""Result of ``rehearse``, and the record of the rungs beside a profile."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.driving.rungs import RungName
from cellapp.ground.results import Record, Result


class RehearsedMotionRecord(Record):
    """A motion: its stop, from 1; None on other ways; its time, and what it should take [s]; per arm the largest
    distance of a joint from where it was commanded [mrad]."""

    stop: int | None
    seconds: float
    expected_s: float
    off_mrad: Mapping[str, float]


class RehearseResult(Result, schema="cellapp-rehearse"):
    """``rehearse``: what happened on one rung; stops count from 1.

    ``controllers`` are arm -> model, serial number and software. ``ended`` is why it ended early, else empty.
    ``missing`` are the rungs that are not passed yet.
    """

    rung: RungName
    arms: tuple[str, ...]
    when: str
    controllers: Mapping[str, str]
    visited: tuple[int, ...]
    refused: Mapping[int, str]
    motions: tuple[RehearsedMotionRecord, ...]
    notes: tuple[str, ...] = ()
    ended: str = ""
    missing: tuple[RungName, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the rung counts: it did not end early, and every stop that was not refused was reached."""
        return not self.ended and bool(self.visited)


class RehearsalLog(Result, schema="cellapp-rehearsals"):
    """The file of a profile's rehearsals: the newest result of each rung; ``arms`` is the hash of its arms."""

    arms: str
    rungs: Mapping[RungName, RehearseResult]
