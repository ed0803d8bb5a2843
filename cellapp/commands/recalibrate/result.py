"""Results of ``recalibrate``: many runs calibrated and searched again."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.ground.results import ModelStage, Record, Result


class RecalibratedRun(Record):
    """One run: which stages were made again and why, and the mean held-out error of each arm by the newest [mm].

    ``made`` is empty where all of them held.
    """

    run: str
    made: tuple[ModelStage, ...]
    because: str
    heldout_mm: Mapping[str, float]
    seconds: float


class RecalibrateResult(Result, schema="cellapp-recalibrate"):
    """``recalibrate``: every run, and for each that failed why."""

    runs: tuple[RecalibratedRun, ...]
    failed: Mapping[str, str]

    @property
    def made(self) -> tuple[RecalibratedRun, ...]:
        """Runs of which something was made again."""
        return tuple(run for run in self.runs if run.made)
