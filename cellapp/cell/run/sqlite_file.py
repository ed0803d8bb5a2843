"""Safe opening of run files: checks a file before SQLite may change it, and reports errors in one sentence."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path

from cellapp.cell.run.schema import APPLICATION_ID, SCHEMA_VERSION
from cellapp.ground.errors import InputError

FILE_NAME = "run.sqlite"
UNFINISHED = FILE_NAME + ".new"
"""Name of a run file while it is created; it gets its final name when it is complete."""
REPORT_FILE = "report.html"
"""Name of the report's page in a run's folder."""
"""Marks an SQLite file as a run: "Cell" in ASCII."""

_MAGIC = b"SQLite format 3\x00"
_HEADER_BYTES = 100
_BUSY_S = 10.0
"""Time that a statement waits for another program's transaction, which takes milliseconds."""


def connect(path: Path, mode: str, wait_s: float = _BUSY_S) -> sqlite3.Connection:
    """Connect with ``mode`` ``ro`` or ``rw``, without implicit transactions, for use in any thread.

    ``wait_s`` is how long a statement waits for another program's lock.
    """
    return sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        uri=True,
        timeout=wait_s,
        isolation_level=None,
        check_same_thread=False,
    )


def make_empty_folder(folder: Path) -> list[Path]:
    """Make the folder if it is missing; return the folders that were made, innermost first.

    Raises
    ------
    InputError
        If it holds anything, cannot be made, or is a file.
    """
    if folder.is_dir():
        with sentences(folder):
            names = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith(UNFINISHED))
        if FILE_NAME in names:
            raise InputError(
                f"{folder} already holds a run ({FILE_NAME}): 'cellapp show {folder}' says what comes next in it;"
                " for another run choose a new folder"
            )
        if names:
            shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
            raise InputError(f"{folder} is not empty ({shown}); a run needs an empty or new folder, choose another one")
        return []
    if folder.exists():
        raise InputError(f"{folder} is a file; a run needs a folder of its own, choose another name")
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with sentences(folder):
        folder.mkdir(parents=True)
    return missing


def check_header(folder: Path, path: Path) -> None:
    """Check the first bytes, whose layout is part of SQLite's file format, before SQLite opens the file.

    Raises
    ------
    InputError
        If it is missing, no run file, cut off, or of a newer schema.
    """
    if not folder.exists():
        raise InputError(f"{folder}: run folder not found; 'cellapp plan' or 'cellapp import' makes one")
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the folder that holds {FILE_NAME}")
    if not path.exists():
        raise InputError(f"{folder} holds no run ({FILE_NAME} is missing); give the folder of a run")
    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES)
        size = file.seek(0, os.SEEK_END)
    if not _MAGIC.startswith(header[: len(_MAGIC)]):
        raise InputError(f"{path} is not a run file (not SQLite); check the folder's name")
    if len(header) < _HEADER_BYTES:
        raise InputError(f"{path} is cut off ({size} bytes); restore it from a copy")
    version, application = struct.unpack(">I", header[60:64])[0], struct.unpack(">I", header[68:72])[0]
    if application != APPLICATION_ID:
        raise InputError(f"{path} is an SQLite file, but not a run of cellapp; check the folder's name")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{path} was written by a newer cellapp (schema {version}, this one reads up to {SCHEMA_VERSION});"
            " install the newer cellapp to open it"
        )
    log = Path(f"{path}-wal")
    if log.exists() and log.stat().st_size > 0:
        return  # pages missing in the file may be in the write-ahead log; SQLite's own check follows
    page = struct.unpack(">H", header[16:18])[0]
    expected = struct.unpack(">I", header[28:32])[0] * (65536 if page == 1 else page)
    if header[24:28] == header[92:96] and size < expected:  # else SQLite does not trust the stored size
        raise InputError(f"{path} is cut off: {size} bytes of {expected} are there; restore it from a copy")


def check_integrity(path: Path, connection: sqlite3.Connection) -> None:
    """Let SQLite check its pages. Raise ``InputError`` for a damaged file."""
    problems = [str(row[0]) for row in connection.execute("PRAGMA quick_check(3)")]
    if problems != ["ok"]:
        raise InputError(f"{path} is damaged ({problems[0].splitlines()[-1]}); restore it from a copy")


@contextlib.contextmanager
def damage_as_sentence(path: Path) -> Iterator[None]:
    """Report errors of SQLite during checks as damage of the file."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "no such table" in str(error):
            raise InputError(f"{path} is damaged ({error}); restore it from a copy") from None
        raise
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path} is damaged ({error}); restore it from a copy") from None


@contextlib.contextmanager
def sentences(folder: Path) -> Iterator[None]:
    """Convert errors of SQLite and of the file system to an ``InputError`` that names the file and what to do."""
    path = folder / FILE_NAME
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(
            f"{path}: {error}; check that the disk is neither full nor write-protected"
            " and that no other program holds the file"
        ) from error
    except sqlite3.ProgrammingError as error:
        raise InputError(f"{path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path}: {error}; restore the run from a copy") from error
    except OSError as error:
        where = error.filename or folder
        raise InputError(f"{where}: {error.strerror or error}; check the path and its permissions") from error


def sync_folder(folder: Path) -> None:
    """Flush the folder's entries to disk, so that a renamed file survives a power failure."""
    if os.name == "posix":  # other systems cannot open a folder and do not need it
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
