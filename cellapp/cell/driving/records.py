"""Results of the verbs up to the readings: plan, collect, import, export.

Planned stops as ``show DIR plan`` gives them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from cellapp.cell.planning.records import PlanDesignResult, PlannedTime
from cellapp.cell.run.records import ArmOrder, RecordingState, ReferenceDrift
from cellapp.cell.run.sqlite_file import Outcome, Session
from cellapp.ground.job_client import Verb
from cellapp.ground.results import Record, Result

End = Literal["complete", "accurate enough"]
"""How a collecting session ends regularly: all stops done, or the requested accuracy reached early."""


class SweepCount(Record):
    """Planned sweeps of one arm: number, how long they last together; beside ``swinging`` of them the other arm
    swings."""

    n: int
    seconds: float
    swinging: int | None = None
    omitted_when_none = frozenset({"swinging"})


class PlannedLoad(Record):
    """Stops (numbers from 1) of a plan that are measured with one load, and what each arm carries then [kg]."""

    first: int
    last: int
    payload_kg: Mapping[str, float]


class PlanResult(Result, schema="cellapp-plan"):
    """``plan``: number of planned stops of each arm, and of further ones in reserve.

    ``design`` is what is known of designed stops, ``time`` how long collecting them takes; ``sweeps`` are
    those of each arm, ``loads`` the loads one after the other where there are several.
    """

    run: str
    stops: Mapping[str, int]
    reserves: int = 0
    design: PlanDesignResult | None = None
    time: PlannedTime | None = None
    sweeps: Mapping[str, SweepCount] | None = None
    loads: tuple[PlannedLoad, ...] | None = None
    notes: tuple[str, ...] = ()
    omitted_when_none = frozenset({"design", "time", "sweeps", "loads"})


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


class CollectedStop(Record):
    """One arm at one stop, from 0, as measured, or why not.

    Attributes
    ----------
    residual_mm : float or None
        Distance of the SMR from the running model that has learnt from all readings; None without a reading or a model.
    sigma_mm : float or None
        Root mean square that stated noise and scatter give this distance.
    retried : bool
        Whether it was not measured at an earlier visit; how many there were is not kept.
    again : int
        How many earlier readings this one replaced.
    suspicion : str
        "gross error", "left out by calibrate", or why there is no reading; empty for none.
    """

    stop: int
    arm: str
    residual_mm: float | None = None
    sigma_mm: float | None = None
    retried: bool = False
    again: int = 0
    suspicion: str = ""


class ReplacedReading(Record):
    """A reading that another one replaced when its stop, from 0, was measured again; ``replaced`` is UTC.

    ``residual_mm`` is its distance from the running model that has learnt from the readings that count; None without.
    """

    stop: int
    arm: str
    replaced: str
    residual_mm: float | None = None


class ResidualRange(Record):
    """95th percentiles of the residuals of one arm [mm]: ``before_mm`` of the running model without gross errors, and
    ``after_mm`` of the calibration's last stage at its held-out stops; None where there is no such model."""

    before_mm: float | None = None
    after_mm: float | None = None


class CollectionResult(Result, schema="cellapp-collection"):
    """``show DIR collection``: sessions, missing readings, reference drift, standard errors reached, every stop.

    ``missing_share`` and ``tolerated_share`` are as in ``CollectResult``; ``standard_error_mm`` maps each arm to the
    standard uncertainty of a predicted SMR position from its parameters. ``stops`` are those that were tried, each arm
    on its own, by number; ``residual_ranges`` maps each arm with readings to what is normal for its residuals.
    ``replaced`` are the readings of stops that were measured again, as they were before.
    """

    run: str
    sessions: tuple[Session, ...]
    missing: tuple[Outcome, ...]
    missing_share: float
    tolerated_share: float
    references: tuple[ReferenceDrift, ...]
    drift_limit_mm: float
    standard_error_mm: Mapping[str, float]
    stops: tuple[CollectedStop, ...] = ()
    residual_ranges: Mapping[str, ResidualRange] = Field(default_factory=dict)
    replaced: tuple[ReplacedReading, ...] = ()

    @property
    def last(self) -> Session | None:
        """Last session that collected remaining stops (none measured again); None if there is none."""
        return next((one for one in reversed(self.sessions) if not one.again), None)


class RequestResult(Result, schema="cellapp-request"):
    """``stop``, ``job pause``, ``job resume`` and ``job abort``: what the running job was asked, and its answer."""

    run: str
    request: Verb
    answer: str


class ImportResult(Result, schema="cellapp-import"):
    """``import``: number of readings of each arm; ``in_order`` maps arms to what their order of measurement gave."""

    run: str
    readings: Mapping[str, int]
    recordings: tuple[RecordingState, ...] = ()
    in_order: Mapping[str, ArmOrder] = Field(default_factory=dict)
    notes: tuple[str, ...]


class PlannedStop(Record):
    """One planned stop: joint positions of every arm [rad], whether it was measured."""

    configuration: int
    measured: bool
    q: Mapping[str, tuple[float, ...]]


class StopsResult(Result, schema="cellapp-stops"):
    """``show DIR plan``: every planned stop, what is known of their design, the sweeps, and several loads."""

    run: str
    stops: tuple[PlannedStop, ...]
    design: PlanDesignResult | None = None
    sweeps: Mapping[str, SweepCount] | None = None
    loads: tuple[PlannedLoad, ...] | None = None
    omitted_when_none = frozenset({"design", "sweeps", "loads"})


class RehearsedMotion(Record):
    """A motion: its stop, from 1; None on other ways; its time, and what it should take [s]; per arm the largest
    distance of a joint from where it was commanded [mrad]."""

    stop: int | None
    seconds: float
    expected_s: float
    off_mrad: Mapping[str, float]


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
