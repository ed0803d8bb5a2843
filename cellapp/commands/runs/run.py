"""List the runs below a folder, quickly and read-only; a run that cannot be read gets a row with the reason.

The verb ``runs``: list a folder of runs, or one arm over them. It only reads.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from cellapp.cell.driving.records import End
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.run_arms import StoredIdentity, arm_identities
from cellapp.cell.run.sqlite_file import FILE_NAME, last_session
from cellapp.commands.record import Work
from cellapp.commands.run_results import RunResults
from cellapp.commands.run_state import RunState
from cellapp.commands.runs.request import RunsRequest
from cellapp.commands.runs.result import (
    ArmFigures,
    ArmHistory,
    ArmRun,
    LastSession,
    MovedParameter,
    RunsResult,
    RunSummary,
    StageSummary,
)
from cellapp.commands.stored_model import comparable_arms
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.estimation.monitoring.parameter_changes import CalibratedArm, Difference, differences
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.job_client import who_uses
from cellapp.ground.results import STAGES, ErrorSummary


def run_figures(results: RunResults) -> dict[str, ArmFigures]:
    """Return the figures of each arm."""
    calibrated = {} if results.calibrate is None else results.calibrate.arms
    searched = {} if results.discover is None else results.discover.arms
    verified = {} if results.verify is None else results.verify.arms
    figures = {}
    for name in dict.fromkeys((*calibrated, *verified)):
        held_out = calibrated[name].validate_ if name in calibrated else {}
        best = next((stage for stage in reversed(STAGES) if stage in held_out), None)
        found, pushed = searched.get(name), verified.get(name)
        figures[name] = ArmFigures(
            heldout_mm=_before_after(held_out["geometry"].position_mm, held_out[best].position_mm)
            if best is not None and "geometry" in held_out
            else None,
            best_stage=best,
            verdict=None if found is None else found.verdict,
            effects=() if found is None else tuple(dict.fromkeys(one.effect for one in found.accepted)),
            verified_mm=None if pushed is None else _before_after(pushed.nominal_mm, pushed.compensated_mm),
        )
    return figures


def _before_after(before: ErrorSummary, after: ErrorSummary) -> BeforeAfter:
    return BeforeAfter(before=before.mean, after=after.mean)


DEFAULT_FOLDER = Path("logs")
"""Default folder of new runs, in the working directory."""

LEVELS = 3
"""Most folder levels between a listed folder and a run; trials and campaigns have two."""
_DONE: tuple[LastSession, ...] = get_args(End)


def list_runs(folder: Path | None = None) -> RunsResult:
    """List every run in ``folder`` and below, newest first, without following links. None is ``logs``, which may be
    missing.

    Raises
    ------
    InputError
        If the folder is missing or cannot be read.
    """
    where = DEFAULT_FOLDER if folder is None else folder
    if folder is not None or where.exists():
        check_folder(where)
    runs = [summarise(path) for path in run_folders(where, LEVELS)]
    newest_first = sorted(runs, key=lambda run: (run.began or run.changed, run.run), reverse=True)
    return RunsResult(folder=str(where), runs=tuple(newest_first))


def summarise(folder: Path) -> RunSummary:
    """Summarize the state of one run; if it cannot be read, the summary states the problem."""
    changed, size = _on_disk(folder)
    known = RunSummary(run=str(folder), changed=changed, size_bytes=size, in_use=who_uses(folder))
    try:
        with RunFile.peek(folder) as run:
            return _summary(run, known)
    except CellappError as error:
        problem = str(error)
    except (OSError, ValueError, TypeError) as error:  # a damaged or foreign file may contain anything
        problem = f"{folder / FILE_NAME} holds values that this cellapp cannot read ({_first_words(error)})"
        problem += "; open it with the cellapp that wrote it, or restore it from a copy"
    return known.model_copy(update={"problem": problem})


def check_folder(folder: Path) -> None:
    """Raise ``InputError`` if the folder is missing or cannot be read."""
    try:
        os.scandir(folder).close()
    except FileNotFoundError:
        raise InputError(f"{folder}: folder not found; give a folder that holds runs, such as logs") from None
    except NotADirectoryError:
        raise InputError(f"{folder} is not a folder; give a folder that holds runs, such as logs") from None
    except OSError as error:
        raise InputError(f"{folder} cannot be read ({error.strerror}); check its permissions") from None


def run_folders(folder: Path, levels: int = LEVELS) -> Iterator[Path]:
    """Yield folders of runs in ``folder`` and below; do not follow links, skip what cannot be read."""
    if os.path.lexists(folder / FILE_NAME):
        yield folder
        return
    if levels == 0:
        return
    try:
        with os.scandir(folder) as entries:
            below = sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except OSError:
        return
    for name in below:
        yield from run_folders(folder / name, levels - 1)


# -- inside -----------------------------------------------------------------------------------------------------------


def _on_disk(folder: Path) -> tuple[str, int]:
    """Return when the run file last changed (ISO 8601, UTC), and the total size of the folder's files."""
    changed_s, size = 0.0, 0
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_file(follow_symlinks=False):
                    stat = entry.stat(follow_symlinks=False)
                    size += stat.st_size
                    if entry.name in (FILE_NAME, f"{FILE_NAME}-wal"):
                        changed_s = max(changed_s, stat.st_mtime)
    except OSError:  # removed meanwhile, or not readable: opening it reports that
        pass
    changed = datetime.fromtimestamp(changed_s, UTC).isoformat(timespec="milliseconds") if changed_s else ""
    return changed, size


