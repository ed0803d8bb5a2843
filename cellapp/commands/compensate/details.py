"""One target in words, tables and charts: position, predictions, unknown conditions, measurements."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from cellapp.cell.targets.records import MeasuredTarget, TargetCommand, TargetRecord
from cellapp.cell.targets.targets import Target, WorkingConditions
from cellapp.commands.compensate.charts import parts_chart
from cellapp.commands.compensate.target_list import TargetState
from cellapp.commands.compensate.words import advice, shown_tolerance, unknown_lines
from cellapp.commands.run_results import StageResults
from cellapp.commands.view.charts import Chart, enumerated
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.ground.counting import counted

R = TypeVar("R", bound=TargetRecord)
Point = tuple[float, float, float]
_SIDES = {1: "+", -1: "-", 0: ""}


@dataclass(frozen=True, eq=False)
class TargetDetails:
    """Sentences, tables and charts about one target."""

    sentences: tuple[str, ...]
    tables: tuple[Table, ...]
    charts: tuple[Chart, ...]


def target_details(state: TargetState) -> TargetDetails:
    """Return what a run knows about one target; all empty if it knows nothing."""
    sentences: list[str] = []
    for command in state.commands:
        sentences += _command_lines(command)
    sentences += unknown_lines(state.commands)
    for measured in state.measured:
        sentences += _measured_lines(measured)
    sentences += _pair_lines(state)
    charts = [
        parts_chart(f"{command.name}, arm {command.arm}: standard uncertainty of a coordinate", [command.parts])
        for command in state.commands
        if command.parts is not None
    ]
    tables = [table for measured in state.measured for table in _point_tables(measured)]
    return TargetDetails(tuple(sentences), tuple(tables), tuple(charts))


def details_tables(details: TargetDetails) -> list[Table]:
    """Build the tables for a shell, with bar charts as tables."""
    columns = (Column("source"), number_column("standard uncertainty", ".4f", "mm"))
    parts = [
        Table(chart.title, columns, tuple(zip(chart.categories, chart.series[0].y.tolist(), strict=True)))
        for chart in details.charts
        if chart.categories
    ]
    return [*parts, *details.tables]


def stored_state(results: StageResults, name: str) -> TargetState | None:
    """Return the newest results of a run for the target of this name; None if there are none."""
    commands = () if results.compensate is None else _named(results.compensate.targets, name)
    pushed = results.verify or results.push
    measured = () if pushed is None else _named(pushed.targets, name)
    if commands:  # measurements of an earlier target of that name do not count
        measured = tuple(one for one in measured if one.definition == commands[0].definition)
    if not commands and not measured:
        return None
    pairs = () if pushed is None else pushed.pairs
    return TargetState(commands, measured, next((pair for pair in pairs if pair.name == name), None))


def place_lines(target: Target) -> list[str]:
    """State a target as it was written: frame, pose, other arm, tolerance, conditions, preferred sides."""
    lines = [f"{target.name}: arm {target.arm}, {_pose_words(target.position, target.rpy)}, {_frame_words(target)}"]
    if target.partner is not None:
        partner = target.partner
        lines.append(
            f"with arm {partner.arm}: its SMR at {_pose_words(partner.position, partner.rpy)}, seen from the SMR of"
            f" arm {target.arm} along the axes of its flange"
        )
    if target.tolerance_mm is not None:
        lines.append(f"tolerance {shown_tolerance(target.tolerance_mm):g} mm")
    if target.orientation_tolerance_mrad is not None:
        lines.append(f"tolerance of the rotation {shown_tolerance(target.orientation_tolerance_mrad):g} mrad")
    of_arms = [(target.arm, target.conditions)]
    of_arms += [] if target.partner is None else [(target.partner.arm, target.partner.conditions)]
    lines += [f"conditions of arm {arm}: {words}" for arm, stated in of_arms if (words := _condition_words(stated))]
    if target.approach is not None:
        lines.append(f"preferred approach: {side_words(target.approach)}")
    return lines


def side_words(approach: Sequence[int]) -> str:
    """State the joints' last motions: ``joint 1 +, joint 3 -``."""
    joints = [f"joint {number} {_SIDES[sign]}" for number, sign in enumerate(approach, start=1) if sign]
    return ", ".join(joints) or "any side"


