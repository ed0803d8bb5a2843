"""What commands of blind trials share: the Markdown file, and the exit code for missed bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.errors import CellappError, CheckFailed, InputError

if TYPE_CHECKING:
    from cellapp.trials.judge_records import TargetScore


def check_markdown(path: Path | None) -> None:
    """Raise ``InputError`` if there is no folder for the file: it is written after hours of work."""
    if path is not None and not path.absolute().parent.is_dir():
        raise InputError(f"--markdown: {path}: folder not found; nothing was done")


def write_markdown(path: Path | None, text: str) -> None:
    """Write the tables, if asked for. Raises ``CellappError`` if that fails."""
    if path is None:
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CellappError(f"--markdown: {path} cannot be written ({error.strerror})") from None


def check_bars(failed: Sequence[str], missed: Sequence[TargetScore]) -> None:
    """Raise ``CheckFailed`` if runs could not be judged, or a bar was missed in enough trials to say so."""
    if failed:
        raise CheckFailed(f"{len(failed)} runs could not be judged: {'; '.join(failed)}")
    if missed:
        raise CheckFailed(f"bars missed: {'; '.join(f'{one.kind}: {one.target}' for one in missed)}")
