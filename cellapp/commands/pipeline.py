"""The verbs, one after the other: each reads from the run, calls the pure functions, appends what they made.

The command line and the terminal application call these functions. Nothing else changes stages of a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.records import CollectResult, ImportResult, PlanResult
from cellapp.cell.driving.requests.running import running_job
from cellapp.cell.planning.method import plan_run
from cellapp.cell.planning.proposal.candidate_poses import Effort
from cellapp.cell.planning.proposal.propose import propose_stops
from cellapp.cell.planning.proposed_stops import append_proposed_stops, why_not_driven
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, import_csv
from cellapp.cell.run.collected import missing_share, reference_drifts
from cellapp.cell.run.in_order import read_in_order
from cellapp.cell.targets.compensate import Command
from cellapp.cell.targets.records import CompensateResult, VerifyResult
from cellapp.cell.targets.targets import Target, load_targets
from cellapp.commands.calibrate.prior_source import (
    basis_of_priors,
    earlier_arms,
    earlier_of_calibration,
    recorded_priors,
)
from cellapp.commands.calibrate.run import calibrate_cell
from cellapp.commands.compensate.run import compensate_targets
from cellapp.commands.confirm import Ask, asked_once, confirmation, require_permission
from cellapp.commands.discover.result import proposal_result
from cellapp.commands.discover.run import discover_effects
from cellapp.commands.later_stages import note_later_stages
from cellapp.commands.plan.run import plan_result
from cellapp.commands.push.run import PushJob, check_rounds, push_commands
from cellapp.commands.run_results import ReportResult, RunResults, WholeRunResult
from cellapp.commands.stages import (
    CALIBRATION_FILE,
    Basis,
    RunStages,
    StoredStage,
    append_stage,
    basis_of,
    basis_on_model,
    read_results,
    read_stages,
)
from cellapp.commands.station import profile_at_station, refuse_second_station
from cellapp.commands.stored_model import model_of, require_current_model, stage_in_force, stale_notes
from cellapp.estimation.calibration.calibrate import missing_splits
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.records import DiscoverResult, Proposal
from cellapp.estimation.readings import Readings
from cellapp.ground.blas import one_blas_thread
from cellapp.ground.chromium import print_pdf
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED, Outputs
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore, with_eta
from cellapp.ground.results import CALIBRATE, COMPENSATE, DISCOVER, StageName
from cellapp.interfaces.page.page import write_page
from cellapp.robot.model import CellModel

R = TypeVar("R", bound=RunResults)


def default_folder(profile_name: str) -> Path:
    """A new folder below ``logs`` in the working directory, named after the profile and the time."""
    return Path("logs") / f"{profile_name}-{datetime.now():%Y%m%d-%H%M%S}"


def run_whole(
    profile_path: Path,
    folder: Path | None,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    ask: Ask | None = None,
) -> WholeRunResult:
    """Everything, unattended: plan, collect, calibrate, discover, compensate, verify, report.

    ``ask`` is asked before the first motion of real arms, once.

    Raises
    ------
    CellappError
        Bad input, or a device that refused.
    Cancelled
        On request; the run file keeps all that was committed and can be resumed.
    """
    control = control or JobControl()
    profile = load_profile(profile_path)
    require_permission(profile, ask)
    ask = None if ask is None else asked_once(ask)
    targets: tuple[Target, ...] = ()
    if profile.targets is not None:  # read now: a misspelt list should not show after hours of measuring
        targets = load_targets(profile_path.parent / profile.targets, profile)
    notes: list[str] = []
    with (
        new_planned_run(profile, folder or default_folder(profile.name), listener, control) as run,
        running_job(run, control, "run", listener) as listener,
    ):
        collected = _collect(run, listener, control, ask)
        notes += collected.notes
        notes += calibrate_run(run, listener, control).notes
        discover_run(run, listener, control)
        if targets:
            notes += _push(run, targets, listener, control, ask, verify=True).notes
        write_page(run)
        return _shown(WholeRunResult, read_results(run), notes=tuple(notes), collect=collected)


# -- plan, collect, import --------------------------------------------------------------------------------------------


def new_planned_run(
    profile: Profile, folder: Path, listener: Listener = ignore, cancel: CancelToken | None = None
) -> RunFile:
    """A new run with its plan. Nothing is left behind where there is no plan, or on request.

    Raises
    ------
    InputError
        As ``RunFile.create`` and ``plan_run`` do.
    Cancelled
    """

    def fill(run: RunFile) -> None:
        with one_blas_thread():
            plan_run(run, with_eta(listener), cancel)

    return RunFile.create(folder, profile, fill)


def plan_new_run(
    profile: Profile, folder: Path, listener: Listener = ignore, cancel: CancelToken | None = None
) -> PlanResult:
    """Make a new run with its plan. Raises as ``new_planned_run`` does."""
    with new_planned_run(profile, folder, listener, cancel) as run:
        return plan_result(run)


def collect_stops(
    run: RunFile,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
    ask: Ask | None = None,
) -> CollectResult:
    """Measure the planned stops; ``ask`` is asked before the first motion of real arms.

    Raises as ``collect_run`` and ``confirmation`` do, and ``InputError`` if another job runs in the folder.
    """
    control = control or JobControl()
    with running_job(run, control, "collect", listener) as listener:
        return _collect(run, listener, control, ask, resume=resume, accept_drift=accept_drift)


def _collect(
    run: RunFile,
    listener: Listener,
    control: JobControl,
    ask: Ask | None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
) -> CollectResult:
    refuse_second_station(run)
    confirm = confirmation(run.profile, ask)
    report = with_eta(listener)
    with one_blas_thread():
        summary = collect_run(run, report, control, resume=resume, accept_drift=accept_drift, confirm=confirm)
    return CollectResult(
        stops=len(run.stops_done()),
        notes=summary.notes,
        outcome=summary.outcome,
        missing=summary.missing,
        missing_share=missing_share(run, summary.missing),
        tolerated_share=run.profile.collection.tolerated,
        references=reference_drifts(run),
        standard_error_mm=summary.standard_error_mm,
    )


def import_new_run(profile: Profile, csv: Path, folder: Path, *, in_order: bool = False) -> ImportResult:
    """Make a new run from readings in a CSV file; ``in_order`` and errors are as in ``import_csv``."""
    with import_csv(profile, csv, folder, in_order=in_order) as run:
        return ImportResult(
            run=str(folder),
            readings=_counts(run),
            in_order=read_in_order(run),
            notes=tuple(event.text for event in run.events() if event.level == "note"),
        )


# -- calibrate, discover, propose -------------------------------------------------------------------------------------


def calibrate_run(
    run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None, *, prior: Path | None = None
) -> CalibrateResult:
    """Calibrate a run: draw missing splits, identify, evaluate, append the stage, export the model in force.

    ``prior`` is the folder of an earlier run of the same arms, whose calibration is taken as prior. The notes also say
    whether an earlier discovery and verification still hold.

    Raises
    ------
    InputError
        If an arm has no readings or too few of them, or the earlier run does not suit, see ``earlier_arms``.
    Cancelled
        On request; nothing is stored then.
    """
    notes = draw_missing_splits(run)
    with one_blas_thread():
        earlier = {} if prior is None else earlier_arms(run, prior)
    if not earlier and (used := {record.run for record in recorded_priors(run).values()}):
        notes = (*notes, f"calibrated without the earlier calibration {', '.join(used)}, which was its prior before")
    result, model = calibrate_cell(run.profile, _readings(run), listener, cancel, earlier=earlier, notes=notes)
    basis = basis_of(run).model_copy(update={"priors": basis_of_priors(earlier)})
    _append_with_model(run, CALIBRATE, result, model, basis)
    stages = read_stages(run)
    _export_model(run, stages)
    return result.model_copy(update={"notes": (*result.notes, *note_later_stages(run, stages))})


def discover_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> DiscoverResult:
    """Search every arm of a calibrated run for missing effects, append the stage, export the model with them.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or by a version that did not store the calibration for itself.
    Cancelled
        On request; nothing is stored then.
    """
    return _discover(run, listener, cancel)[0]


def propose_run(
    run: RunFile,
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    effort: Effort | None = None,
) -> DiscoverResult:
    """Discover, then propose ``count`` further stops of all arms and write them into the plan.

    They replace earlier proposals that were not measured. A run that this program does not drive (no plan, or a driver
    ``none``) only gets the list.

    Raises
    ------
    InputError
        As ``discover_run``; or if there is nothing to propose. The discovery is stored in the second case.
    Cancelled
        On request; no proposal is written then.
    """
    result, found = _discover(run, listener, cancel)
    try:
        proposal = propose_after(run, found, count, listener, cancel, effort)
    except InputError as error:
        raise InputError(f"{error}. The discovery is stored: 'cellapp show {run.folder} discovery'") from None
    return result.model_copy(update={"proposal": proposal})


def propose_after(
    run: RunFile,
    found: CellDiscovery,
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    effort: Effort | None = None,
) -> Proposal:
    """Propose ``count`` further stops after a discovery and write them into the plan. Raises as ``propose_stops``."""
    readings = _readings(run)
    with one_blas_thread():
        proposed = propose_stops(
            run.profile, found.model, readings, found.arms, count, with_eta(listener), cancel, effort
        )
    if why := why_not_driven(run):
        note = f"{why}: the stops are listed only; measure them, then import them with the earlier readings"
        return proposal_result(proposed, None, (*proposed.notes, note))
    return proposal_result(proposed, append_proposed_stops(run, proposed.stops), proposed.notes)


def draw_missing_splits(run: RunFile) -> tuple[str, ...]:
    """Draw and store splits, the same for all arms at a stop, where no reading has one yet. Returns notes."""
    readings = _readings(run)
    for name, arm in readings.items():
        if len(arm) == 0:
            raise InputError(
                f"{run.path}: arm '{name}' has no readings; collect or import them, or take the arm out of the profile"
            )
    drawn, notes = missing_splits(run.profile, readings)
    for name, words in drawn.items():
        run.assign_splits(name, words)
    return notes


# -- compensate, push, report -----------------------------------------------------------------------------------------


def compensate_run(run: RunFile, targets: Sequence[Target]) -> CompensateResult:
    """Compute and store commands for targets with the model in force; a note says where that is out of date."""
    return _compensate(run, read_stages(run), targets)[1]


def push_run(
    run: RunFile,
    targets: Sequence[Target],
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    verify: bool,
    iterate: int | None = None,
    out_of_date: bool = False,
    ask: Ask | None = None,
) -> VerifyResult:
    """Compensate and push targets; with ``verify`` measure them before and after compensation.

    ``iterate`` is how often at most what remains at a target is corrected by measuring. ``out_of_date`` uses the model
    in force even where it, or a discovery, is out of date or a controller's own D-H has changed; result and log say so.
    ``ask`` is asked before the first motion of real arms. A job that is stopped stores what it has measured.

    Raises
    ------
    InputError
        If the model is out of date and the operator does not insist, no target can be commanded, or the SMR mount in
        the profile is not the calibrated one. Nothing has moved.
    CheckFailed
        If the doctor finds a fault before real arms move. Nothing has moved.
    HardwareError
        If a device refused or failed, or a controller or its payload is not the calibrated one.
    Cancelled
    """
    control = control or JobControl()
    check_rounds(iterate, verify=verify)
    with running_job(run, control, "verify" if verify else "push", listener) as listener:
        return _push(run, targets, listener, control, ask, verify=verify, iterate=iterate, out_of_date=out_of_date)


def _push(
    run: RunFile,
    targets: Sequence[Target],
    listener: Listener,
    control: JobControl,
    ask: Ask | None,
    *,
    verify: bool,
    iterate: int | None = None,
    out_of_date: bool = False,
) -> VerifyResult:
    stages = read_stages(run)
    if not out_of_date:
        require_current_model(run, stages, "push")
    commands, compensated = _compensate(run, stages, targets)
    job = PushJob(
        run=run,
        profile=profile_at_station(run, stages),
        model=stage_in_force(run, stages),
        commands=commands,
        targets=tuple(targets),
        notes=compensated.notes,
        verify=verify,
        rounds=iterate or 0,
        out_of_date=out_of_date,
    )
    return push_commands(job, with_eta(listener), control, confirmation(run.profile, ask))


def report_run(run: RunFile, pdf: Path | None = None, outputs: Outputs = RENEWED) -> ReportResult:
    """Write ``report.html`` into the run's folder and, with ``pdf``, print it to that file.

    ``outputs`` says what the PDF may replace: left out, an earlier print.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or the page was written but cannot be printed.
    """
    page = write_page(run)
    if pdf is not None:
        print_pdf(page, pdf, outputs=outputs)
    return _shown(ReportResult, read_results(run), page=str(page), pdf=None if pdf is None else str(pdf))


# -- inside -----------------------------------------------------------------------------------------------------------


def _readings(run: RunFile) -> dict[str, Readings]:
    return {name: run.readings(name) for name in run.profile.arms}


def _counts(run: RunFile) -> dict[str, int]:
    return {name: len(run.readings(name)) for name in run.arms()}


def _shown(kind: type[R], stored: RunResults, **more: object) -> R:
    """The stored results as the result of a verb that shows them."""
    return kind.model_validate({**{name: getattr(stored, name) for name in stored.model_fields_set}, **more})


def _discover(run: RunFile, listener: Listener, cancel: CancelToken | None) -> tuple[DiscoverResult, CellDiscovery]:
    calibrated = read_stages(run).current.get(CALIBRATE)
    if calibrated is None:
        raise InputError(f"{run.path}: not calibrated yet; run 'cellapp calibrate' first")
    if calibrated.basis is None:
        raise InputError(
            f"{run.path}: an older version of cellapp calibrated this run and may have changed that calibration since;"
            " run 'cellapp calibrate' again"
        )
    with one_blas_thread():
        earlier = earlier_of_calibration(run)
    model = model_of(run, calibrated)
    result, found = discover_effects(run.profile, model, _readings(run), listener, cancel, earlier=earlier)
    basis = basis_of(run, {CALIBRATE: calibrated.digest}).model_copy(update={"priors": basis_of_priors(earlier)})
    _append_with_model(run, DISCOVER, result, found.model, basis)
    for note in result.notes or ():
        run.log("warning", note)
    _export_model(run, read_stages(run))
    return result, found


def _append_with_model(
    run: RunFile, name: StageName, result: CalibrateResult | DiscoverResult, model: CellModel, basis: Basis
) -> StoredStage:
    """Append a stage; the model's provenance says which stage it belongs to and what that rests on."""
    provenance = {**model.provenance, "stage": name, "basis": basis.model_dump()}
    return append_stage(run, name, result, basis, replace(model, provenance=provenance).to_json())


def _export_model(run: RunFile, stages: RunStages) -> None:
    """Write the model in force for other programs."""
    model_of(run, stage_in_force(run, stages)).save(run.folder / CALIBRATION_FILE)


def _compensate(
    run: RunFile, stages: RunStages, targets: Sequence[Target]
) -> tuple[tuple[Command, ...], CompensateResult]:
    used = stage_in_force(run, stages)
    model = model_of(run, used)
    commands, result = compensate_targets(run.profile, _readings(run), model, targets, stale_notes(stages, used))
    append_stage(run, COMPENSATE, result, basis_on_model(run, used, targets))
    for note in result.notes:
        run.log("warning", note)
    return commands, result