def _first_words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return str(error).partition("\n")[0] or type(error).__name__


def _summary(run: RunFile, known: RunSummary) -> RunSummary:
    state, sessions = RunState(run, counted=True), run.sessions()
    results, after = state.results, state.next_step
    done, total = run.stops_done(), max(run.planned_counts().values(), default=0)
    reserves = run.profile.plan.reserves(total)
    remaining = sum(stop not in done and stop not in reserves for stop in range(total))
    newest = last_session(sessions)
    last: LastSession | None = None if newest is None else newest.outcome or "no end"
    return RunSummary.like(
        known,
        profile=run.profile.name,
        cell=run.profile.cell_kind,
        began=run.created,
        arms=state.arms,
        stops_planned=total - len(reserves),
        stops_measured=len(done),
        stops_left=remaining,
        sessions=len(sessions),
        last_session=last,
        stages=tuple(
            StageSummary(name=name, written=stage.written, out_of_date=results.out_of_date.get(name))
            for name, stage in state.stages.current.items()
        ),
        figures=run_figures(results),
        next_verb=after.verb,
        next_step=after.short,
        interrupted=last is not None and last not in _DONE and remaining > 0,
    )


FALSE_ALARM = 0.01
"""Largest chance that anything at all is said to have moved in a history where nothing has."""


@dataclass(frozen=True)
class _FoundRun:
    """An arm in one run: who it is, and its calibration, or why there is none to compare."""

    run: RunSummary
    name: str
    identity: StoredIdentity
    calibrated: CalibratedArm | None
    remark: str


def arm_history(arm: str, folder: Path | None = None) -> ArmHistory:
    """Compare every calibration of an arm with its first one.

    All comparisons share the false alarm rate by Bonferroni's inequality, however they depend on each other.

    Parameters
    ----------
    arm : str
        Its serial number or its name in the profiles.
    folder : Path, optional
        Of runs, searched as by ``list_runs``.

    Raises
    ------
    InputError
        If no run has the arm, if several arms have the name, or as ``list_runs``.
    """
    listed = list_runs(folder)
    problems = [run.problem for run in listed.runs if run.problem]
    found = list[_FoundRun]()
    for run in sorted(listed.runs, key=lambda run: (run.began or run.changed, run.run)):
        if not run.problem:
            try:
                found += _arms(run)
            except CellappError as error:
                problems.append(str(error))
    own = _chosen(found, arm, listed.folder)
    calibrated = [one for one in own if one.calibrated is not None]
    compared = {id(one): _differences(calibrated[0], one) for one in calibrated[1:]}
    tests = sum(one.chance is not None for rows in compared.values() for one in rows)
    return ArmHistory(
        folder=listed.folder,
        arm=own[-1].identity.key,
        known_by=own[-1].identity.known_by,
        runs=tuple(
            ArmRun(
                run=one.run.run,
                began=one.run.began or one.run.changed,
                name=one.name,
                figures=one.run.figures.get(one.name, ArmFigures()),
                compared=id(one) in compared,
                remark="first calibration" if one in calibrated[:1] else one.remark,
                moved=_moved(compared.get(id(one), ()), tests),
            )
            for one in own
        ),
        false_alarm=FALSE_ALARM,
        comparisons=tests,
        problems=tuple(problems),
    )


def _arms(run: RunSummary) -> Iterator[_FoundRun]:
    with RunFile.peek(Path(run.run)) as opened:
        stages = RunState(opened, counted=True).stages
        stale = stages.stale_arms()
        arms = {} if stale else comparable_arms(opened, stages)
        missing = stale or ("not calibrated" if stages.in_force is None else "its model has no covariance")
        for name, identity in arm_identities(opened).items():
            yield _FoundRun(run, name, identity, arms.get(name), "" if name in arms else missing)


def _chosen(found: Sequence[_FoundRun], arm: str, folder: str) -> list[_FoundRun]:
    """Return the runs of the one arm that has this serial number, identity or name."""
    own = [one for one in found if arm == one.identity.key] or [one for one in found if arm == one.name]
    keys = dict.fromkeys(one.identity.key for one in own)
    if not own:
        known = ", ".join(map(repr, sorted({one.identity.key for one in found}))) or "none"
        raise InputError(f"runs: no arm '{arm}' is in the runs below {folder}; the arms there are {known}")
    if len(keys) > 1:
        raise InputError(
            f"runs: '{arm}' is not one arm in all runs below {folder}; give one of {', '.join(map(repr, keys))}"
        )
    return own


def _differences(first: _FoundRun, later: _FoundRun) -> list[Difference]:
    assert first.calibrated is not None
    assert later.calibrated is not None
    return differences(first.calibrated, later.calibrated)


def _moved(rows: Sequence[Difference], tests: int) -> tuple[MovedParameter, ...]:
    return tuple(
        MovedParameter.like(one, moved_mm=1e3 * one.moved_m, chance=tests * one.chance)
        for one in rows
        if one.chance is not None and tests * one.chance <= FALSE_ALARM
    )


def run(request: RunsRequest, work: Work) -> RunsResult | ArmHistory:
    """List the runs, or those of one arm."""
    if request.history is not None:
        return arm_history(request.history, request.folder)
    return list_runs(request.folder)
