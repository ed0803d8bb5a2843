"""A run is a folder with ``run.sqlite``: the profile, the plan, every reading, events and results.

Whoever is told that a stop was added can lose power the next moment: a write returns only after its transaction is on
disk (write-ahead log, ``synchronous=FULL``). Closing puts the log back into the one file, so that it can be copied.
Vectors are stored as JSON text, whose shortest decimal numbers give back the same float64 bit for bit and stay legible
to any SQLite tool; scalar columns have no declared type because SQLite rewrites some floats in typed ones.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sqlite3
import struct
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cellapp import __version__
from cellapp.errors import InputError
from cellapp.profile import Profile, profile_from_json, profile_to_json
from cellapp.run.readings import SPLITS, Reading, Readings

FILE_NAME = "run.sqlite"
SCHEMA_VERSION = 3

_APPLICATION_ID = 0x43656C6C  # "Cell"
_UNFINISHED = FILE_NAME + ".new"
_HEADER = b"SQLite format 3\x00"
_BUSY_S = 10.0
_UPPER = np.triu_indices(3)

_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE plan (arm TEXT NOT NULL, stop INTEGER NOT NULL, q TEXT NOT NULL, PRIMARY KEY (arm, stop));
CREATE TABLE reading (
    arm TEXT NOT NULL, configuration INTEGER NOT NULL, time_s, q TEXT NOT NULL, approach TEXT NOT NULL,
    p_m TEXT NOT NULL, payload_kg, temperature_c, joint_temperature_c TEXT, covariance_m2 TEXT, sigma_m,
    split TEXT, extras TEXT, step TEXT, dwell_s, PRIMARY KEY (arm, configuration)
);
CREATE TABLE event (number INTEGER PRIMARY KEY, written TEXT NOT NULL, time_s, level TEXT NOT NULL, text TEXT NOT NULL);
CREATE TABLE result (name TEXT PRIMARY KEY, written TEXT NOT NULL, text TEXT NOT NULL);
"""
_STAGE_TABLE = """
CREATE TABLE stage (
    number INTEGER PRIMARY KEY, name TEXT NOT NULL, written TEXT NOT NULL, program TEXT NOT NULL, basis TEXT,
    text TEXT NOT NULL, model TEXT
)"""
"""Results of verbs, append-only; files of schema 1 and 2 lack it and keep such results in the table ``result``."""
_READING_COLUMNS = (
    "configuration, time_s, q, approach, p_m, payload_kg, temperature_c,"
    " joint_temperature_c, covariance_m2, sigma_m, split, extras, step, dwell_s"
)
_SINCE_2 = ("step TEXT", "dwell_s")
"""Columns that files of schema 1 lack: they read as empty, and the file gets them when it is first written to."""


@dataclass(frozen=True)
class Event:
    """One line of the run's log; ``written`` is UTC, ``time_s`` is seconds since the run began where it was given."""

    number: int
    written: str
    time_s: float | None
    level: str
    text: str


@dataclass(frozen=True)
class StageRow:
    """One row of the table ``stage`` as text; ``cellapp.run.stages`` gives it its meaning."""

    number: int
    name: str
    written: str
    program: str
    basis: str | None
    text: str
    model: str | None


@dataclass(frozen=True)
class Document:
    """One entry of the table ``result``: what and when (UTC)."""

    written: str
    text: str


