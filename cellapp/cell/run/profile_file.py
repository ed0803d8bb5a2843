"""Location of the profile's file of a run: from there, records beside the profile are found."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.run.file import RunFile

_STORED = "profile file"
"""Name of the stored result."""


def rehearsals_path(profile: Path) -> Path:
    """Return the file beside a profile that records its rehearsals."""
    return profile.with_name(f"{profile.stem}.rehearsals.json")


def note_profile(run: RunFile, path: Path) -> None:
    """Store in a run where its profile's file is."""
    run.write_result(_STORED, str(path.resolve()))


def noted_profile(run: RunFile) -> Path | None:
    """Return where the profile's file was when the run was planned; None if that is not known."""
    text = run.read_result(_STORED)
    return None if text is None else Path(text)
