"""The verbs of the screen Accept as jobs. Packages that a verb needs are loaded in the job's thread."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellapp.commands.report.summary import RunVerdict


def verdict(folder: Path) -> RunVerdict | None:
    """Read judgements, marks and next steps of a run; None if it cannot be read. Call it in a separate thread."""
    from datetime import UTC, datetime

    from cellapp.cell.run import RunFile
    from cellapp.commands.report.summary import read_verdict
    from cellapp.ground.errors import CellappError

    try:
        with RunFile.open(folder) as run:
            return read_verdict(run, datetime.now(UTC).date())
    except (CellappError, OSError, ValueError, TypeError):  # the last three: values of a damaged or foreign file
        return None  # the message line says what is wrong with the run
