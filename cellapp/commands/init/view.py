"""The result of ``init`` as sentences."""

from __future__ import annotations

import shlex
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import readings_of
from cellapp.commands.init.result import InitResult
from cellapp.commands.record import Request, View


def view(result: InitResult, request: Request | None = None) -> View:
    """Show notes, the written files, and the next command."""
    files = [result.profile, *([] if result.readings is None else [result.readings])]
    return View((*result.notes, f"written: {', '.join(files)}", f"next: {_next_command(result)}"))


def _next_command(result: InitResult) -> str:
    """Return the next command: ``import`` for a cell that only has readings, ``doctor`` for one with devices."""
    path = Path(result.profile)
    logs = Path("logs") / path.stem
    run = path.parent.parent / logs
    if result.joints is not None:
        streams = ["--joints", result.joints, "--points", result.points or "POINTS.csv"]
        return shlex.join(["cellapp", "import", result.profile, *streams, "--run", str(run)])
    if result.readings is not None:
        return shlex.join(["cellapp", "import", result.profile, result.readings, "--run", str(run)])
    if any(arm.driver.has_device for arm in load_profile(path).arms.values()):
        return f"cellapp doctor {path}"
    readings = readings_of(path.stem, path.parent)
    return f"cellapp import {path} {readings if readings.is_file() else 'READINGS.csv'} --run {logs}"
