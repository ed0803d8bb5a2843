"""What driving gives: how collecting ended, what happened on a rung of a rehearsal, the calibration in a controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from cellapp.cell.driving.rehearsal_rungs import RungName
from cellapp.cell.run.records import ReferenceDrift
from cellapp.cell.run.sqlite_file import Outcome
from cellapp.ground.results import Record, Result

End = Literal["complete", "accurate enough"]
"""How a collecting session ends regularly: all stops done, or the requested accuracy reached early."""


class CollectResult(Result, schema="cellapp-collect"):
    """``collect``: number of stored stops, how the session ended, what is missing, and notes for the operator.

    ``missing_share`` is the share of the asked readings that the run lacks although reserves were measured;
    ``tolerated_share`` is the profile's. ``standard_error_mm`` maps each arm to the standard uncertainty of a
    predicted SMR position from its parameters. ``replaced`` is the number of readings of stops that were measured
    again, whose earlier readings are kept; None where no stop was.
    """

    stops: int
    notes: tuple[str, ...]
    outcome: End = "complete"
    missing: tuple[Outcome, ...] = ()
    missing_share: float = 0.0
    tolerated_share: float = 1.0
    references: tuple[ReferenceDrift, ...] = ()
    standard_error_mm: Mapping[str, float] = Field(default_factory=dict)
    replaced: int | None = None
    omitted_when_none = frozenset({"replaced"})

    def complaints(self) -> list[str]:
        """Return why this collection does not count as done; empty if it does."""
        if self.outcome == "accurate enough" or self.missing_share <= self.tolerated_share:
            return []
        return [
            f"{self.missing_share:.1%} of the planned readings are missing, the profile tolerates"
            f" {self.tolerated_share:.1%} (collection.tolerated)"
        ]


class RehearsedMotion(Record):
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
    motions: tuple[RehearsedMotion, ...]
    notes: tuple[str, ...] = ()
    ended: str = ""
    missing: tuple[RungName, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the rung counts: it did not end early, and every stop that was not refused was reached."""
        return not self.ended and bool(self.visited)


class ControllerCalibration(Record):
    """The factory's calibration in a controller.

    ``deltas`` are added to the published rows theta, d, a, alpha of each joint [rad, m, m, rad]; ``near`` says the same
    as rows theta, d, a, alpha, beta next to them. ``mean_mm`` and ``max_mm`` are how far the SMR is off by both chains.
    """

    checksum: str
    deltas: tuple[tuple[float, ...], ...]
    near: tuple[tuple[float, ...], ...]
    mean_mm: float
    max_mm: float
