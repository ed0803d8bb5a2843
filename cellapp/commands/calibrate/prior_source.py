"""The earlier run whose calibration serves as prior: reading it, checking it, and turning it into beliefs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np

from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.commands.stages import PriorBasis, StoredStage, earlier_digest, read_stages
from cellapp.commands.stored_model import arms_stage, model_of
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.calibration.records import ArmPriorResult, CalibrateResult
from cellapp.estimation.prior.belief import Belief
from cellapp.estimation.prior.calibrate import Earlier, believed
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, ModelStage, day_of
from cellapp.ground.shell import shell_word
from cellapp.robot.model.nominal import nominal_arm

_MOST_EARLIER = 20
"""Most earlier runs in a row that are followed; more would be a cycle."""


def earlier_arms(run: RunFile, folder: Path) -> dict[str, Earlier]:
    """Return the earlier calibration in ``folder`` of every arm of ``run`` that it contains.

    Raises
    ------
    InputError
        If ``folder`` is no run, is this run, is not calibrated or out of date, or holds no arm of this run; or if an
        arm is of another type or has another controller there.
    """
    if folder.is_file():
        raise InputError(
            f"--prior {folder}: a file does not hold how certain all values are; give the folder of the earlier run"
        )
    if folder.resolve() == run.folder.resolve():
        raise InputError(f"--prior {folder}: this is the same run; give the folder of an earlier one")
    with RunFile.open(folder) as earlier:
        stages = read_stages(earlier)
        stage = arms_stage(earlier, stages)
        if stale := stages.outdated_arms():  # an arm that changed since is no reason: a prior is for that
            raise InputError(f"--prior {folder}: {stale}; run '{stages.next_step(folder)}' first")
        if all(_same_readings(run, earlier, name) for name in run.profile.arms):
            raise InputError(f"--prior {folder}: it holds the same readings as {run.folder}; they would count twice")
        names = [name for name in run.profile.arms if name in earlier.profile.arms]
        if not names:
            raise InputError(
                f"--prior {folder}: it has the arms {', '.join(earlier.profile.arms)}, this run has"
                f" {', '.join(run.profile.arms)}"
            )
        notes = {name: _same_arm(run, earlier, name) for name in names}
        return {name: _earlier(earlier, stage, name, notes[name]) for name in names}


def _same_readings(run: RunFile, earlier: RunFile, name: str) -> bool:
    if name not in earlier.profile.arms:
        return False
    now, then = run.readings(name), earlier.readings(name)
    return len(now) == len(then) > 0 and bool(np.array_equal(now.p_M, then.p_M) and np.array_equal(now.q, then.q))


def _same_arm(run: RunFile, earlier: RunFile, name: str) -> tuple[str, ...]:
    """Check that an arm is the same in both runs; return notes. Raises ``InputError`` if it is another arm."""
    here, there = run.profile.arms[name].type, earlier.profile.arms[name].type
    where = f"--prior {earlier.folder}: arm '{name}'"
    if here.model != there.model:
        raise InputError(f"{where} is a {there.model} there and a {here.model} here; give the same arm's earlier run")
    rows, its = (nominal_arm(one.profile.arms[name]).rows for one in (run, earlier))
    if not np.array_equal(rows, its):
        raise InputError(f"{where} has another nominal D-H table there; use the same arm file for both runs")
    now, then = recorded_controllers(run).get(name), recorded_controllers(earlier).get(name)
    if now is None or then is None:
        return (
            f"arm '{name}': not both runs know its controller; that {earlier.folder} is of the same arm is taken from"
            " you",
        )
    for what, a, b in (("model", then.model, now.model), ("serial number", then.serial, now.serial)):
        if a and b and a != b:
            raise InputError(f"{where} has another controller: {what} {a} there, {b} here. Its calibration is not used")
    if then.dh_checksum != now.dh_checksum:
        return (f"arm '{name}': the controller's own D-H calibration was changed since {earlier.folder}",)
    return ()


def _earlier(run: RunFile, stage: StoredStage, name: str, notes: tuple[str, ...]) -> Earlier:
    belief, count = _believed(run, stage, name, 0)
    kept = {term.slug for term in belief.terms}
    controller = recorded_controllers(run).get(name)
    return Earlier(
        belief=belief,
        run=run.folder.resolve(),
        stage=cast(ModelStage, stage.name),
        digest=earlier_digest(run, name),
        since=day_of(run.created or stage.written),
        readings=count,
        controller=None if controller is None else controller.serial or None,
        left_behind=tuple(
            dict.fromkeys(term.slug for term in model_of(run, stage).arms[name].effects if term.slug not in kept)
        ),
        notes=notes,
    )


def _believed(run: RunFile, stage: StoredStage, name: str, depth: int) -> tuple[Belief, int]:
    """Return a run's belief about an arm, including its own earlier priors, and the number of readings."""
    readings = {arm: run.readings(arm) for arm in run.profile.arms}
    arm = ArmReadings.of_cell(run.profile, model_of(run, stage).arms, readings)[name]
    record = recorded_priors(run).get(name)
    if record is None:
        return believed(arm)
    if depth >= _MOST_EARLIER:
        raise InputError(f"{run.folder}: more than {_MOST_EARLIER} earlier runs in a row")
    with open_recorded(run, record) as earlier:
        before, _ = _believed(earlier, arms_stage(earlier, read_stages(earlier)), name, depth + 1)
    return believed(arm, before, record.since)


def open_recorded(run: RunFile, record: ArmPriorResult) -> RunFile:
    """Open the earlier run that a calibration names. Raises ``InputError`` if it no longer exists."""
    try:
        return RunFile.open(Path(record.run))
    except InputError as error:
        raise InputError(
            f"{run.folder} was calibrated with {record.run} as prior, which cannot be read ({error}); put it back,"
            " or calibrate again with --prior"
        ) from None


def basis_of_priors(earlier: Mapping[str, Earlier]) -> dict[str, PriorBasis]:
    """Return the runs outside its own that a stage rests on, by arm."""
    return {name: PriorBasis(run=str(its.run), sha256=its.digest) for name, its in earlier.items()}


def earlier_of_calibration(run: RunFile) -> dict[str, Earlier]:
    """Return the earlier calibrations that the calibration of a run used; empty if it used none.

    Raises
    ------
    InputError
        If the earlier run no longer exists, or has changed since.
    """
    records = recorded_priors(run)
    if not records:
        return {}
    folder = Path(next(iter(records.values())).run)
    with open_recorded(run, next(iter(records.values()))):
        found = earlier_arms(run, folder)
    changed = [name for name, record in records.items() if name not in found or found[name].digest != record.sha256]
    if changed:
        raise InputError(
            f"{run.path}: the earlier calibration {folder} has changed since; run 'cellapp calibrate"
            f" {shell_word(run.folder)}"
            f" --prior {shell_word(folder)}' again"
        )
    return {name: found[name] for name in records}


def recorded_priors(run: RunFile) -> dict[str, ArmPriorResult]:
    """Return the record of the prior of every arm that used one."""
    stage = read_stages(run).current.get(CALIBRATE)
    if stage is None:
        return {}
    arms = CalibrateResult.from_json(stage.text, f"{run.path}: {CALIBRATE}").arms
    return {name: prior for name in run.profile.arms if name in arms and (prior := arms[name].prior) is not None}
