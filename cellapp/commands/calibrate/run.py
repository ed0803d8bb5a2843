"""The verb ``calibrate``: identify the arms of a run, append the stage, note the consequences for later stages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import keep_samples, read_recordings_of, recording_states
from cellapp.cell.run.stations import STATIONS_RESULT, stored_tie_sentences
from cellapp.commands.calibrate.prior_source import basis_of_priors, earlier_arms, recorded_priors
from cellapp.commands.calibrate.request import CalibrateRequest
from cellapp.commands.calibrate.result import calibrate_result
from cellapp.commands.record import Work
from cellapp.commands.stages import CALIBRATION_FILE, RunStages, basis_of, read_stages
from cellapp.commands.stored_model import append_with_model, export_model
from cellapp.estimation.calibration.calibrate import calibrate_readings, missing_splits, refuse_too_few
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.prior.calibrate import calibrate_with_prior
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.network_kind import NetworkKind
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER, LOCATE, VERIFY
from cellapp.ground.shell import shell_word
from cellapp.ground.threads import one_blas_thread


def run(request: CalibrateRequest, work: Work) -> CalibrateResult:
    """Calibrate the run."""
    with RunFile.open(request.folder, write=True) as opened:
        return calibrate_run(opened, work.control, prior=request.prior, network=request.network)


def calibrate_run(
    run: RunFile, job: JobToken = UNATTENDED, *, prior: Path | None = None, network: NetworkKind | None = None
) -> CalibrateResult:
    """Calibrate a run: sample missing splits, identify, evaluate, append the stage, export the model in force.

    ``prior`` is the folder of an earlier run of the same arms, whose calibration serves as prior. ``network`` replaces
    the kind of network in the profile. The notes also say whether an earlier discovery and verification still hold.

    Raises
    ------
    InputError
        If an arm has no or too few readings, or the earlier run is not suitable, see ``earlier_arms``.
    Cancelled
        On request; nothing is stored then.
    """
    profile = run.profile
    if network is not None:
        profile = profile.model_copy(update={"network": profile.network.model_copy(update={"kind": network})})
    notes = (*stored_tie_sentences(run.read_document(STATIONS_RESULT)), *sample_missing_splits(run))
    readings = {name: run.readings(name) for name in run.profile.arms}
    recordings = {name: read_recordings_of(run, name) for name in run.profile.arms}
    if prior is not None and any(recordings.values()):
        raise InputError("calibrate: --prior is for readings at rest; recordings of motion have no such prior yet")
    for name, arm in profile.arms.items():
        held = [key for key in ("fixed", "bounds", "tied") if getattr(arm, key)]
        if prior is not None and held:
            raise InputError(f"calibrate: --prior frees what arms.{name}.{held[0]} holds; take one of them")
        if recordings[name] and arm.bounds:
            raise InputError(f"calibrate: arms.{name}.bounds do not hold for recordings of motion yet; take them out")
    if prior is None and (used := {record.run for record in recorded_priors(run).values()}):
        notes = (*notes, f"calibrated without the earlier calibration {', '.join(used)}, which was its prior before")
    with one_blas_thread():
        earlier = {} if prior is None else earlier_arms(run, prior)
        if any(recordings.values()):
            from cellapp.estimation.motion.calibrate import calibrate_with_motion  # for a faster start without motion

            found, samples = calibrate_with_motion(profile, readings, recordings, job)
            keep_samples(run, samples)
        else:
            found = calibrate_readings(profile, readings, job)
        if earlier:
            found = calibrate_with_prior(profile, readings, found, earlier)
    result, now = calibrate_result(found, notes), basis_of(run)
    append_with_model(run, CALIBRATE, result, found.model, now.model_copy(update={"priors": basis_of_priors(earlier)}))
    stages = read_stages(run, lambda _: now)
    export_model(run, stages)
    return result.model_copy(update={"notes": (*result.notes, *note_later_stages(run, stages))})


def sample_missing_splits(run: RunFile) -> tuple[str, ...]:
    """Sample and store splits if no reading has one yet, the same for all arms at a stop; return notes."""
    counts = run.split_counts()
    recorded = {state.arm for state in recording_states(run)}
    for name in run.profile.arms:
        if name not in counts and name not in recorded:
            raise InputError(
                f"{run.path}: arm '{name}' has no readings; collect or import them, or take the arm out of the profile"
            )
    if not counts or any(word is not None for its in counts.values() for word in its):
        return ()
    readings = {name: run.readings(name) for name in counts}
    sampled, notes = missing_splits(run.profile, readings)
    for name, words in sampled.items():
        if name not in recorded:  # splits are sampled once: too few stops now must not bind those to come
            refuse_too_few(name, replace(readings[name], split=words))
    for name, words in sampled.items():
        run.assign_splits(name, words)
    return (*notes, *_of_stops_to_come(run))


def _of_stops_to_come(run: RunFile) -> tuple[str, ...]:
    """Say what becomes of planned stops that are measured after the splits are sampled."""
    more = len(run.untried_stops())
    words = f"{counted(more, 'planned stop is', 'planned stops are')} not measured: splits are chosen once, so that"
    return (f"{words} those measured later only train; to split all of them, collect into a new run",) if more else ()


def note_later_stages(run: RunFile, stages: RunStages) -> list[str]:
    """Return, and log, notes on whether an earlier discovery and verification hold after a new calibration."""
    notes = []
    discovered, reason = stages.current.get(DISCOVER), stages.out_of_date.get(DISCOVER)
    if discovered is not None and reason is None:
        notes.append(f"the discovery still holds; {CALIBRATION_FILE} keeps the effects that were found")
    elif discovered is not None:
        kept = "keeps its effects" if stages.in_force is discovered else "holds the new calibration without effects"
        notes.append(
            f"the discovery is out of date ({reason}): {CALIBRATION_FILE} {kept}; run 'cellapp discover"
            f" {shell_word(run.folder)}'"
        )
    later = {LOCATE: "the tracker's station", VERIFY: "the verification", CHECK: "the check of the calibration"}
    outdated = stages.out_of_date
    notes += [f"{what} is out of date ({outdated[name]})" for name, what in later.items() if name in outdated]
    for note in notes:
        run.log("note", note)
    return notes
