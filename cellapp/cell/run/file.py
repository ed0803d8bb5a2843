"""A run is a folder with ``run.sqlite``: the profile, the plan, every reading, the log and the results.

A write returns only after its transaction is on disk (write-ahead log, ``synchronous=FULL``): a stop that was reported
as stored survives a power failure. Closing merges the log into the one file, so that it can be copied.

Readings as rows of the run file, derived from the table of columns.

Location of the profile's file of a run: from there, records beside the profile are found.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sqlite3
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from cellapp.cell.run.sqlite_file import (
    FILE_NAME,
    FORMER_COLUMNS,
    UNFINISHED,
    Event,
    Outcome,
    ReferenceRow,
    Session,
    SessionEnd,
    SessionRequest,
    StageRow,
    check_header,
    check_integrity,
    connect,
    insert_document,
    insert_outcome,
    make_empty_folder,
    read_meta,
    read_profile,
    reading_columns,
    schema_version,
    select_document,
    sentences,
    stored_columns,
    sync_folder,
    upgrade,
    utc_now,
    write_new,
)
from cellapp.cell.run.stations import in_one_frame, select_stations
from cellapp.estimation.readings.columns import COLUMNS, OF_SEVERAL, OF_SOCKETS, SPLITS, Column, Values
from cellapp.estimation.readings.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.outputs import try_folder
from cellapp.ground.profile import Profile
from cellapp.ground.removed import removed_readings
from cellapp.ground.shell import shell_word
from cellapp.robot.effects.registry import program_of


def insert_readings(connection: sqlite3.Connection, arm: str, readings: Readings) -> None:
    """Insert readings, inside the caller's transaction. Raise ``sqlite3.IntegrityError`` for a stop that is stored."""
    names = reading_columns()
    places = ", ".join("?" * len(names))
    connection.executemany(
        f"INSERT INTO reading ({', '.join(names)}) VALUES ({places})", ((arm, *row) for row in _table_rows(readings))
    )


def select_readings(
    connection: sqlite3.Connection, arm: str, joints: int, table: Literal["reading", "earlier_reading"] = "reading"
) -> Readings:
    """Read all readings of one arm, ordered by configuration; columns that an older schema lacks have no values.

    In the table ``earlier_reading``, those of one configuration are in the order in which they were replaced.
    """
    version = schema_version(connection)
    names = [column.sql_name if column.since <= version else "NULL" for column in COLUMNS]
    former = [name for name in FORMER_COLUMNS if name in stored_columns(connection, table)]
    wanted = [*names, *former, "extras"]
    rows = connection.execute(
        f"SELECT {', '.join(wanted)} FROM {table} WHERE arm = ? ORDER BY configuration, rowid", (arm,)
    ).fetchall()
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(wanted)
    values: dict[str, Any] = {
        column.name: _from_cells(column, cells, len(rows), joints)
        for column, cells in zip(COLUMNS, columns, strict=False)
    }
    extras = _extras_from_cells(columns[-1])
    for name, cells in zip(former, columns[len(COLUMNS) :], strict=False):
        extras |= _unread_from_cells(FORMER_COLUMNS[name], cells, joints)
    return Readings(**values, extras=extras)


def former_arrays(readings: Readings) -> dict[str, NDArray[np.float64]]:
    """Return the arrays (n, N) that earlier versions read as torques [Nm] and currents [A], where they are numbers."""
    found = {}
    for name, stem in FORMER_COLUMNS.items():
        texts = [readings.extras.get(f"{stem}{joint}", ("",)) for joint in range(1, readings.joints + 1)]
        with contextlib.suppress(ValueError):
            values = [[float(text or "nan") for text in its] for its in texts]
            if np.isfinite(values).any():
                found[name] = np.array(values).T
    return found


def select_stops_done(connection: sqlite3.Connection) -> set[int]:
    """Return the numbers of the stored configurations."""
    return {stop for (stop,) in connection.execute("SELECT DISTINCT configuration FROM reading")}


def check_readings(arm: str, joints: int, readings: Readings) -> None:
    """Check readings of an arm with this number of joints before they are stored.

    Raises
    ------
    ValueError
        If the number of joints differs, a required value is not finite, or a value is not one of those allowed.
    """
    if readings.joints != joints:
        raise ValueError(f"{readings.joints} joint positions for the {joints} joints of arm {arm}")
    for column in COLUMNS:
        values = getattr(readings, column.name)
        if column.required and not np.all(np.isfinite(values)):
            raise ValueError(f"{column.name} of arm {arm} is not finite")
        if column.name == "split":
            check_splits(values or ())
        elif column.allowed and values is not None and not np.all(np.isin(values, column.allowed)):
            raise ValueError(f"{column.name} of arm {arm} is not {column.expected}")


