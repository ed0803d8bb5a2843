"""The verb ``plan``: make a new run with its plan, check and edit plans.

A plan is edited by hand as a CSV file (``cell.planning.plan_csv``). The plan of a run can be extended, or its
unmeasured stops designed again; measured stops never change.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from cellapp.cell.driving.requests import running_job
from cellapp.cell.planning.plan import make_stops, plan_run
from cellapp.cell.planning.plan_csv import PlanFile, read_plan_csv, write_plan_csv
from cellapp.cell.planning.planned_stops import (
    PlannedStops,
    planned_time,
    read_plan_design,
    read_planned_stops,
    without_reserves,
    write_planned_stops,
)
from cellapp.cell.planning.records import PlanCheckResult, PlanRefusal
from cellapp.cell.planning.sweeps import SWEEPS_RESULT, plan_sweeps, read_planned_sweeps
from cellapp.cell.planning.view import check_each_stop, check_stops, required_plan
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.file import note_profile
from cellapp.commands.plan.check_view import file_refusal_sentence
from cellapp.commands.plan.request import PlanRequest
from cellapp.commands.plan.result import PlannedLoad, PlannedStop, PlanResult, StopsResult, SweepCount
from cellapp.commands.record import Work
from cellapp.ground.control import JobControl
from cellapp.ground.counting import counted, listed_numbers
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.shell import shell_word
from cellapp.ground.threads import one_blas_thread

_CHANGED = "plan changed: "
"""Prefix of the log line for each change of a plan; the number of such lines varies the seed of the next change."""
_SEED = 0xADD
"""Mixed with the profile's seed to sample other candidates than those that could partly not be reached."""


def run(request: PlanRequest, work: Work) -> PlanResult | PlanCheckResult:
    """Make, change or check a plan, as requested."""
    if request.profile is None:
        assert request.folder is not None, "the request says so"
        return _changed(request, request.folder, work)
    profile = load_profile(request.profile)
    if request.folder is None:
        assert request.source is not None, "the request says so"
        return check_plan_file(profile, request.source, work.control)
    if request.source is not None:
        make = plan_around_file if request.keep else plan_from_file
        result = make(profile, request.source, request.folder, work.control)
    else:
        with new_planned_run(profile, request.folder, work.control, sweeps=request.sweeps) as made:
            result = plan_result(made)
    with RunFile.open(request.folder, write=True) as planned:
        note_profile(planned, request.profile)
    return result


def _changed(request: PlanRequest, folder: Path, work: Work) -> PlanResult:
    with RunFile.open(folder, write=True) as opened:
        if request.freeze is not None:
            return freeze_stops(opened, [stop - 1 for stop in listed_numbers(request.freeze, "stops")], work.control)
        if request.add is not None:
            return extend_plan(opened, request.add, work.control)
        return replan(opened, work.control)


def default_folder(profile_name: str) -> Path:
    """Return a new folder below ``logs`` in the working directory, named after profile and time."""
    return Path("logs") / f"{profile_name}-{datetime.now():%Y%m%d-%H%M%S}"


def new_planned_run(
    profile: Profile, folder: Path, job: JobToken = UNATTENDED, *, sweeps: int | None = None
) -> RunFile:
    """Make a new run with its plan; leave nothing behind if there is no plan or the job is cancelled.

    ``sweeps`` is the number of stops of a plan with a sweep of every arm at each stop.

    Raises
    ------
    InputError
        As ``RunFile.create`` and ``plan_run`` do.
    Cancelled
    """

    if sweeps is not None and profile.loads > 1:
        raise InputError("plan: --sweeps records with one load; leave out arms.NAME.payloads, or plan stops alone")
    if sweeps is not None:
        plan = profile.plan.model_copy(update={"stops": sweeps, "reserve": 0})
        profile = profile.model_copy(update={"plan": plan})

    def fill(run: RunFile) -> None:
        stops = plan_run(run, job)
        if sweeps is not None:
            with one_blas_thread():
                planned = plan_sweeps(profile, stops, job)
            run.write_document(SWEEPS_RESULT, planned.model_dump_json())
            for note in planned.notes:
                run.log("note", note)

    return RunFile.create(folder, profile, fill)


