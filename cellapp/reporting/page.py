"""One self-contained HTML page of a run."""

from __future__ import annotations

from pathlib import Path

from cellapp.run import RunFile


def write_page(run: RunFile) -> Path:
    """Write ``report.html`` into the run's folder and return its path."""
    raise NotImplementedError
