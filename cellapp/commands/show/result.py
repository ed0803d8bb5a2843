"""Results of ``show``: the state of a run, its history, its log."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import SerializeAsAny

from cellapp.cell.run.records import ArmOrder, RecordingState
from cellapp.cell.run.run_arms import UnseenArm
from cellapp.cell.run.sqlite_file import Event
from cellapp.commands.next_step import ArmProgress
from cellapp.commands.run_results import RunResults
from cellapp.commands.stages import NextVerb
from cellapp.ground.results import Record, Result, StageName


class StageState(Record):
    """One stored stage: when and by which version it was stored, what it rests on, and whether that still holds.

    ``out_of_date`` is the reason, None where the stage holds; ``superseded`` says that a later stage of the same name
    exists. A step of which only an earlier version knew has its name.
    """

    number: int
    name: str
    written: str
    program: str
    digest: str
    rests_on: tuple[str, ...]
    superseded: bool = False
    out_of_date: str | None = None


class OverviewResult(Result, schema="cellapp-overview"):
    """``show``: the state of a run, and the verb and command that come next (both empty if none).

    ``in_order`` maps arms to what an import derived from their order of measurement. ``complaints`` says what is out of
    date: stages, the page, the certificate. ``stale`` says why the model in force should not be used as it is; empty if
    it may. ``not_seen_at_rest`` has the arms that must be treated as moving, ``ignored_keys`` those of
    the stored profile that only an earlier version had.
    """

    run: str
    profile: str
    arms: Mapping[str, ArmProgress]
    in_order: Mapping[str, ArmOrder] = {}
    stages: tuple[StageState, ...]
    in_force: StageName | None
    stale: str = ""
    next_verb: NextVerb
    next_step: str
    complaints: tuple[str, ...] = ()
    not_seen_at_rest: Mapping[str, UnseenArm] = {}
    ignored_keys: tuple[str, ...] = ()


class RecordingsResult(Result, schema="cellapp-recordings"):
    """``show DIR recordings``: the recordings of motion that a run holds."""

    run: str
    recordings: tuple[RecordingState, ...]


class HistoryResult(Result, schema="cellapp-history"):
    """``show DIR history``: every stage that was ever stored, oldest first."""

    run: str
    stages: tuple[StageState, ...]


class LogResult(Result, schema="cellapp-log"):
    """``show DIR log``: lines of the run's log, its sessions and stages, oldest first."""

    run: str
    lines: tuple[Event, ...]


class Shown(Result, schema="cellapp-shown"):
    """A part of a run, and what is said of it. Its JSON is that of the part.

    Attributes
    ----------
    part : str
    result : Result or None
        The part itself; None for the profile, whose JSON is ``text``.
    out_of_date, made_by : str
        Why the part no longer holds, and the command that repeats it; empty where it holds.
    results : RunResults or None
        All results of the run, of a target that is shown.
    complaints : tuple of str
        What of the run is out of date, where a strict person asks.
    """

    has_own_schema = False
    part: str
    result: SerializeAsAny[Result] | None = None
    text: str = ""
    out_of_date: str = ""
    made_by: str = ""
    results: RunResults | None = None
    complaints: tuple[str, ...] = ()

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the JSON of the part."""
        return self.text if self.result is None else self.result.to_json(indent=indent)
