"""The verb ``run``: run the other verbs one after the other, each as on its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cellapp.cell.driving.requests import running_job
from cellapp.cell.profile import load_profile
from cellapp.cell.run.file import note_profile
from cellapp.cell.targets.targets import named_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import calibration_tables, tracker_sentences
from cellapp.commands.collect.request import CollectRequest
from cellapp.commands.collect.run import collect_planned
from cellapp.commands.collect.view import collect_lines, other_notes
from cellapp.commands.compensate.tables import verification_tables
from cellapp.commands.confirm import asked_once, require_permission
from cellapp.commands.discover import view as discovery
from cellapp.commands.discover.run import discover_run
from cellapp.commands.doctor.run import needs
from cellapp.commands.plan.run import default_folder, new_planned_run
from cellapp.commands.push.request import PushRequest
from cellapp.commands.push.run import push_targets
from cellapp.commands.record import Request, View, Work
from cellapp.commands.run.request import RunRequest
from cellapp.commands.run_results import WholeRunResult, read_results, shown_by
from cellapp.commands.view.parts import Part
from cellapp.ground.threads import give_back


def run(request: RunRequest, work: Work) -> WholeRunResult:
    """Run everything, unattended: plan, collect, calibrate, discover, compensate, verify, report.

    A person is asked once before the first motion of real arms, and again after a change of load.

    Raises
    ------
    CellappError
        Bad input, or a device that refused.
    Cancelled
        On request; the run file keeps everything that was committed and can be resumed.
    """
    profile, control = load_profile(request.profile), work.control
    ask = work.ask(profile.name)
    require_permission(profile, ask)
    once = None if ask is None else asked_once(ask)
    targets = named_targets(profile, request.profile)
    for need in needs(profile, request.profile, request.sweeps).values():  # now: before hours of measuring
        need()
    notes: list[str] = []
    folder = request.folder or default_folder(profile.name)
    with new_planned_run(profile, folder, work.control, sweeps=request.sweeps) as run, running_job(run, control, "run"):
        note_profile(run, request.profile)
        give_back()  # memory of the plan's candidates
        one = replace(work, ask=lambda profile_name: once)
        asked = CollectRequest(folder=folder)
        collected = collect_planned(run, asked, one if profile.loads == 1 else work)
        notes += collected.notes
        notes += calibrate_run(run, control).notes
        discover_run(run, control)
        give_back()
        if targets:
            notes += push_targets(run, PushRequest(folder=folder, targets=targets, verify=True), one).notes
        work.write_page(run)
        return shown_by(WholeRunResult, read_results(run), notes=tuple(notes), collect=collected)


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