# -- inside -----------------------------------------------------------------------------------------------------------


def _named(stored: Sequence[R], name: str) -> tuple[R, ...]:
    return tuple(entry for entry in stored if entry.name == name)


def _command_lines(command: TargetCommand) -> Iterator[str]:
    arm = f"arm {command.arm}"
    if command.refusal:
        what = advice(command.refusal)
        yield f"{arm}: refused: {command.refusal}" + (f"; {what}" if what else "")
        return
    if command.branches is not None:
        count = "the only solution" if command.branches == 1 else f"one of {command.branches} solutions"
        yield f"{arm}: {count} within the joint limits"
    if command.visible is not None:
        yield f"{arm}: the tracker {'sees' if command.visible else 'does not see'} the SMR there"
    if command.residual_um is not None and command.residual_urad is not None:
        residual = f"{command.residual_um:.3f} µm and {command.residual_urad:.3f} µrad"
        yield f"{arm}: the model meets the target within {residual}"
    if command.holds_for:
        yield f"{arm}: the command holds for {command.holds_for}"
    if command.approach is not None:
        chosen = any(one.condition == "approach" for one in command.unknown)
        what = "approach chosen, as on the way from home" if chosen else "made for the approach"
        yield f"{arm}: {what}: {side_words(command.approach)}"
    if command.note:
        yield f"{arm}: {command.note}"
    if command.uncertainty_mm is None:
        yield f"{arm}: the model states no uncertainty"
        return
    within = "" if command.within_mm is None else f"; 95 % of measured errors are within {command.within_mm:.4f} mm"
    yield f"{arm}: standard uncertainty of a coordinate {command.uncertainty_mm:.4f} mm{within}"
    if command.verdict:
        yield f"{arm}: predicted against {shown_tolerance(command.tolerance_mm):g} mm: {command.verdict}"
    if (turn := command.orientation) is not None:
        before = "" if turn.nominal_mrad is None else f"; the nominal command turns it {turn.nominal_mrad:.3f} mrad off"
        yield (
            f"{arm}: standard uncertainty of the flange's rotation about each axis {turn.uncertainty_mrad:.4f} mrad;"
            f" 95 % of measured angles are within {turn.within_mrad:.4f} mrad{before}"
        )
        if turn.verdict:
            limit = shown_tolerance(command.orientation_tolerance_mrad)
            yield f"{arm}: predicted against {limit:g} mrad: {turn.verdict}"


def _measured_lines(measured: MeasuredTarget) -> Iterator[str]:
    arm = f"arm {measured.arm}"
    if measured.note:
        yield f"{arm}: not measured: {measured.note}"
    error = measured.compensated_mm
    if error is None:
        return
    before = "" if measured.nominal_mm is None else f", {measured.nominal_mm:.4f} mm with the nominal command"
    bound = ""
    if measured.within_mm is not None:
        kept = "within" if error <= measured.within_mm else "beyond"
        bound = f"; {kept} the predicted bound of {measured.within_mm:.4f} mm"
    yield f"{arm}: measured {error:.4f} mm from the target{before}{bound}"
    if measured.rounds_mm:
        yield f"{arm}: {_rounds(measured.rounds_mm)}"
    if measured.verdict:
        yield f"{arm}: {measured.verdict} of tolerance" if measured.verdict == "out" else f"{arm}: within tolerance"
    turn = measured.orientation
    if turn is not None and turn.final_mrad is not None:
        before = "" if turn.nominal_mrad is None else f", {turn.nominal_mrad:.4f} mrad with the nominal command"
        judged = "" if not turn.verdict else f"; tolerance {measured.orientation_tolerance_mrad:g} mrad: {turn.verdict}"
        yield f"{arm}: the flange is turned {turn.final_mrad:.4f} mrad from the target{before}{judged}"