def plan_result(run: RunFile, notes: Sequence[str] = ()) -> PlanResult:
    """Return the result of ``plan`` for the plan of a run. Raises ``InputError`` if the run has none."""
    stops = required_plan(run)
    visited = without_reserves(run.profile, stops)
    return PlanResult(
        run=str(run.folder),
        stops={name: len(visited) for name in stops.q},
        reserves=len(stops) - len(visited),
        design=read_plan_design(run),
        time=planned_time(run.profile, visited),
        sweeps=planned_sweeps(run),
        loads=planned_loads(run.profile, visited),
        notes=tuple(notes),
    )


def planned_loads(profile: Profile, stops: PlannedStops) -> tuple[PlannedLoad, ...] | None:
    """Return the loads of a plan in their order; None if there is only one."""
    if profile.loads == 1:
        return None
    found = []
    for load in np.unique(stops.load).tolist():
        own = np.flatnonzero(stops.load == load) + 1
        payload_kg = {name: arm.payload_at(load).mass for name, arm in profile.arms.items()}
        found.append(PlannedLoad(first=int(own[0]), last=int(own[-1]), payload_kg=payload_kg))
    return tuple(found)


def planned_sweeps(run: RunFile) -> dict[str, SweepCount] | None:
    """Return the number and duration of the planned sweeps of each arm; None if there are none."""
    sweeps = read_planned_sweeps(run).sweeps
    by_arm = {name: [one for one in sweeps if one.arm == name] for name in run.profile.arms}
    if not sweeps:
        return None
    return {
        name: SweepCount(
            n=len(its),
            seconds=sum(one.period_s for one in its),
            swinging=sum(one.beside is not None for one in its) or None,
        )
        for name, its in by_arm.items()
    }


def planned_stops(run: RunFile) -> StopsResult:
    """Return every planned stop of a run with whether it is measured, its design, and the sweeps about the stops.

    Raises ``InputError`` if the stored design is damaged.
    """
    stops, done = read_planned_stops(run), run.stops_done()
    plan = stops.q
    count = max((len(q) for q in plan.values()), default=0)
    return StopsResult(
        run=str(run.folder),
        stops=tuple(
            PlannedStop(
                configuration=stop,
                measured=stop in done,
                q={name: tuple(np.asarray(q[stop]).tolist()) for name, q in plan.items()},
            )
            for stop in range(count)
        ),
        design=read_plan_design(run),
        sweeps=planned_sweeps(run),
        loads=planned_loads(run.profile, stops),
    )


# -- plans as files ---------------------------------------------------------------------------------------------------


def export_plan(run: RunFile, path: Path, outputs: Outputs = NEW_ONLY) -> None:
    """Write the plan of a run as CSV. Raises ``InputError`` without a plan, or if the file cannot be written."""
    write_plan_csv(required_plan(run), path, outputs)


def check_plan_file(profile: Profile, path: Path, job: JobToken = UNATTENDED) -> PlanCheckResult:
    """Check a hand-edited plan by the rules of ``show DIR plan --check``. It only reads.

    Raises
    ------
    InputError
        As ``read_plan_csv``.
    Cancelled
    """
    return _checked(profile, read_plan_csv(path, profile), job)


def plan_from_file(profile: Profile, path: Path, folder: Path, job: JobToken = UNATTENDED) -> PlanResult:
    """Make a run with a hand-edited plan exactly as it is written.

    If the number of stops in the file differs from the profile, the run's profile is changed to it, without reserves.

    Raises
    ------
    InputError
        As ``read_plan_csv`` and ``RunFile.create``.
    CheckFailed
        With every offence, if the gate or the tracker's view refuses something. Nothing is written then.
    Cancelled
    """
    file = read_plan_csv(path, profile)
    _require_safe(_checked(profile, file, job))
    count, notes = len(file.stops), []
    if count != profile.plan.stops + profile.plan.reserve:
        notes.append(
            f"the file has {counted(count, 'stop')}, the profile asks for {profile.plan.stops}: the run has {count}"
        )
        plan = profile.plan.model_copy(update={"stops": count, "reserve": 0})
        profile = profile.model_copy(update={"plan": plan})

    def fill(run: RunFile) -> None:
        write_planned_stops(run, file.stops)
        run.log("info", f"plan: {counted(count, 'stop')} from {path}")

    with RunFile.create(folder, profile, fill) as run:
        return plan_result(run, notes)


