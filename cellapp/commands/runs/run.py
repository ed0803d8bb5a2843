"""The verb ``runs``: list a folder of runs, or one arm over them. It only reads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cellapp.cell.run.arm_identity import ArmIdentity, arm_identities
from cellapp.cell.run.file import RunFile
from cellapp.commands.record import Work
from cellapp.commands.runs import history
from cellapp.commands.runs.history import list_runs
from cellapp.commands.runs.request import RunsRequest
from cellapp.commands.runs.result import ArmFigures, ArmHistory, ArmRun, MovedParameter, RunsResult, RunSummary
from cellapp.commands.stages import counted_basis, read_stages
from cellapp.commands.stored_model import comparable_arms
from cellapp.estimation.monitoring.moved import CalibratedArm, Difference, differences
from cellapp.ground.errors import CellappError, InputError

FALSE_ALARM = 0.01
"""Largest chance that anything at all is said to have moved in a history where nothing has."""


@dataclass(frozen=True)
class _Found:
    """An arm in one run: who it is, and its calibration, or why there is none to compare."""

    run: RunSummary
    name: str
    identity: ArmIdentity
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
    found = list[_Found]()
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


def _arms(run: RunSummary) -> Iterator[_Found]:
    with RunFile.peek(Path(run.run)) as opened:
        stages = read_stages(opened, counted_basis)
        stale = stages.stale_arms()
        arms = {} if stale else comparable_arms(opened, stages)
        missing = stale or ("not calibrated" if stages.in_force is None else "its model has no covariance")
        for name, identity in arm_identities(opened).items():
            yield _Found(run, name, identity, arms.get(name), "" if name in arms else missing)


def _chosen(found: Sequence[_Found], arm: str, folder: str) -> list[_Found]:
    """Return the runs of the one arm that has this serial number, identity or name."""
    own = [one for one in found if arm == one.identity.key] or [one for one in found if arm == one.name]
    keys = dict.fromkeys(one.identity.key for one in own)
    if not own:
        known = ", ".join(sorted({one.identity.key for one in found})) or "none"
        raise InputError(f"runs: no arm '{arm}' is in the runs below {folder}; the arms there are {known}")
    if len(keys) > 1:
        raise InputError(
            f"runs: '{arm}' is not one arm in all runs below {folder}; give one of {', '.join(map(repr, keys))}"
        )
    return own


def _differences(first: _Found, later: _Found) -> list[Difference]:
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
    return history.list_runs(request.folder)