def _pair_lines(state: TargetState) -> Iterator[str]:
    pair = state.pair
    if pair is None:
        return
    arms = enumerated(pair.arms)
    if pair.note:
        yield f"arms {arms}: not measured: {pair.note}"
    if (error := pair.final_mm) is None:
        return
    wanted = "" if pair.wanted_mm is None else f" of {pair.wanted_mm:.3f} mm"
    before = "" if pair.nominal_mm is None else f", {pair.nominal_mm:.4f} mm with the nominal commands"
    verdict = {"in": "; within tolerance", "out": "; out of tolerance"}.get(pair.verdict, "")
    yield f"arms {arms}: distance{wanted} off by {error:.4f} mm{before}{verdict}"
    if pair.rounds_mm:
        yield f"arms {arms}: {_rounds(pair.rounds_mm)}"


def _rounds(rounds_mm: Sequence[float]) -> str:
    if len(rounds_mm) == 1:
        return "nothing was left to correct: noise explains the error"
    return f"by the model alone and after each correction: {' -> '.join(f'{mm:.4f}' for mm in rounds_mm)} mm"


def _point_tables(measured: MeasuredTarget) -> Iterator[Table]:
    """Yield a table of wanted, predicted and measured SMR and their differences; none if they were not stored."""
    if measured.wanted_M is None or measured.measured_M is None:
        return
    columns = (
        Column(f"arm {measured.arm}, tracker frame"),
        *(number_column(axis, ".4f", "mm") for axis in "xyz"),
        number_column("length", ".4f", "mm"),
    )
    rows: list[tuple[Cell, ...]] = [("wanted", *_mm(measured.wanted_M), None)]
    if measured.predicted_M is not None:
        rows.append(("predicted", *_mm(measured.predicted_M), None))
    rows.append(("measured", *_mm(measured.measured_M), None))
    rows.append(_difference("measured - wanted", measured.measured_M, measured.wanted_M))
    if measured.predicted_M is not None:
        rows.append(_difference("measured - predicted", measured.measured_M, measured.predicted_M))
    yield Table(f"{measured.name}: predicted and measured", columns, tuple(rows))


def _mm(point: Point) -> tuple[float, ...]:
    return tuple(round(value * 1e3, 6) + 0.0 for value in point)  # no -0.0


def _difference(name: str, last: Point, first: Point) -> tuple[Cell, ...]:
    off = [(b - a) * 1e3 for a, b in zip(first, last, strict=True)]
    return (name, *off, math.hypot(*off))


def _pose_words(position: Point, rpy: Point | None) -> str:
    x, y, z = (f"{value * 1e3:.3f}" for value in position)
    if rpy is None:
        return f"x {x}, y {y}, z {z} mm, any rotation"
    roll, pitch, yaw = (f"{math.degrees(angle):.3f}" for angle in rpy)
    return f"x {x}, y {y}, z {z} mm, roll {roll}, pitch {pitch}, yaw {yaw} deg"


def _frame_words(target: Target) -> str:
    frame = target.work_frame
    if frame is not None:
        from cellapp.cell.targets.goals import work_frame_pose  # loads scipy: only for a work frame

        rms_mm = work_frame_pose(frame)[1] * 1e3
        parent = "the tracker frame" if frame.parent == "tracker" else f"the base of arm {frame.parent}"
        return (
            f"in work frame {frame.name}: {counted(len(frame.points), 'point')} measured in {parent}, {rms_mm:.3f}"
            " mm rms"
        )
    if target.frame == "tracker":
        return "in the tracker frame"
    return f"in the base of arm {target.arm if target.frame == 'base' else target.frame}"


def _condition_words(stated: WorkingConditions) -> str:
    words = []
    if stated.payload is not None:
        words.append(f"payload {stated.payload:g} kg")
    if stated.temperature is not None:
        words.append(f"{stated.temperature:g} degC")
    if stated.time is not None:
        words.append(f"{stated.time:g} s since the run began")
    if stated.dwell is not None:
        words.append(f"{stated.dwell:g} s of rest")
    return ", ".join(words)
