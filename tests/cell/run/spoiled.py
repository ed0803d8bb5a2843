"""Run files that cannot be opened, each in its way: functions that spoil the file at a path, and what is said then."""

from __future__ import annotations

import contextlib
import random
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path


def spoil_text(path: Path) -> None:
    path.write_text("configuration,arm\n" * 100)


def spoil_empty(path: Path) -> None:
    path.write_bytes(b"")


def spoil_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:50])


def spoil_header_only(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def spoil_cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


def spoil_middle(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096 : 4096 * 4] = random.Random(1).randbytes(4096 * 3)
    path.write_bytes(bytes(content))


def spoil_newer(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[60:64] = struct.pack(">I", 99)
    path.write_bytes(bytes(content))


def spoil_other(path: Path) -> None:
    path.unlink()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE t (a)")
        connection.commit()


def spoil_tables(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE meta")
        connection.commit()


def spoil_profile(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE meta SET value = '{}' WHERE key = 'profile'")
        connection.commit()


SPOILED: tuple[tuple[Callable[[Path], None], str], ...] = (
    (spoil_text, "is not a run file"),
    (spoil_empty, r"is cut off \(0 bytes\)"),
    (spoil_short, r"is cut off \(50 bytes\)"),
    (spoil_header_only, "is cut off: 100 bytes of"),
    (spoil_cut, "is cut off: .* restore it from a copy"),
    (spoil_middle, "is damaged .* restore it from a copy"),
    (spoil_newer, r"newer cellapp \(schema 99, this one reads up to 11\); install the newer"),
    (spoil_other, "is an SQLite file, but not a run of cellapp"),
    (spoil_tables, "is damaged .*no such table"),
    (spoil_profile, "holds a profile that this cellapp cannot read"),
)
"""Each way to spoil a file, and what is said about it (a regular expression)."""