def check_splits(words: Sequence[str | None]) -> None:
    """Check names of splits; None is no split. Raises ``ValueError`` for any other word."""
    for word in words:
        if word is not None and word not in SPLITS:
            raise ValueError(f"'{word}' is not a split; splits are {', '.join(SPLITS)}")


def vectors_from_json(texts: Sequence[str]) -> NDArray[np.float64]:
    """Build a matrix from the JSON texts of its rows; null is NaN."""
    return np.array(json.loads("[" + ",".join(texts) + "]"), dtype=np.float64)


def _table_rows(readings: Readings) -> Iterator[tuple[Any, ...]]:
    n = len(readings)
    extras: list[str | None] = [None] * n
    if readings.extras:
        rows = zip(*readings.extras.values(), strict=True)
        extras = [json.dumps(dict(zip(readings.extras, row, strict=True))) for row in rows]
    columns = [_to_cells(column, getattr(readings, column.name), n) for column in COLUMNS]
    return zip(*columns, extras, strict=True)


def _to_cells(column: Column, values: Values | None, n: int) -> Sequence[Any]:
    """Convert to one cell per reading: NULL without a value, null within JSON where one number is missing."""
    if values is None:
        return [None] * n
    if isinstance(values, tuple):
        return values
    matrix = column.matrix(values)
    cells = matrix.astype(object)
    cells[np.isnan(matrix)] = None
    if column.shape == "scalar":
        return [cell for (cell,) in cells.tolist()]
    empty = np.isnan(matrix).all(axis=1) & (not column.required)
    return [None if nothing else json.dumps(row) for nothing, row in zip(empty.tolist(), cells.tolist(), strict=True)]


def _from_cells(column: Column, cells: Sequence[Any], n: int, joints: int) -> Values | None:
    if all(cell is None for cell in cells) and not (n == 0 and column.required):
        return column.missing(n, joints)
    if column.dtype is str:
        return tuple(cells)
    matrix: NDArray[Any]
    if column.shape == "scalar":
        matrix = np.array(cells, dtype=column.dtype)[:, np.newaxis]
    else:
        width = len(column.csv_names(joints))
        nothing = json.dumps([None] * width)
        matrix = vectors_from_json([nothing if cell is None else cell for cell in cells]).reshape(n, width)
    return column.from_matrix(matrix)


def _unread_from_cells(stem: str, cells: Sequence[str | None], joints: int) -> dict[str, tuple[str, ...]]:
    """Return a quantity per joint that is no longer read, as unknown columns of a file; none without a value."""
    if all(cell is None for cell in cells):
        return {}
    rows = [[None] * joints if cell is None else json.loads(cell) for cell in cells]
    return {
        f"{stem}{joint + 1}": tuple("" if row[joint] is None else repr(row[joint]) for row in rows)
        for joint in range(joints)
    }


def _extras_from_cells(cells: Sequence[str | None]) -> dict[str, tuple[str, ...]]:
    rows = [{} if cell is None else json.loads(cell) for cell in cells]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: tuple(str(row.get(name, "")) for row in rows) for name in names}


T = TypeVar("T")

_BLOCK = bytes(65536)
_SESSIONS = 4
"""Version of the schema since which sessions of collecting are recorded."""


