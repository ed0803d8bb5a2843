"""The verb ``discover``: search for missing effects, append the stage, propose informative stops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.planning.propose import Effort, append_proposed_stops, propose_stops, why_not_driven
from cellapp.cell.planning.propose import Proposal as ProposedStops
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings, read_recordings_of
from cellapp.commands.calibrate.prior_source import basis_of_priors, earlier_of_calibration
from cellapp.commands.discover.request import DiscoverRequest
from cellapp.commands.record import Work
from cellapp.commands.stages import basis_of, not_calibrated, read_stages
from cellapp.commands.stored_model import append_with_model, export_model, model_of
from cellapp.estimation.calibration.calibrate import provenance_of
from cellapp.estimation.discovery.discover import ArmSearch, discover_arm, discover_cell
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.records import DiscoverResult, Proposal, ProposedStop
from cellapp.estimation.motion.calibrate import SearchWithRecordings
from cellapp.estimation.prior.calibrate import SearchWithPriors
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken, Notice, duration_words
from cellapp.ground.results import CALIBRATE, DISCOVER
from cellapp.ground.shell import shell_word
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.effects import EFFECTS
from cellapp.robot.model import CellModel

_SECONDS_AN_ARM, _SECONDS_A_READING = 3.5, 0.003
"""Duration of a search by arms and readings to learn from, on one common core [s], as over real readings."""


def run(request: DiscoverRequest, work: Work) -> DiscoverResult:
    """Search the run for missing effects; propose stops on request."""
    with RunFile.open(request.folder, write=True) as opened:
        if request.propose is None:
            return discover_run(opened, work.control)
        return propose_run(opened, request.propose, work.control)


def discover_run(run: RunFile, job: JobToken = UNATTENDED) -> DiscoverResult:
    """Search every arm of a calibrated run for missing effects, append the stage, export the model with the effects.

    Raises
    ------
    InputError
        If the run is not calibrated yet.
    Cancelled
        On request; nothing is stored then.
    """
    return _discover(run, job)[0]


def propose_run(run: RunFile, count: int, job: JobToken = UNATTENDED) -> DiscoverResult:
    """Discover, then propose ``count`` further stops of all arms and write them into the plan.

    They replace earlier proposals that were not measured. A run that this program does not drive (no plan, or driver
    ``none``) gets only the list.

    Raises
    ------
    InputError
        As ``discover_run``; or if there is nothing to propose. In that case the discovery is stored.
    Cancelled
        On request; no proposal is written then.
    """
    result, found = _discover(run, job)
    try:
        proposal = propose_after(run, found, count, job)
    except InputError as error:
        raise InputError(
            f"{error}. The discovery is stored: 'cellapp show {shell_word(run.folder)} discovery'"
        ) from None
    return result.model_copy(update={"proposal": proposal})


def propose_after(
    run: RunFile, found: CellDiscovery, count: int, job: JobToken = UNATTENDED, effort: Effort | None = None
) -> Proposal:
    """Propose ``count`` further stops after a discovery and write them into the plan. Raises as ``propose_stops``."""
    readings = {name: known_readings(run, name) for name in run.profile.arms}
    with one_blas_thread():
        proposed = propose_stops(run.profile, found.model, readings, found.arms, count, job, effort)
    if why := why_not_driven(run):
        note = f"{why}: the stops are listed only; measure them, then import them with the earlier readings"
        return proposal_result(proposed, None, (*proposed.notes, note))
    return proposal_result(proposed, append_proposed_stops(run, proposed.stops), proposed.notes)


def discover_effects(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    job: JobToken = UNATTENDED,
    search_arm: ArmSearch = discover_arm,
) -> tuple[DiscoverResult, CellDiscovery]:
    """Search every arm for missing effects.

    ``model`` is the calibrated model, ``readings`` are those of its calibration; ``search_arm`` searches one arm. The
    model in the outcome has the accepted effects and a new provenance.

    Raises
    ------
    Cancelled
        On request.
    """
    with one_blas_thread():
        found = discover_cell(profile, model, readings, job, search_arm)
    extended = replace(found.model, provenance=provenance_of(profile).model_dump())
    return discover_result(found), replace(found, model=extended)


def _discover(run: RunFile, job: JobToken) -> tuple[DiscoverResult, CellDiscovery]:
    calibrated = read_stages(run).current.get(CALIBRATE)
    if calibrated is None:
        raise not_calibrated(run.path, run.folder)
    with one_blas_thread():
        earlier = earlier_of_calibration(run)
    names = [*run.profile.arms]
    readings = {name: known_readings(run, name) for name in names}
    recordings, stops = {name: read_recordings_of(run, name) for name in names}, {n: run.readings(n) for n in names}
    model = model_of(run, calibrated)
    plain = SearchWithPriors(earlier) if earlier else discover_arm
    search = SearchWithRecordings(model.arms, stops, recordings, plain) if any(recordings.values()) else plain
    learnt = sum(len(its) - len(its.in_split("validate")) for its in readings.values())
    seconds = _SECONDS_AN_ARM * len(names) + _SECONDS_A_READING * learnt
    words = f"takes some {duration_words(seconds)} for {counted(learnt, 'reading')} to learn from"
    if not any(recordings.values()):  # their samples are chosen later
        job.tell("discover", 0, 0, detail=Notice(words))
    result, found = discover_effects(run.profile, model, readings, job, search)
    basis = basis_of(run, {CALIBRATE: calibrated.digest}).model_copy(update={"priors": basis_of_priors(earlier)})
    append_with_model(run, DISCOVER, result, found.model, basis)
    for note in result.notes or ():
        run.log("warning", note)
    export_model(run, read_stages(run))
    return result, found


# -- Conversion of a discovery to the result of ``discover`` ----------------------------------------------------------


def discover_result(found: CellDiscovery) -> DiscoverResult:
    """Build the object that ``discover --json`` writes and the run file stores."""
    return DiscoverResult(
        arms={name: discovery.result for name, discovery in found.arms.items()},
        pair={} if found.pair is None else {"effects": found.pair.methods["effects"]},
        notes=tuple(f"not searched for: {one.refusal}" for one in EFFECTS.plugins if one.problem) or None,
    )


def proposal_result(proposed: ProposedStops, first: int | None, notes: Sequence[str]) -> Proposal:
    """Build the proposed stops; ``first`` is the number of the first one in the run's plan, None if not in the plan."""
    return Proposal(
        count=len(proposed.stops),
        written=first is not None,
        first_configuration=first,
        arms=proposed.questions,
        stops=tuple(_stop_rows(proposed.stops, first or 0)),
        notes=tuple(notes),
        advice=proposed.advice,
    )


def _stop_rows(stops: PlannedStops, first: int) -> Iterator[ProposedStop]:
    for stop in range(len(stops)):
        starts = stops.approach_starts(stop)
        for name, q in stops.targets(stop).items():
            via, dwell_s = starts.get(name), float(stops.dwell_s[name][stop])
            yield ProposedStop(
                configuration=first + stop,
                arm=name,
                q=tuple(q.tolist()),
                via=None if via is None else tuple(via.tolist()),
                dwell_s=dwell_s if dwell_s > 0.0 else None,
            )