class RunFile:
    """One run. Make it with ``create`` or ``open``, and close it (it is a context manager).

    It can be used from any thread; calls wait for one another. Every method raises ``InputError`` if the file cannot be
    read or written (disk full, locked by another program, taken away).
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, profile: Profile, writable: bool, journal: str
    ) -> None:
        """For ``create`` and ``open`` only."""
        self.folder = folder
        self.profile = profile
        self.writable = writable
        self._connection = connection
        self._lock = threading.RLock()
        self._journal = journal

    @property
    def path(self) -> Path:
        """The SQLite file."""
        return self.folder / FILE_NAME

    # -- making, opening, closing ------------------------------------------------------------------------------------

    @classmethod
    def create(cls, folder: Path, profile: Profile, fill: Callable[[RunFile], None] | None = None) -> RunFile:
        """A new run in ``folder``, which is made if it is missing and must be empty otherwise.

        ``fill`` writes what the run shall hold from its first moment on (an import). The file gets its name only
        after that, so that a run is there as a whole or not at all.

        Raises
        ------
        InputError
            If the folder holds a run or anything else, or cannot be made. It is then left as it was.
        """
        folder = Path(folder)
        made = _make_empty(folder)
        unfinished = folder / _UNFINISHED
        try:
            with _readable_errors(folder):
                unfinished.unlink(missing_ok=True)
                _build(folder, unfinished, profile, fill)
                os.replace(unfinished, folder / FILE_NAME)
                _sync_folder(folder)
        except BaseException:  # also a Ctrl-C: nothing half made stays behind
            for path in (unfinished, Path(f"{unfinished}-journal")):
                path.unlink(missing_ok=True)
            for path in made:
                with contextlib.suppress(OSError):
                    path.rmdir()
            raise
        return cls.open(folder, write=True)

    @classmethod
    def open(cls, folder: Path, *, write: bool = False) -> RunFile:
        """An existing run, to read, or with ``write`` to add to it.

        Raises
        ------
        InputError
            If there is none, or it is no run file, damaged, or of a newer schema. The file is not touched then.
        """
        folder = Path(folder)
        path = folder / FILE_NAME
        with _readable_errors(folder):
            _check_header(folder, path)
            connection = _connect(path, "ro")
            try:
                with _damage_named(path):
                    profile = _check_contents(path, connection)
                if write:
                    connection.close()
                    connection = _connect(path, "rw")
                    connection.execute("PRAGMA synchronous=FULL")
                    connection.execute("BEGIN IMMEDIATE")  # a file that cannot be written is found now
                    connection.execute("COMMIT")
            except BaseException:
                connection.close()
                raise
            journal = str(connection.execute("PRAGMA journal_mode").fetchone()[0])
        return cls(folder, connection, profile, write, journal)

    def close(self) -> None:
        """Put everything into the one file and let go of it; harmless when closed."""
        with self._lock:
            if self.writable and self._journal == "wal":
                # Refused while somebody else reads: then the log stays beside the file, and nothing is lost.
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

    def write_plan(self, plans: Mapping[str, NDArray[np.float64]]) -> None:
        """Store the plan, arm -> q (n, N) [rad]; row k of all arms is stop k. It replaces an earlier one.

        Raises
        ------
        InputError
            If stops that were measured already would change their joint positions.
        ValueError
            If the arms' plans differ in length, or do not fit the profile's arms.
        """
        if len({len(q) for q in plans.values()}) > 1:
            raise ValueError("the arms' plans have different numbers of stops")
        for arm, q in plans.items():
            self._check_arm(arm)
            if np.ndim(q) != 2 or np.shape(q)[1] != self._joints(arm) or not np.all(np.isfinite(q)):
                raise ValueError(f"expected finite joint positions (n, {self._joints(arm)}) for arm {arm}")
        with self._transaction() as connection:
            measured = self._stops_done(connection)
            if measured:
                old = self._read_plan(connection)
                for arm, q in plans.items():
                    before = old.get(arm, q[:0])
                    common = min(len(before), len(q))
                    for stop in measured:
                        if not 0 <= stop < common or not np.array_equal(before[stop], q[stop]):
                            raise InputError(
                                f"{self.path}: stop {stop} was measured already and is not the same in the new plan;"
                                " plan into a new run folder instead"
                            )
            connection.execute("DELETE FROM plan")
            connection.executemany(
                "INSERT INTO plan VALUES (?, ?, ?)",
                ((arm, stop, json.dumps(row)) for arm, q in plans.items() for stop, row in enumerate(_lists(q))),
            )

    def read_plan(self) -> dict[str, NDArray[np.float64]]:
        """The plan, arm -> q (n, N) [rad]; empty if there is none yet."""
        with self._reading() as connection:
            return self._read_plan(connection)

    def _read_plan(self, connection: sqlite3.Connection) -> dict[str, NDArray[np.float64]]:
        rows = connection.execute("SELECT arm, q FROM plan ORDER BY arm, stop").fetchall()
        return {
            arm: _matrix([text for name, text in rows if name == arm])
            for arm in self._in_profile_order({name for name, _ in rows})
        }

    # -- readings ----------------------------------------------------------------------------------------------------

    def add_stop(self, configuration: int, rows: Mapping[str, Reading]) -> None:
        """Store one stop, all arms in one transaction; on return it is on disk.

        Raises
        ------
        InputError
            If this stop of one of the arms is stored already.
        ValueError
            If an array has the wrong shape or a required value is not finite.
        """
        batches = {arm: _one_row(configuration, reading) for arm, reading in rows.items()}
        self._add(batches)

    def add_readings(self, arm: str, readings: Readings) -> None:
        """Store many readings of one arm in one transaction. Raises as ``add_stop`` does."""
        self._add({arm: readings})

    def _add(self, batches: Mapping[str, Readings]) -> None:
        for arm, readings in batches.items():
            self._check_arm(arm)
            _check_values(arm, self._joints(arm), readings)
        with self._transaction() as connection:
            for arm, readings in batches.items():
                try:
                    connection.executemany(
                        f"INSERT INTO reading (arm, {_READING_COLUMNS}) VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
                        ((arm, *row) for row in _rows(readings)),
                    )
                except sqlite3.IntegrityError:
                    raise InputError(
                        f"{self.path}: a reading of arm {arm} at one of these stops"
                        f" ({_some(readings.configuration)}) is stored already; a stop is measured once"
                    ) from None

    def readings(self, arm: str) -> Readings:
        """All readings of one arm, ordered by configuration; n is 0 if there are none."""
        self._check_arm(arm)
        with self._reading() as connection:
            columns = _READING_COLUMNS
            if _schema_version(connection) < 2:
                columns = columns.removesuffix("step, dwell_s") + "NULL, NULL"
            rows = connection.execute(
                f"SELECT {columns} FROM reading WHERE arm = ? ORDER BY configuration", (arm,)
            ).fetchall()
        return _from_rows(rows, self._joints(arm))

    def arms(self) -> list[str]:
        """The arms that have readings, in the profile's order."""
        with self._reading() as connection:
            return self._in_profile_order({name for (name,) in connection.execute("SELECT DISTINCT arm FROM reading")})

    def stops_done(self) -> set[int]:
        """The configurations that are stored (each was stored for all of its arms at once)."""
        with self._reading() as connection:
            return self._stops_done(connection)

    @staticmethod
    def _stops_done(connection: sqlite3.Connection) -> set[int]:
        return {stop for (stop,) in connection.execute("SELECT DISTINCT configuration FROM reading")}

    def assign_splits(self, arm: str, names: Sequence[str | None]) -> None:
        """Store the split of each reading of ``arm``, in the order of ``readings``; None is no split."""
        self._check_arm(arm)
        for name in names:
            if name is not None and name not in SPLITS:
                raise ValueError(f"'{name}' is not a split; splits are {', '.join(SPLITS)}")
        with self._transaction() as connection:
            stops = connection.execute(
                "SELECT configuration FROM reading WHERE arm = ? ORDER BY configuration", (arm,)
            ).fetchall()
            if len(stops) != len(names):
                raise ValueError(f"{len(names)} splits for the {len(stops)} readings of arm {arm}")
            connection.executemany(
                "UPDATE reading SET split = ? WHERE arm = ? AND configuration = ?",
                ((name, arm, stop) for name, (stop,) in zip(names, stops, strict=True)),
            )

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the file that was imported, in its order; empty for a run that was collected."""
        with self._reading() as connection:
            return tuple(json.loads(_meta(connection, "columns") or "[]"))

    def keep_columns(self, names: Sequence[str]) -> None:
        """Remember the columns of an imported file, so that the export has the same ones."""
        with self._transaction() as connection:
            connection.execute("INSERT OR REPLACE INTO meta VALUES ('columns', ?)", (json.dumps(list(names)),))

    # -- events and results ------------------------------------------------------------------------------------------

    def log(self, level: str, text: str, time_s: float | None = None) -> None:
        """Add a line to the run's log; ``level`` is a word such as info, warning or error."""
        with self._transaction() as connection:
            connection.execute(
                "INSERT INTO event (written, time_s, level, text) VALUES (?, ?, ?, ?)", (_now(), time_s, level, text)
            )

    def events(self) -> list[Event]:
        """The run's log, oldest first."""
        with self._reading() as connection:
            rows = connection.execute("SELECT number, written, time_s, level, text FROM event ORDER BY number")
            return [Event(*row) for row in rows]

    def write_result(self, name: str, json_text: str) -> None:
        """Store a document that is not a verb's result under a name; it replaces an earlier one of that name."""
        with self._transaction() as connection:
            connection.execute("INSERT OR REPLACE INTO result VALUES (?, ?, ?)", (name, _now(), json_text))

    def read_result(self, name: str) -> str | None:
        """The text of a stored document, or None."""
        document = self.read_document(name)
        return None if document is None else document.text

    def read_document(self, name: str) -> Document | None:
        """A stored document, or None."""
        with self._reading() as connection:
            row = connection.execute("SELECT written, text FROM result WHERE name = ?", (name,)).fetchone()
        return None if row is None else Document(*row)

    # -- stages ------------------------------------------------------------------------------------------------------

    def append_stage(self, name: str, basis: str | None, text: str, model: str | None) -> None:
        """Append what a verb made: its result, its model (JSON) if it made one, and what they rest on."""
        with self._transaction() as connection:
            connection.execute(
                "INSERT INTO stage (name, written, program, basis, text, model) VALUES (?, ?, ?, ?, ?, ?)",
                (name, _now(), f"cellapp {__version__}", basis, text, model),
            )

    def stage_rows(self) -> list[StageRow]:
        """All stages, oldest first; none in a file of schema 1 or 2."""
        with self._reading() as connection:
            if _schema_version(connection) < 3:
                return []
            rows = connection.execute(
                "SELECT number, name, written, program, basis, text, model FROM stage ORDER BY number"
            )
            return [StageRow(*row) for row in rows]

    # -- inside ------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        with self._lock, _readable_errors(self.folder):
            yield self._connection

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock, _readable_errors(self.folder):
            if not self.writable:
                raise InputError(f"{self.path} is open for reading only; open it for writing to change it")
            if self._journal == "delete":  # not before: who changes nothing leaves every byte as it was
                self._journal = str(self._connection.execute("PRAGMA journal_mode=WAL").fetchone()[0])
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                _upgrade(self._connection)
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _joints(self, arm: str) -> int:
        return len(self.profile.arms[arm].type.joints)

    def _check_arm(self, arm: str) -> None:
        if arm not in self.profile.arms:
            raise InputError(f"{self.path}: there is no arm '{arm}'; arms are {', '.join(self.profile.arms)}")

    def _in_profile_order(self, names: set[str]) -> list[str]:
        return [name for name in self.profile.arms if name in names]