class RunFile:
    """One run, made with ``create`` or ``open``; a context manager that closes it.

    All threads may use it; a lock serialises their calls. Every method raises ``InputError`` if the file cannot be read
    or written (disk full, locked by another program, removed).
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, profile: Profile, writable: bool, journal: str
    ) -> None:
        """Initialise; only ``create``, ``open`` and ``peek`` call this."""
        self.folder = folder
        self.profile = profile
        self.writable = writable
        self._connection = connection
        self._lock = threading.RLock()
        self._journal = journal

    @property
    def path(self) -> Path:
        """The path of the SQLite file."""
        return self.folder / FILE_NAME

    # -- create, open, close -----------------------------------------------------------------------------------------

    @classmethod
    def create(cls, folder: Path, profile: Profile, fill: Callable[[RunFile], None] | None = None) -> RunFile:
        """Create a run in ``folder``, which is made if missing and must be empty otherwise.

        ``fill`` writes the first content (a plan, an import). The file gets its final name after that: a run exists
        completely or not at all.

        Raises
        ------
        InputError
            If the folder holds a run or anything else, or cannot be made. It is then left unchanged.
        """
        folder = Path(folder)
        made = make_empty_folder(folder)
        unfinished = folder / UNFINISHED
        try:
            with sentences(folder):
                unfinished.unlink(missing_ok=True)
                _build(folder, unfinished, profile, fill)
                os.replace(unfinished, folder / FILE_NAME)
                sync_folder(folder)
        except BaseException:  # Ctrl-C too: no partial run is left behind
            for path in (unfinished, Path(f"{unfinished}-journal")):
                path.unlink(missing_ok=True)
            for path in made:
                with contextlib.suppress(OSError):
                    path.rmdir()
            raise
        return cls.open(folder, write=True)

    @classmethod
    def open(cls, folder: Path, *, write: bool = False) -> Self:
        """Open an existing run for reading, or with ``write`` to add to it.

        Raises
        ------
        InputError
            If it is missing, not a run file, damaged, or of a newer schema. The file is left unchanged.
        """
        return cls._opened(folder, write=write, checked=True)

    @classmethod
    def peek(cls, folder: Path) -> Self:
        """Open an existing run to read single values, without checking its pages or waiting for a locked file.

        Raises
        ------
        InputError
            As ``open``; for a damaged page only once something is read from it.
        """
        return cls._opened(folder, write=False, checked=False)

    @classmethod
    def _opened(cls, folder: Path, *, write: bool, checked: bool) -> Self:
        folder, journal = Path(folder), ""
        path = folder / FILE_NAME
        with sentences(folder):
            check_header(folder, path)
            connection = connect(path, "ro") if checked else connect(path, "ro", wait_s=0.0)
            try:
                if checked:
                    check_integrity(path, connection)
                profile = read_profile(path, connection)
                if write:
                    try_folder(folder)  # results stand beside the run file, and so does its journal
                    connection.close()
                    connection = connect(path, "rw")
                    connection.execute("PRAGMA synchronous=FULL")
                    connection.execute("BEGIN IMMEDIATE")  # detects a file that cannot be written
                    connection.execute("COMMIT")
                    journal = str(connection.execute("PRAGMA journal_mode").fetchone()[0])
            except BaseException:
                connection.close()
                raise
        return cls(folder, connection, profile, write, journal)

    def close(self) -> None:
        """Merge the write-ahead log into the one file and close it; closing twice does no harm."""
        with self._lock:
            if self.writable and self._journal == "wal":
                # SQLite refuses while another program reads: the log then stays beside the file, and nothing is lost.
                with contextlib.suppress(sqlite3.Error):
                    self._connection.execute("PRAGMA busy_timeout=0")
                    self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
                    self._connection.execute("PRAGMA journal_mode=DELETE").fetchall()
            self.writable = False
            self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # -- plan --------------------------------------------------------------------------------------------------------

    def write_plan(self, plans: Mapping[str, NDArray[np.float64]], documents: Mapping[str, str] | None = None) -> None:
        """Store the plan, arm -> q (n, N) [rad], in place of an earlier one; row k of all arms is stop k.

        ``documents`` (name -> text) are stored with it in one transaction. Outcomes of stops whose joint positions
        change are removed: they belong to stops that are no longer planned.

        Raises
        ------
        InputError
            If the joint positions of a stop that is already measured would change.
        ValueError
            If the arms' plans differ in length or have a wrong number of joints.
        """
        for arm in plans:
            self._check_arm(arm)
        check_plan(plans, {arm: len(self.profile.arms[arm].type.joints) for arm in plans})
        with self.change() as connection:
            before = select_plan(connection, list(self.profile.arms))
            changed, planned = changed_stops(before, plans), range(min(map(len, plans.values()), default=0))
            if measured := [stop for stop in select_stops_done(connection) if stop in changed or stop not in planned]:
                raise InputError(
                    f"{self.path}: stop {min(measured)} is measured already and differs in the new plan;"
                    " plan into a new run folder instead"
                )
            connection.execute("DELETE FROM plan")
            rows = (
                (arm, stop, json.dumps(row))
                for arm, q in plans.items()
                for stop, row in enumerate(np.asarray(q, float).tolist())
            )
            connection.executemany("INSERT INTO plan VALUES (?, ?, ?)", rows)
            connection.executemany("DELETE FROM outcome WHERE stop = ?", ((stop,) for stop in changed))
            for name, text in (documents or {}).items():
                insert_document(connection, name, text)

    def read_plan(self) -> dict[str, NDArray[np.float64]]:
        """Read the plan, arm -> q (n, N) [rad]; empty without a plan."""
        with self.look() as connection:
            return select_plan(connection, list(self.profile.arms))

    @property
    def profile_text(self) -> str:
        """The stored profile, as JSON."""
        with self.look() as connection:
            return read_meta(connection, "profile") or ""

    def planned_counts(self) -> dict[str, int]:
        """Return the number of planned stops of each arm, reserves included; empty without a plan."""
        counts = dict(self.select("SELECT arm, COUNT(*) FROM plan GROUP BY arm"))
        return {arm: counts[arm] for arm in self._in_profile_order(set(counts))}

    # -- readings ----------------------------------------------------------------------------------------------------

    def add_stop(self, configuration: int, rows: Mapping[str, Readings], outcomes: Sequence[Outcome] = ()) -> None:
        """Store one stop of all arms, and why arms have no reading there, in one transaction; on return it is on disk.

        Raises
        ------
        InputError
            If this stop of one of the arms is stored already.
        ValueError
            If an array has the wrong shape or a required value is not finite.
        """
        self._add({arm: reading.at_stop(configuration) for arm, reading in rows.items()}, outcomes)

    def add_readings(self, arm: str, readings: Readings) -> None:
        """Store readings of one arm in one transaction. Raises as ``add_stop`` does."""
        self._add({arm: readings})

    def _add(self, batches: Mapping[str, Readings], outcomes: Sequence[Outcome] = ()) -> None:
        for arm, readings in batches.items():
            self._check_arm(arm)
            check_readings(arm, len(self.profile.arms[arm].type.joints), readings)
        with self.change() as connection:
            for arm, readings in batches.items():
                try:
                    insert_readings(connection, arm, readings)
                except sqlite3.IntegrityError:
                    stops = ", ".join(str(stop) for stop in readings.configuration[:3].tolist())
                    raise InputError(
                        f"{self.path}: a reading of arm {arm} at one of these stops"
                        f" ({stops}{', ...' if len(readings) > 3 else ''}) is stored already; a stop is measured once"
                    ) from None
            for outcome in outcomes:
                insert_outcome(connection, outcome)

    def readings(self, arm: str) -> Readings:
        """Return the readings of one arm, one per stop, ordered by configuration; n is 0 if there are none.

        Rows of several tracker stations are transformed into the frame of the first one.

        Raises
        ------
        InputError
            If they are of a kind that was removed.
        """
        if reason := self.removed_kinds().get(arm):
            word = shell_word(self.folder)
            raise InputError(
                f"{self.path}: arm '{arm}': {reason}; 'cellapp show {word}' and 'cellapp export {word} --csv FILE'"
                " still open this run"
            )
        with self.look() as connection:
            return in_one_frame(self.rows(arm), select_stations(connection))

    def rows(self, arm: str) -> Readings:
        """Return all rows of one arm as measured or imported, ordered by configuration."""
        self._check_arm(arm)
        with self.look() as connection:
            return select_readings(connection, arm, len(self.profile.arms[arm].type.joints))

    def removed_kinds(self) -> dict[str, str]:
        """Return each arm whose readings are of a removed kind, which nothing is estimated from, with what to say."""
        several = f"SELECT arm FROM reading GROUP BY arm HAVING COUNT(DISTINCT IFNULL({OF_SEVERAL}, '')) > 1"
        in_sockets = f"SELECT DISTINCT arm FROM reading WHERE {OF_SOCKETS} IS NOT NULL"
        found = dict[str, str]()
        for since, column, asked in ((8, OF_SEVERAL, several), (7, OF_SOCKETS, in_sockets)):
            found |= dict.fromkeys((arm for (arm,) in self.select(asked, since)), removed_readings(column))
        return found

    def split_counts(self) -> dict[str, dict[str | None, int]]:
        """Count the readings of each arm that has some, by split; None is no split."""
        counts: dict[str, dict[str | None, int]] = {}
        asked = "SELECT arm, split, COUNT(DISTINCT configuration) FROM reading GROUP BY arm, split"
        for arm, split, n in self.select(asked):
            counts.setdefault(arm, {})[split] = n
        return {arm: counts[arm] for arm in self._in_profile_order(set(counts))}

    def mean_temperatures(self) -> dict[str, dict[str, float]]:
        """Return mean temperatures [degC] of each arm's readings: of the "air" and of each "joint N", where known."""
        air = self.select("SELECT arm, 'air', AVG(temperature_c) FROM reading GROUP BY arm")
        joints = self.select(
            "SELECT arm, 'joint ' || (joint.key + 1), AVG(joint.value)"
            " FROM reading, json_each(reading.joint_temperature_c) AS joint GROUP BY arm, joint.key"
        )
        means: dict[str, dict[str, float]] = {}
        for arm, where, mean in (*air, *joints):
            if mean is not None:
                means.setdefault(arm, {})[where] = float(mean)
        return means

    @property
    def created(self) -> str:
        """When the run was made (ISO 8601, UTC); empty if that is not recorded."""
        with self.look() as connection:
            return read_meta(connection, "created") or ""

    def arms(self) -> list[str]:
        """Return the names of the arms that have readings, in the profile's order."""
        return self._in_profile_order({name for (name,) in self.select("SELECT DISTINCT arm FROM reading")})

    def stops_done(self) -> set[int]:
        """Return the numbers of the stored configurations; each was stored for all of its arms at once."""
        with self.look() as connection:
            return select_stops_done(connection)

    def untried_stops(self) -> set[int]:
        """Return the planned stops that no session has tried yet; reserves do not count."""
        total = max(self.planned_counts().values(), default=0)
        tried = self.stops_done() | {one.stop for one in self.outcomes()}
        return {*range(total)} - tried - {*self.profile.plan.reserves(total)}

    def assign_splits(self, arm: str, names: Sequence[str | None]) -> None:
        """Store the split of each reading of ``arm``, in the order of ``readings``; None is no split."""
        check_splits(names)
        stops = self.readings(arm).configuration.tolist()
        if len(stops) != len(names):
            raise ValueError(f"{len(names)} splits for the {counted(len(stops), 'reading')} of arm {arm}")
        with self.change() as connection:
            connection.executemany(
                "UPDATE reading SET split = ? WHERE arm = ? AND configuration = ?",
                ((name, arm, stop) for stop, name in dict(zip(stops, names, strict=True)).items()),
            )

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the imported CSV file in its order; empty for a run that was collected."""
        with self.look() as connection:
            return tuple(json.loads(read_meta(connection, "columns") or "[]"))

    def keep_columns(self, names: Sequence[str]) -> None:
        """Store the columns of an imported file, so that the export has the same ones."""
        self._change("INSERT OR REPLACE INTO meta VALUES ('columns', ?)", json.dumps(list(names)))

    # -- events, documents and stages --------------------------------------------------------------------------------

    def log(self, level: str, text: str, time_s: float | None = None) -> None:
        """Add a line to the run's log; ``level`` is info, warning, error or note."""
        asked = "INSERT INTO event (written, time_s, level, text) VALUES (?, ?, ?, ?)"
        self._change(asked, utc_now(), time_s, level, text)

    def events(self) -> list[Event]:
        """Return the run's log, oldest entry first."""
        return [Event(*row) for row in self.select("SELECT number, written, time_s, level, text FROM event ORDER BY 1")]

    def write_document(self, name: str, json_text: str) -> None:
        """Store a document that is not the result of a verb; it replaces an earlier one of that name."""
        with self.change() as connection:
            insert_document(connection, name, json_text)

    def read_document(self, name: str) -> str | None:
        """Return the text of a stored document, or None."""
        with self.look() as connection:
            return select_document(connection, name)

    def read_checked(self, name: str, kind: TypeAdapter[T], otherwise: T, to_do: str) -> T:
        """Return a stored document of this ``kind``, or ``otherwise``.

        Raise ``InputError`` with what is ``to_do`` if it is damaged.
        """
        text = self.read_document(name)
        try:
            return otherwise if text is None else kind.validate_json(text, extra="ignore")
        except ValidationError as error:
            raise InputError(f"{self.path}: the document '{name}' is damaged; {to_do}") from error

    def append_stage(self, name: str, basis: str | None, text: str, model: str | None) -> None:
        """Append what a verb produced: its result, its model (JSON) if it made one, and what they rest on."""
        asked = "INSERT INTO stage (name, written, program, basis, text, model) VALUES (?, ?, ?, ?, ?, ?)"
        self._change(asked, name, utc_now(), program_of(self.profile), basis, text, model)

    def stage_rows(self) -> list[StageRow]:
        """Return all stages, oldest first; none in a file of schema 1 or 2."""
        asked = "SELECT number, name, written, program, basis, text, model FROM stage ORDER BY number"
        return [StageRow(*row) for row in self.select(asked, since=3)]

    # -- collecting --------------------------------------------------------------------------------------------------

    def require_space(self, needed_bytes: int, what: str) -> None:
        """Check that the disk takes what ``what`` needs, with a synced file that goes. Raise ``InputError``."""
        try:
            with tempfile.TemporaryFile(dir=self.folder) as probe:
                if sys.platform == "linux":
                    os.posix_fallocate(probe.fileno(), 0, needed_bytes)
                else:
                    for _ in range(-(-needed_bytes // len(_BLOCK))):
                        probe.write(_BLOCK)
                probe.write(_BLOCK)
                probe.flush()
                os.fsync(probe.fileno())
        except OSError as error:
            raise InputError(
                f"{self.folder}: {what} needs {needed_bytes / 1e6:.1f} MB there, which cannot be written"
                f" ({error.strerror}; {shutil.disk_usage(self.folder).free / 1e6:.1f} MB are free); make room, then try"
                " again"
            ) from error

    def begin_session(self, again: str = "") -> int:
        """Record that collecting begins, or measuring the stops ``again`` once more; return the session's number."""
        return self._change("INSERT INTO session (began, again) VALUES (?, ?)", utc_now(), again or None)

    def record_request(self, session: int, kind: str, reason: str) -> None:
        """Record a request of a person, or an event that suspended or resumed a session."""
        self._change("INSERT INTO request VALUES (?, ?, ?, ?)", session, utc_now(), kind, reason)

    def end_session(self, session: int, outcome: SessionEnd, reason: str) -> None:
        """Record how a session ended."""
        asked = "UPDATE session SET ended = ?, outcome = ?, reason = ? WHERE number = ?"
        self._change(asked, utc_now(), outcome, reason, session)

    def add_reference(self, row: ReferenceRow) -> None:
        """Store a reference measurement; on return it is on disk."""
        values = row.name, row.stops_done, row.time_s, json.dumps(row.p_M.tolist()), row.session
        self._change("INSERT INTO reference VALUES (?, ?, ?, ?, ?)", *values)

    def sessions(self) -> list[Session]:
        """Return all sessions of collecting, oldest first."""
        asked = "SELECT session, written, kind, reason FROM request ORDER BY rowid"
        requests = grouped((session, SessionRequest(*request)) for session, *request in self.select(asked, _SESSIONS))
        with self.look() as connection:
            again = "COALESCE(again, '')" if schema_version(connection) >= 9 else "''"
        asked = f"SELECT number, began, ended, outcome, reason, {again} FROM session ORDER BY number"
        return [
            Session(number, began, ended, outcome, reason, tuple(requests.get(number, ())), again)
            for number, began, ended, outcome, reason, again in self.select(asked, _SESSIONS)
        ]

    def outcomes(self) -> list[Outcome]:
        """Return why arms have no reading at stops that were tried, by stop."""
        asked = (
            "SELECT stop, arm, kind, reason FROM outcome WHERE NOT EXISTS"
            " (SELECT 1 FROM reading WHERE reading.configuration = outcome.stop AND reading.arm = outcome.arm)"
            " ORDER BY stop, arm"
        )
        return [Outcome(*row) for row in self.select(asked, _SESSIONS)]

    def late(self) -> set[tuple[int, str]]:
        """Return stops and arms that have a reading now and had none when they were visited before."""
        asked = (
            "SELECT stop, outcome.arm FROM outcome JOIN reading"
            " ON reading.configuration = outcome.stop AND reading.arm = outcome.arm WHERE kind = 'not measured'"
        )
        return {(stop, arm) for stop, arm in self.select(asked, _SESSIONS)}

    def references(self) -> list[ReferenceRow]:
        """Return all reference measurements, oldest first."""
        rows = self.select("SELECT name, stops_done, time_s, p_m, session FROM reference ORDER BY rowid", _SESSIONS)
        return [
            ReferenceRow(name, done, time_s, np.array(json.loads(p_M)), session)
            for name, done, time_s, p_M, session in rows
        ]

    # -- for the modules of this package, each of which owns a table -------------------------------------------------

    def select(self, asked: str, since: int = 1) -> list[tuple[Any, ...]]:
        """Return the rows of a question; none in a file of a schema before ``since``."""
        with self.look() as connection:
            return connection.execute(asked).fetchall() if schema_version(connection) >= since else []

    def _change(self, asked: str, *values: object) -> int:
        """Change the file by one statement; return the number of the row that it added, if any."""
        with self.change() as connection:
            return int(connection.execute(asked, values).lastrowid or 0)

    @contextlib.contextmanager
    def look(self) -> Iterator[sqlite3.Connection]:
        """Give the database connection for reading."""
        with self._lock, sentences(self.folder):
            yield self._connection

    @contextlib.contextmanager
    def change(self) -> Iterator[sqlite3.Connection]:
        """Give the database connection within a transaction, committed with the block and undone if that raises."""
        with self._lock, sentences(self.folder):
            if not self.writable:
                raise InputError(f"{self.path} is open for reading only; open it for writing")
            if self._journal == "delete":  # only now: a program that changes nothing leaves the file as it is
                self._journal = str(self._connection.execute("PRAGMA journal_mode=WAL").fetchone()[0])
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                upgrade(self._connection)
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _check_arm(self, arm: str) -> None:
        if arm not in self.profile.arms:
            raise InputError(f"{self.path}: arm '{arm}' not found; arms are {', '.join(self.profile.arms)}")

    def _in_profile_order(self, names: set[str]) -> list[str]:
        return [name for name in self.profile.arms if name in names]


def _build(folder: Path, path: Path, profile: Profile, fill: Callable[[RunFile], None] | None) -> None:
    """Write a complete run file to ``path``."""
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        write_new(connection, profile)
        if fill is not None:
            fill(RunFile(folder, connection, profile, True, "unfinished"))
    finally:
        connection.close()


# -- The table ``plan`` of a run file: joint positions of every arm at every planned stop -----------------------------


Plan = Mapping[str, NDArray[np.float64]]
"""Arm -> q (n, N) [rad]; row k of all arms is stop k."""


def check_plan(plans: Plan, joints: Mapping[str, int]) -> None:
    """Raise ``ValueError`` if the arms' plans differ in length, have a wrong number of joints, or are not finite."""
    if len({len(q) for q in plans.values()}) > 1:
        raise ValueError("the arms' plans have different numbers of stops")
    for arm, q in plans.items():
        if np.ndim(q) != 2 or np.shape(q)[1] != joints[arm] or not np.all(np.isfinite(q)):
            raise ValueError(f"expected finite joint positions (n, {joints[arm]}) for arm {arm}")


def changed_stops(before: Plan, after: Plan) -> set[int]:
    """Return the stops at which an arm's joint positions differ between two plans, or that only one of them has."""
    changed: set[int] = set()
    for arm in before.keys() | after.keys():
        old, new = before.get(arm, np.empty((0, 1))), after.get(arm, np.empty((0, 1)))
        common = min(len(old), len(new))
        differ = (old[:common] != new[:common]).any(axis=1)
        changed |= {*np.flatnonzero(differ).tolist(), *range(common, max(len(old), len(new)))}
    return changed


def select_plan(connection: sqlite3.Connection, arms: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read the plan of those of ``arms`` that have one."""
    texts: dict[str, list[str]] = grouped(connection.execute("SELECT arm, q FROM plan ORDER BY arm, stop"))
    return {arm: vectors_from_json(texts[arm]) for arm in arms if arm in texts}


_STORED = "profile file"
"""Name of the stored result."""


def rehearsals_path(profile: Path) -> Path:
    """Return the file beside a profile that records its rehearsals."""
    return profile.with_name(f"{profile.stem}.rehearsals.json")


def note_profile(run: RunFile, path: Path) -> None:
    """Store in a run where its profile's file is."""
    run.write_document(_STORED, str(path.resolve()))


def noted_profile(run: RunFile) -> Path | None:
    """Return where the profile's file was when the run was planned; None if that is not known."""
    text = run.read_document(_STORED)
    return None if text is None else Path(text)
