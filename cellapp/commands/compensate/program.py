"""Of the verb ``compensate``: correct the targets of a controller's program so that the real arm reaches them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellapp.cell.driving.cell_checks import same_calibration
from cellapp.cell.exports.command_table import JOINTS
from cellapp.cell.programs.records import CorrectedTarget, CorrectResult, ReadProgram
from cellapp.cell.programs.script_targets import LARGEST, read_script, read_urp, six
from cellapp.cell.programs.solving import (
    Workplace,
    assumptions,
    controller_chain,
    correct_lines,
    gate_findings,
    judged,
    meant_flange,
    model_notes,
    refusal,
    rewritten,
    solve_targets,
)
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.commands.compensate.earlier_commands import refuse_corrected
from cellapp.commands.compensate.request import CompensateRequest, program_kind
from cellapp.commands.record import View, six_numbers
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, notes_on, require_own_factory, stage_in_force
from cellapp.commands.view.table import Cell, Table, table_of_cells, with_rows
from cellapp.estimation.uncertainty.records import Six
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import readable
from cellapp.ground.outputs import CORRECTED, NEW_ONLY, Outputs, require_suffix, write_new_bytes
from cellapp.ground.profile import Arm
from cellapp.ground.shell import shell_word
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import controller_rows, nominal_arm, published_rows

_MARKS = {".script": f"# {CORRECTED}", ".urp": f"<!-- {CORRECTED} -->"}
"""Last line of a copy."""


def correct(run: RunFile, request: CompensateRequest, outputs: Outputs = NEW_ONLY) -> CorrectResult:
    """Write a copy of a program with targets that a plain controller truly reaches.

    Nothing is written if a target cannot be corrected: the result lists such targets, and its ``out`` is None.

    Raises
    ------
    InputError
        If the program cannot be read, the run is not calibrated or has no such arm, or the copy cannot be written.
    """
    program, out = request.program, request.out
    assert program is not None, "the caller says so"
    assert out is not None, "the request says so"
    stages = read_stages(run)
    require_own_factory(run, "compensate")
    model = model_of(run, stage_in_force(run, stages))
    name = _arm(run, list(model.arms), request.arm)
    model_arm = model.arms[name]
    settings = run.profile.arms[name]
    _require_its_calibration(run, name, model_arm)
    read = _read(program, out, settings, None if request.tcp is None else typed_tcp(request.tcp))
    if CORRECTED in read.text:
        raise InputError(
            f"{program} is a corrected copy, of which no second one is made: it would be off by the correction. Correct"
            " the program that was taught"
        )
    if not read.targets and not read.left:
        raise InputError(f"{program}: no motion with a target found; nothing was written")
    chain = controller_chain(model_arm)
    meant = np.array([meant_flange(chain, one) for one in read.targets]).reshape(-1, 4, 4)
    words = [f"{program}:{one.line}: the target" for one in read.targets]
    refuse_corrected(run, name, chain, words, meant[:, :3, :3], meant[:, :3, 3])
    limits = np.array(settings.joint_limits)
    home = None if settings.home is None else np.array(settings.home)
    q = known_readings(run, name).q
    place = Workplace(model_arm, limits, home, q, run.profile.seed, read.payload_kg, request.extrapolate)
    corrected, common = judged(place, read.targets, solve_targets(place, read.targets), every=request.insignificant)
    result = CorrectResult(
        program=str(program),
        out=str(out),
        arm=name,
        targets=tuple(corrected),
        left=tuple(read.left),
        assumptions=tuple(assumptions(place, settings, read, corrected)),
        notes=(
            *notes_on(stages.stale_arms()),
            *model_notes(model_arm),
            *read.notes,
            *gate_findings(run.profile, model, name, corrected),
            *([] if model_arm.posterior is not None else [_no_sigma(run)]),
        ),
        common=tuple(common),
    )
    if result.refused and not request.partly:
        return result.model_copy(update={"out": None})
    written = rewritten(read.text, read.targets, corrected).rstrip("\n")
    write_new_bytes({out: read.encode(f"{written}\n{_MARKS[out.suffix.lower()]}\n")}, outputs)
    return result


def typed_tcp(text: str) -> Six:
    """Parse a TCP that a person typed: ``x,y,z,rx,ry,rz``. Raises ``InputError``."""
    tcp = six(six_numbers("--tcp", text, "x,y,z,rx,ry,rz in m and rad, as 0,0,0.12,0,0,0"))
    if np.abs(tcp[:3]).max() > 5.0:
        raise InputError(f"--tcp {text}: a TCP more than 5 m from the flange; positions are in metres")
    return tcp


# -- inside -----------------------------------------------------------------------------------------------------------


def _no_sigma(run: RunFile) -> str:
    command = f"'cellapp discover {shell_word(run.folder)}'"
    return f"sigma is not stated: only a discovery estimates the uncertainty of the model; {command} makes one"


def _arm(run: RunFile, arms: Sequence[str], asked: str | None) -> str:
    if asked is None and len(arms) > 1:
        choice = " or ".join(f"--arm {name}" for name in arms)
        raise InputError(f"compensate: {run.path} has several arms; say whose program it is: {choice}")
    name = arms[0] if asked is None else asked
    if name not in arms:
        raise InputError(f"compensate: {run.path} has no calibrated arm '{name}'; arms are {', '.join(arms)}")
    joints = len(run.profile.arms[name].type.joints)
    if joints != JOINTS:
        raise InputError(f"compensate: arm '{name}' has {joints} joints; programs of UR controllers have {JOINTS}")
    return name


def _require_its_calibration(run: RunFile, name: str, model: ArmModel) -> None:
    """Raise ``InputError`` unless the run's controller uses the nominal D-H rows of the profile."""
    settings, controller = run.profile.arms[name], recorded_controllers(run).get(name)
    if not np.allclose(model.nominal.rows, nominal_arm(settings).rows, rtol=0.0, atol=1e-9):
        raise InputError(
            f"compensate: arm '{name}': arms.{name}.factory is not that of the calibration; calibrate again"
        )
    if controller is not None and not same_calibration(settings, controller):
        raise InputError(
            f"compensate: arm '{name}': the controller of this run computes with another calibration"
            f" ({controller.dh_checksum or 'none'}) than the profile; nothing was written. Write it with 'cellapp"
            f" doctor PROFILE --controllers FOLDER', give it as arms.{name}.factory, and calibrate the readings anew"
        )