# -- the file ---------------------------------------------------------------------------------------------------------


def _make_empty(folder: Path) -> list[Path]:
    """Make the folder if it is missing; the folders that had to be made, innermost first."""
    if folder.is_dir():
        with _readable_errors(folder):
            names = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith(_UNFINISHED))
        if FILE_NAME in names:
            raise InputError(f"{folder} already holds a run ({FILE_NAME}); resume that run or choose a new folder")
        if names:
            raise InputError(
                f"{folder} is not empty ({_some(names)}); a run needs an empty or new folder, choose another one"
            )
        return []
    if folder.exists():
        raise InputError(f"{folder} is a file; a run needs a folder of its own, choose another name")
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with _readable_errors(folder):
        folder.mkdir(parents=True)
    return missing


def _build(folder: Path, path: Path, profile: Profile, fill: Callable[[RunFile], None] | None) -> None:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("PRAGMA synchronous=FULL")
        connection.executescript(f"BEGIN; {_SCHEMA} {_STAGE_TABLE};")
        connection.executemany(
            "INSERT INTO meta VALUES (?, ?)",
            {
                "schema": "cellapp-run",
                "version": str(SCHEMA_VERSION),
                "created": _now(),
                "program": f"cellapp {__version__}",
                "profile": profile_to_json(profile),
            }.items(),
        )
        connection.execute(f"PRAGMA application_id={_APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
        connection.execute("COMMIT")
        if fill is not None:
            fill(RunFile(folder, connection, profile, True, "unfinished"))
    finally:
        connection.close()


def _schema_version(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _upgrade(connection: sqlite3.Connection) -> None:
    """Give a file of an older schema what it lacks, inside the caller's transaction; stored results stay as they are.

    This happens with the first change only: a command that is refused leaves every byte as it was.
    """
    version = _schema_version(connection)
    if version == SCHEMA_VERSION:
        return
    if version < 2:
        for column in _SINCE_2:
            connection.execute(f"ALTER TABLE reading ADD COLUMN {column}")
    connection.execute(_STAGE_TABLE)
    connection.execute("UPDATE meta SET value = ? WHERE key = 'version'", (str(SCHEMA_VERSION),))
    connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        uri=True,
        timeout=_BUSY_S,
        isolation_level=None,
        check_same_thread=False,
    )


def _check_header(folder: Path, path: Path) -> None:
    """Look at the first bytes (their layout is part of SQLite's file format) before SQLite does anything to it."""
    if not folder.exists():
        raise InputError(f"{folder}: there is no such run folder; 'cellapp plan' or 'cellapp import' makes one")
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the folder that holds {FILE_NAME}")
    if not path.exists():
        raise InputError(f"{folder} holds no run ({FILE_NAME} is missing); give the folder of a run")
    with path.open("rb") as file:
        header = file.read(100)
        size = file.seek(0, os.SEEK_END)
    if not _HEADER.startswith(header[: len(_HEADER)]):
        raise InputError(f"{path} is not a run file (not SQLite); check the folder's name")
    if len(header) < 100:
        raise InputError(f"{path} is cut off ({size} bytes); restore it from a copy")
    version, application = struct.unpack(">I", header[60:64])[0], struct.unpack(">I", header[68:72])[0]
    if application != _APPLICATION_ID:
        raise InputError(f"{path} is an SQLite file, but not one of cellapp's runs; check the folder's name")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{path} was written by a newer cellapp (schema {version}, this one knows up to {SCHEMA_VERSION});"
            " install the newer cellapp to open it"
        )
    log = Path(f"{path}-wal")
    if log.exists() and log.stat().st_size > 0:
        return  # what the file lacks may stand in the log; the contents are checked next
    page = struct.unpack(">H", header[16:18])[0]
    expected = struct.unpack(">I", header[28:32])[0] * (65536 if page == 1 else page)
    if header[24:28] == header[92:96] and size < expected:
        raise InputError(f"{path} is cut off: {size} bytes of {expected} are there; restore it from a copy")


