"""The result of ``run`` as tables and sentences."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.calibrate.view import calibration_tables, tracker_sentences
from cellapp.commands.collect.view import collect_lines, other_notes
from cellapp.commands.compensate.tables import verification_tables
from cellapp.commands.discover import view as discovery
from cellapp.commands.record import Request, View
from cellapp.commands.run.result import WholeRunResult
from cellapp.commands.view.parts import Part


def view(result: WholeRunResult, request: Request | None = None) -> View:
    """Show the results of each step, notes, the paths of run and page; and the failures of the first failed step."""
    parts: list[Part] = []
    if result.collect is not None:
        parts += collect_lines(result.collect)
    if result.calibrate is not None:
        parts += calibration_tables(result.calibrate)
    if result.discover is not None:
        parts += discovery.view(result.discover).parts
    if result.verify is not None:
        parts += verification_tables(result.verify)
    if result.calibrate is not None:
        parts += tracker_sentences(result.calibrate)
    parts += other_notes(result.collect, result.notes)
    parts.append(f"run: {result.run}   report: {Path(result.run) / 'report.html'}")
    steps = (("collect", result.collect), ("verification", result.verify))
    failed = [(name, step.complaints()) for name, step in steps if step is not None and step.complaints()]
    if failed:
        return View(parts, failed[0][1], failed[0][0])
    unverified = "nothing was verified, the profile names no targets"
    return View(parts, held=unverified if result.verify is None else "the verification held")