def plan_around_file(profile: Profile, path: Path, folder: Path, job: JobToken = UNATTENDED) -> PlanResult:
    """Make a run with the stops of a file frozen, and design further ones around them, ``plan.stops`` in all.

    Raises
    ------
    InputError
        As ``read_plan_csv``, ``RunFile.create`` and ``make_stops``.
    CheckFailed
        With every offence, if a stop of the file or its last motion is refused. Nothing is written then.
    Cancelled
    """
    file = read_plan_csv(path, profile)
    _require_safe(_of_file(file, 0, check_each_stop(profile, file.stops)))
    kept = replace(file.stops, frozen=np.ones(len(file.stops), dtype=np.bool_))
    stops, design = make_stops(profile, job, kept=kept)

    def fill(run: RunFile) -> None:
        write_planned_stops(run, stops, design=design)
        run.log("info", f"plan: {counted(len(stops), 'stop')}, {len(kept)} of them kept from {path}")

    with RunFile.create(folder, profile, fill) as run:
        return plan_result(run)


# -- plans in runs ----------------------------------------------------------------------------------------------------


def extend_plan(run: RunFile, count: int, control: JobControl | None = None) -> PlanResult:
    """Append ``count`` stops to the plan of a run, designed around its stops; measured ones count as information.

    Raises
    ------
    InputError
        If the run has no plan, another job runs in its folder, or not enough stops can be reached.
    Cancelled
        On request; the plan is unchanged then.
    """
    control = control or JobControl()
    with running_job(run, control, "plan"):
        kept = required_plan(run)
        stops, design = make_stops(_other_seed(run), control, kept=kept, add=count)
        write_planned_stops(run, stops, design=design)
        note = f"{counted(len(stops) - len(kept), 'stop was', 'stops were')} added after stop {len(kept)}"
        run.log("info", _CHANGED + note)
        return plan_result(run, [note])


def replan(run: RunFile, control: JobControl | None = None) -> PlanResult:
    """Design the unmeasured stops of a run again, around the measured ones.

    Stops that could not be reached or measured are replaced. Measured stops stay; so do those that discovery proposed
    or a person froze, unless they could not be reached.

    Raises
    ------
    InputError
        If the run has no plan, another job runs in its folder, nothing is left to design, or not enough stops can be
        reached.
    Cancelled
        On request; the plan is unchanged then.
    """
    control = control or JobControl()
    with running_job(run, control, "plan"):
        stops = required_plan(run)
        parts = _parts(run, stops)
        needed = len(parts.open) + parts.more - len(parts.frozen)
        if needed <= 0:
            raise InputError(
                f"{run.path}: every stop is measured, proposed or frozen: nothing is left to design; extend the run"
                f" with 'cellapp plan --edit --run {shell_word(run.folder)} --add N'"
            )
        kept = stops.take([*parts.fixed, *parts.frozen])
        made, design = make_stops(_other_seed(run), control, kept=kept, add=needed)
        write_planned_stops(run, made.take(parts.places(len(made))), design=design)
        note = f"{counted(len(made) - len(kept), 'stop was', 'stops were')} designed again around {len(kept)}"
        if parts.unreached:
            listed = ", ".join(str(stop + 1) for stop in parts.unreached)
            note += f"; replaced were stops that could not be reached or measured: {listed}"
        run.log("info", _CHANGED + note)
        return plan_result(run, [note])


