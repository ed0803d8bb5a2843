"""Paths of exported files: one file per arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellapp.ground.errors import InputError


def check_out(out: Path) -> None:
    """Raise ``InputError`` if ``out`` is not the path of a file."""
    if not out.name or out.is_dir():
        raise InputError(f"export: --out {out} is a folder; give the path of a file")


def files_of_arms(out: Path, arms: Sequence[str]) -> dict[str, Path]:
    """Return the file of each arm: ``out``, or, if there are several arms, with the arm's name before the suffix.

    Raise ``InputError`` if ``out`` is a folder, or an arm's name cannot be part of a file name.
    """
    check_out(out)
    if len(arms) == 1:
        return {arms[0]: out}
    for name in arms:
        if Path(name).name != name:
            raise InputError(f"export: '{name}' cannot be part of a file's name; write this arm alone with --arm")
    return {name: out.with_stem(f"{out.stem}-{name}") for name in arms}
