"""What a run has collected, as ``show DIR collection`` gives it."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from cellapp.cell.run.records import ReferenceDrift
from cellapp.cell.run.sqlite_file import Outcome, Session, last_session
from cellapp.ground.results import Record, Result


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
        """``last_session`` of them."""
        return last_session(self.sessions)