def _read(program: Path, out: Path, settings: Arm, tcp: Six | None) -> ReadProgram:
    kind = program_kind(program)
    require_suffix(out, (kind,), f"compensate: a copy of {program}")
    with readable(program, "give a program, .script or .urp"), program.open("rb") as file:
        data = file.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise InputError(f"{program}: larger than {LARGEST // 2**20} MB; no program is")
    if kind == ".script":
        return read_script(data, str(program), tcp)
    return read_urp(data, str(program), controller_rows(settings), published_rows(settings))


def program_view(result: CorrectResult) -> View:
    """Show every target, the assumptions, and what could not be corrected."""
    return View((*with_rows(correct_table(result)), *correct_lines(result)), refused=refusal(result))


def correct_table(result: CorrectResult) -> Table:
    """Show each target's old and new numbers in two rows, with size and uncertainty of the correction.

    Below the motion stands the configuration nearest to its solution.
    """
    rows = (row for target in result.targets for row in _rows(target))
    sizes = ("moves", ".3f", "mm"), ("turns", ".3f", "mrad"), ("sigma", ".3f", "mm")
    return table_of_cells(f"Targets of {result.program}", rows, "line", "motion", "target (m, rad)", *sizes)


def _rows(target: CorrectedTarget) -> list[tuple[Cell, ...]]:
    old: tuple[Cell, ...] = (str(target.line), target.command, _numbers(target.old), None, None, None)
    if target.new is None:
        return [old, ("", "", "not corrected, see below", None, None, None)]
    sizes = (target.correction_mm, target.correction_mrad, target.own_mm)
    if target.significant is False:
        return [old, ("", target.nearest_to, "left as taught: not significant", *sizes)]
    return [old, ("", target.nearest_to, _numbers(target.new), *sizes)]


def _numbers(values: Sequence[float]) -> str:
    return ",".join(f"{value:.3f}" for value in values)  # without spaces: a narrow terminal would break lines there