def freeze_stops(run: RunFile, chosen: Collection[int], control: JobControl | None = None) -> PlanResult:
    """Freeze the ``chosen`` stops (from 0) and no others: later designs of the run's plan keep them.

    Raises
    ------
    InputError
        If the run has no plan or not these stops, or another job runs in its folder.
    """
    control = control or JobControl()
    with running_job(run, control, "plan"):
        stops = required_plan(run)
        if unknown := [stop for stop in chosen if not 0 <= stop < len(stops)]:
            raise InputError(f"{run.path}: there is no stop {unknown[0] + 1}; there are 1 to {len(stops)}")
        frozen = np.isin(np.arange(len(stops)), list(chosen))
        write_planned_stops(run, replace(stops, frozen=frozen))
        return plan_result(run, [f"{int(frozen.sum())} of {counted(len(stops), 'stop is', 'stops are')} frozen"])


@dataclass(frozen=True)
class _Parts:
    """Rows of a plan, sorted by what a new design does with them; ``fixed`` and ``open`` together are all rows.

    Rows ``fixed`` stay in their places; rows ``open`` are filled anew, reserves last, and the new stops include those
    of ``frozen``. ``more`` stops are appended in place of fixed rows that could not be reached.
    """

    fixed: tuple[int, ...]
    open: tuple[int, ...]
    frozen: tuple[int, ...]
    unreached: tuple[int, ...]
    more: int

    def places(self, total: int) -> list[int]:
        """Return for each row of the new plan the index of its stop; new stops are numbered after those of ``fixed``.

        Raises ``InputError`` if the new plan is too short for a fixed row.
        """
        if self.fixed and max(self.fixed) >= total:
            raise InputError(
                "plan: too few stops can be reached for the places that are to be filled; ask for a smaller"
                " plan.clearance, or plan a new run"
            )
        before = len(self.fixed) + len(self.open)
        rows = [*self.fixed, *(row for row in (*self.open, *range(before, total)) if row < total)]
        return sorted(range(total), key=rows.__getitem__)


def _parts(run: RunFile, stops: PlannedStops) -> _Parts:
    done, outcomes = run.stops_done(), run.outcomes()
    unreached = {one.stop for one in outcomes} - done
    fixed = done | {*np.flatnonzero(stops.proposed).tolist()} - unreached
    if run.references():  # measured at the first stop that was not left out: keep that in place
        left_out = {one.stop for one in outcomes if one.kind == "left out"}
        first = next((stop for stop in range(len(stops)) if stop not in left_out), 0)
        fixed |= {*range(first + 1)}
    reserves = run.profile.plan.reserves(len(stops))
    rows = [stop for stop in range(len(stops)) if stop not in fixed]
    rows.sort(key=lambda stop: stop in reserves)
    return _Parts(
        fixed=tuple(sorted(fixed)),
        open=tuple(rows),
        frozen=tuple(stop for stop in rows if stops.frozen[stop] and stop not in unreached),
        unreached=tuple(sorted(unreached)),
        more=len(unreached & fixed),
    )


def _other_seed(run: RunFile) -> Profile:
    """Return the run's profile with a new seed for each change of the plan."""
    changes = sum(event.text.startswith(_CHANGED) for event in run.events())
    seed = int(np.random.SeedSequence([run.profile.seed, _SEED, changes]).generate_state(1)[0])
    return run.profile.model_copy(update={"seed": seed})


# -- offences of a file -----------------------------------------------------------------------------------------------


def _checked(profile: Profile, file: PlanFile, job: JobToken) -> PlanCheckResult:
    return _of_file(file, len(file.stops) + 1, check_stops(profile, file.stops, job))


def _of_file(file: PlanFile, ways: int, refused: Sequence[PlanRefusal]) -> PlanCheckResult:
    """Build the check of a file; it names the file's configurations and lines instead of stop numbers."""

    def number(stop: int | None) -> int | None:
        return None if stop is None else file.configurations[stop]

    named = tuple(
        one.model_copy(
            update={
                "configuration": number(one.configuration),
                "before": number(one.before),
                "line": file.lines[-1 if one.configuration is None else one.configuration],
            }
        )
        for one in refused
    )
    return PlanCheckResult(run="", stops=len(file.stops), ways=ways, refused=named, file=str(file.path))


def _require_safe(check: PlanCheckResult) -> None:
    offences = [file_refusal_sentence(check, one) for one in check.refused if not one.is_avoided]
    if offences:
        raise CheckFailed("\n".join([f"plan: {len(offences)} offences; nothing was written", *offences]))
