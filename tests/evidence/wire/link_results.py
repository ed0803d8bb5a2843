"""Results of the program links: what was measured after each fault, and the bars it must keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.ground.results import Record, Result

COMMANDED_WITHIN_S = 0.1
"""Bar: from the first doubt to the stop received by the controller of every other arm."""
REST_BEYOND_BRAKING_S = 0.2
"""Bar: from the first doubt to rest of every other arm, less its ideal braking time."""


@dataclass(frozen=True)
class OtherArm:
    """Reaction of an arm that had no fault, from the first doubt about the cell [s].

    ``commanded_s``: until its controller received a stop. ``beyond_braking_s``: until it rested, less the ideal braking
    time from its speed at that stop.
    """

    arm: str
    commanded_s: float
    beyond_braking_s: float


@dataclass(frozen=True)
class Struck:
    """One fault and its consequences.

    Attributes
    ----------
    arm : str
        The affected arm; empty if no single arm is.
    detected_s : float or None
        From the fault to the first doubt [s]; None if nothing is to be reported.
    at_rest_s : float
        From the fault to the affected arm at rest according to its controller [s]; meaningful for faults during a
        motion only.
    recovered_s : float
        From the release of the cell, after the operator's repair, to arms that may move [s].
    others : tuple of OtherArm
    """

    fault: str
    moment: str
    arm: str
    detected_s: float | None
    at_rest_s: float
    recovered_s: float
    others: tuple[OtherArm, ...] = ()


class Times(Record):
    """Statistics of n times [s]."""

    median: float
    p95: float
    max: float
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Times | None:
        """Statistics of times; None of none."""
        if not values:
            return None
        return cls(
            median=float(np.median(values)), p95=float(np.quantile(values, 0.95)), max=max(values), n=len(values)
        )


class FaultTimes(Record):
    """Times after one kind of fault [s].

    Attributes
    ----------
    detected_s, at_rest_s, recovered_s : Times or None
        From the fault to the first doubt; to the affected arm at rest (faults during a motion only); from the release
        of the cell to arms that may move.
    commanded_s, beyond_braking_s : Times or None
        Of the other arms, from the first doubt: to the stop received, and to rest less the ideal braking time.
    kept : bool
        Whether ``commanded_s`` and ``beyond_braking_s`` kept their bars every time.
    """

    detected_s: Times | None
    at_rest_s: Times | None
    commanded_s: Times | None
    beyond_braking_s: Times | None
    recovered_s: Times | None
    kept: bool


class LinksResult(Result, schema="cellapp-trials-links"):
    """the program links: times, and what did not happen as specified (``complaints``, empty if nothing).

    ``commanded_within_s`` and ``rest_beyond_braking_s`` are the bars. ``host_stalls`` counts motions in which this
    computer was silent for too long, so that a watchdog stopped an arm and the reaction the others: no fault of the
    cell.
    """

    moves: int
    faults: int
    complaints: tuple[str, ...]
    connect_s: Times | None
    state_s: Times | None
    move_overhead_s: Times | None
    longest_step_s: float
    host_stalls: int
    commanded_within_s: float = COMMANDED_WITHIN_S
    rest_beyond_braking_s: float = REST_BEYOND_BRAKING_S
    by_fault: Mapping[str, FaultTimes]


@dataclass
class LinkLog:
    """What is recorded during a trial; ``result`` summarises it."""

    moves: int = 0
    struck: list[Struck] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    connect_s: list[float] = field(default_factory=list)
    state_s: list[float] = field(default_factory=list)
    overhead_s: list[float] = field(default_factory=list)
    longest_step_s: float = 0.0
    host_stalls: int = 0

    def add(self, struck: Struck) -> None:
        """Add a fault, and a complaint for every bar that was missed."""
        self.struck.append(struck)
        what = f"{struck.fault} {struck.moment} a motion"
        for other in struck.others:
            if other.commanded_s > COMMANDED_WITHIN_S:
                self.complain(
                    f"{what}: arm {other.arm} was commanded to stop {other.commanded_s * 1e3:.0f} ms after the first"
                    f" doubt; the bar is {COMMANDED_WITHIN_S * 1e3:.0f} ms"
                )
            if other.beyond_braking_s > REST_BEYOND_BRAKING_S:
                self.complain(
                    f"{what}: arm {other.arm} rested {other.beyond_braking_s:.2f} s later than its braking time after"
                    f" the first doubt; the bar is {REST_BEYOND_BRAKING_S:g} s"
                )

    def complain(self, text: str) -> None:
        """Record what did not happen as specified."""
        self.complaints.append(f"move {self.moves}: {text}")

    def result(self) -> LinksResult:
        """The summary."""
        return LinksResult(
            moves=self.moves,
            faults=len(self.struck),
            complaints=tuple(self.complaints),
            connect_s=Times.of(self.connect_s),
            state_s=Times.of(self.state_s),
            move_overhead_s=Times.of(self.overhead_s),
            longest_step_s=self.longest_step_s,
            host_stalls=self.host_stalls,
            by_fault={
                fault: _fault_times([one for one in self.struck if one.fault == fault])
                for fault in dict.fromkeys(one.fault for one in self.struck)
            },
        )


def _fault_times(struck: Sequence[Struck]) -> FaultTimes:
    others = [other for one in struck for other in one.others]
    return FaultTimes(
        detected_s=Times.of([one.detected_s for one in struck if one.detected_s is not None]),
        at_rest_s=Times.of([one.at_rest_s for one in struck if one.moment == "during" and one.arm]),
        commanded_s=Times.of([other.commanded_s for other in others]),
        beyond_braking_s=Times.of([other.beyond_braking_s for other in others]),
        recovered_s=Times.of([one.recovered_s for one in struck]),
        kept=all(
            other.commanded_s <= COMMANDED_WITHIN_S and other.beyond_braking_s <= REST_BEYOND_BRAKING_S
            for other in others
        ),
    )