def _check_contents(path: Path, connection: sqlite3.Connection) -> Profile:
    problems = [str(row[0]) for row in connection.execute("PRAGMA quick_check(3)")]
    if problems != ["ok"]:
        first = problems[0].splitlines()[-1]
        raise InputError(f"{path} is damaged ({first}); restore it from a copy")
    text = _meta(connection, "profile")
    if text is None:
        raise InputError(f"{path} is damaged (its profile is missing); restore it from a copy")
    try:
        return profile_from_json(text)
    except InputError as error:
        raise InputError(f"{path} holds a profile that this cellapp cannot read: {error}") from None


@contextlib.contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:
        if "no such table" in str(error):
            raise InputError(f"{path} is damaged ({error}); restore it from a copy") from None
        raise
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path} is damaged ({error}); restore it from a copy") from None


@contextlib.contextmanager
def _readable_errors(folder: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(
            f"{folder / FILE_NAME}: {error}; check that the disk is neither full nor write-protected"
            " and that no other program holds the file"
        ) from error
    except sqlite3.ProgrammingError as error:
        raise InputError(f"{folder / FILE_NAME}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise InputError(f"{folder / FILE_NAME}: {error}; restore the run from a copy") from error
    except OSError as error:
        where = error.filename or folder
        raise InputError(f"{where}: {error.strerror or error}; check the path and its rights") from error


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":  # elsewhere a folder cannot be opened, and needs no such help
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _meta(connection: sqlite3.Connection, key: str) -> str | None:
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _some(values: Sequence[Any] | NDArray[Any], limit: int = 3) -> str:
    shown = ", ".join(str(value) for value in values[:limit])
    return shown + (", ..." if len(values) > limit else "")


# -- rows and arrays --------------------------------------------------------------------------------------------------


def _one_row(configuration: int, reading: Reading) -> Readings:
    def scalar(value: float | None) -> NDArray[np.float64] | None:
        return None if value is None else np.array([value], dtype=np.float64)

    def row(value: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
        return None if value is None else np.asarray(value, dtype=np.float64)[np.newaxis]

    q = np.asarray(reading.q, dtype=np.float64)[np.newaxis]
    return Readings(
        configuration=np.array([configuration], dtype=np.int64),
        time_s=np.array([reading.time_s], dtype=np.float64),
        q=q,
        approach=np.asarray(np.zeros(q.shape[1]) if reading.approach is None else reading.approach, dtype=np.int8)[
            None
        ],
        p_M=np.asarray(reading.p_M, dtype=np.float64)[np.newaxis],
        payload_kg=scalar(reading.payload_kg),
        temperature_c=scalar(reading.temperature_c),
        joint_temperature_c=row(reading.joint_temperature_c),
        step=row(reading.step),
        dwell_s=scalar(reading.dwell_s),
        covariance_M=row(reading.covariance_M),
        sigma_m=scalar(reading.sigma_m),
        split=None if reading.split is None else (reading.split,),
        extras={name: (text,) for name, text in reading.extras.items()},
    )


def _check_values(arm: str, joints: int, readings: Readings) -> None:
    if readings.joints != joints:
        raise ValueError(f"{readings.joints} joint positions for the {joints} joints of arm {arm}")
    if not (np.all(np.isfinite(readings.q)) and np.all(np.isfinite(readings.p_M))):
        raise ValueError(f"a joint position or a measured coordinate of arm {arm} is not finite")
    if not np.all(np.abs(readings.approach) <= 1):
        raise ValueError(f"an approach direction of arm {arm} is not -1, 0 or 1")
    for word in readings.split or ():
        if word is not None and word not in SPLITS:
            raise ValueError(f"'{word}' is not a split; splits are {', '.join(SPLITS)}")


def _lists(array: NDArray[np.float64]) -> list[Any]:
    result: list[Any] = np.asarray(array, dtype=np.float64).tolist()
    return result


def _column(values: NDArray[np.float64] | None, n: int) -> list[float | None]:
    """A scalar column for SQLite: NULL where it is missing."""
    if values is None:
        return [None] * n
    return [None if math.isnan(value) else value for value in _lists(values)]


def _vectors(values: NDArray[np.float64] | None, n: int) -> list[str | None]:
    """A column of vectors as JSON: NULL where all of it is missing, null where one number is."""
    if values is None:
        return [None] * n
    cleaned = [[None if math.isnan(value) else value for value in row] for row in _lists(values)]
    return [None if all(value is None for value in row) else json.dumps(row) for row in cleaned]


def _rows(readings: Readings) -> Iterator[tuple[Any, ...]]:
    n = len(readings)
    covariance = None if readings.covariance_M is None else readings.covariance_M[:, _UPPER[0], _UPPER[1]]
    names = list(readings.extras)
    extras: list[str | None] = [None] * n
    if names:
        texts = zip(*readings.extras.values(), strict=True)
        extras = [json.dumps(dict(zip(names, row, strict=True))) for row in texts]
    return zip(
        readings.configuration.tolist(),
        _column(readings.time_s, n),
        _vectors(readings.q, n),
        [json.dumps(row) for row in readings.approach.tolist()],
        _vectors(readings.p_M, n),
        _column(readings.payload_kg, n),
        _column(readings.temperature_c, n),
        _vectors(readings.joint_temperature_c, n),
        _vectors(covariance, n),
        _column(readings.sigma_m, n),
        readings.split or [None] * n,
        extras,
        _vectors(readings.step, n),
        _column(readings.dwell_s, n),
        strict=True,
    )


def _matrix(texts: Sequence[str]) -> NDArray[np.float64]:
    return np.array(json.loads("[" + ",".join(texts) + "]"), dtype=np.float64)


def _optional_matrix(texts: Sequence[str | None], width: int) -> NDArray[np.float64] | None:
    if all(text is None for text in texts):
        return None
    nothing = json.dumps([None] * width)
    return _matrix([nothing if text is None else text for text in texts])


def _optional_column(values: Sequence[float | None]) -> NDArray[np.float64] | None:
    return None if all(value is None for value in values) else np.array(values, dtype=np.float64)


def _from_rows(rows: Sequence[tuple[Any, ...]], joints: int) -> Readings:
    n = len(rows)
    columns: Sequence[tuple[Any, ...]] = list(zip(*rows, strict=True)) if rows else [()] * 14
    configuration, time_s, q, approach, p_M, *optional = columns
    payload, temperature, joint_temperature, upper, sigma, split, extras, step, dwell = optional
    triangle = _optional_matrix(upper, 6)
    covariance = None
    if triangle is not None:
        covariance = np.empty((n, 3, 3))
        covariance[:, _UPPER[0], _UPPER[1]] = triangle
        covariance[:, _UPPER[1], _UPPER[0]] = triangle
    kept = [{} if text is None else json.loads(text) for text in extras]
    names = list(dict.fromkeys(name for row in kept for name in row))
    return Readings(
        configuration=np.array(configuration, dtype=np.int64),
        time_s=np.array(time_s, dtype=np.float64),
        q=_matrix(q).reshape(n, joints),
        approach=_matrix(approach).reshape(n, joints).astype(np.int8),
        p_M=_matrix(p_M).reshape(n, 3),
        payload_kg=_optional_column(payload),
        temperature_c=_optional_column(temperature),
        joint_temperature_c=_optional_matrix(joint_temperature, joints),
        step=_optional_matrix(step, joints),
        dwell_s=_optional_column(dwell),
        covariance_M=covariance,
        sigma_m=_optional_column(sigma),
        split=None if all(word is None for word in split) else tuple(split),
        extras={name: tuple(str(row.get(name, "")) for row in kept) for name in names},
    )
