"""Targets with what a run knows about each: the table of the screen Targets, and one target in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cellapp.cell.targets.records import MeasuredPair, MeasuredTarget, TargetCommand
from cellapp.cell.targets.targets import Target, definition
from cellapp.commands.compensate.words import Measured, arms_words, shown_tolerance
from cellapp.commands.run_results import RunResults
from cellapp.commands.view.table import Cell, Table, table_of_cells
from cellapp.ground.grouping import grouped

_COLUMNS: tuple[str | tuple[str, ...], ...] = (
    *("target", "arm", ("tol.", "g", "mm"), "state", "error [mm]", "frame"),
    *(("95 %", ".3f", "mm"), ("uncertainty", ".4f", "mm"), ("rounds", "d")),
    *((axis, ".1f", "mm") for axis in ("x", "y", "z")),
    *((angle, ".2f", "°") for angle in ("roll", "pitch", "yaw")),
)
_MEASURED_WORDS = {
    "in": "within tolerance, by its uncertainty",
    "out": "out of tolerance, by its uncertainty",
    "not decided": "not decided: nearer to its tolerance than its uncertainty",
}
COLUMN_GROUPS = (5, 6, 7, 9, 12, 15)
"""Numbers of columns that a narrow screen can show without splitting a position or a rotation."""


@dataclass(frozen=True)
class TargetState:
    """What a run currently knows about one target.

    Attributes
    ----------
    commands, measured : tuple
        One for each arm at the target; empty if nothing was computed or driven.
    pair : MeasuredPair or None
        What was measured between both arms of a cooperative target; None if nothing.
    """

    commands: tuple[TargetCommand, ...] = ()
    measured: tuple[MeasuredTarget, ...] = ()
    pair: MeasuredPair | None = None

    @property
    def refusals(self) -> list[str]:
        """Why the target is not commanded; with the arm's name if it has two arms."""
        several = len(self.commands) > 1
        return [
            f"{command.arm}: {command.refusal}" if several else command.refusal
            for command in self.commands
            if command.refusal
        ]

    @property
    def notes(self) -> list[str]:
        """Why the target was not measured."""
        notes = [one.note for one in self.measured] + ([] if self.pair is None else [self.pair.note])
        return list(dict.fromkeys(filter(None, notes)))

    @property
    def verdict(self) -> str:
        """The worst verdict on the measurements; without any, on the predictions."""
        judged: list[Measured] = [*self.measured, *([] if self.pair is None else [self.pair])]
        words = [verdict for one in judged for verdict in (one.verdict, getattr(one.orientation, "verdict", ""))]
        if self.pair is not None and self.pair.relative is not None:
            words.append(self.pair.relative.position_verdict)
        if not any(words):
            for one in self.commands:
                words += [one.verdict, getattr(one.orientation, "verdict", "")]
                words += [] if one.relative is None else [one.relative.verdict, one.relative.turn_verdict]
        return next((word for word in ("out", "not decided", "in") if word in words), "")

    @property
    def is_measured(self) -> bool:
        """Whether an error was measured."""
        return any(one.compensated_mm is not None for one in self.measured)

    @property
    def needs_attention(self) -> bool:
        """Whether it is refused, not measured, out of tolerance or undecided."""
        return bool(self.refusals or self.notes) or self.verdict in ("out", "not decided")


def stored_state(results: RunResults, name: str) -> TargetState | None:
    """Return the newest results of a run for the target of this name as it was compensated; None if it was not."""
    known = () if results.compensate is None else results.compensate.targets
    command = next((one for one in known if one.name == name), None)
    return None if command is None else _states([(name, command.definition)], results)[0]


def target_state(target: Target, results: RunResults | None) -> TargetState:
    """Return what the run knows about one target."""
    return target_states((target,), results)[0]


def target_states(targets: Sequence[Target], results: RunResults | None) -> list[TargetState]:
    """Return what the run knows about each target; a result counts only if the target has not changed since."""
    keys = [(target.name, definition(target)) for target in targets]
    return [TargetState()] * len(targets) if results is None else _states(keys, results)


def _states(targets: Sequence[tuple[str, str]], results: RunResults) -> list[TargetState]:
    """Return what is known about targets of these names and definitions.

    Of measurements and motions the last measurement counts; without one, the last motion.
    """
    known = () if results.compensate is None else results.compensate.targets
    commands = grouped(((one.name, one.definition), one) for one in known)
    pushes = [
        (grouped(((one.name, one.definition), one) for one in pushed.targets), {one.name: one for one in pushed.pairs})
        for pushed in (results.verify, results.push)
        if pushed is not None
    ]
    states = []
    for target in targets:
        measured, pairs = next((one for one in pushes if target in one[0]), ({}, {}))
        found = tuple(measured.get(target, ()))
        pair = pairs.get(target[0]) if found else None
        states.append(TargetState(tuple(commands.get(target, ())), found, pair))
    return states


def target_list(targets: Sequence[Target], results: RunResults | None) -> Table:
    """Show each target with its state."""
    return table_of_cells("Targets", map(_row, targets, target_states(targets, results)), *_COLUMNS)


def target_words(target: Target, results: RunResults | None) -> str:
    """State what the run knows about one target, and its position."""
    x, y, z = (f"{value * 1e3:z.1f}" for value in target.position)
    rotation = "any rotation"
    if target.rpy is not None:
        rotation = "roll {:z.2f}, pitch {:z.2f}, yaw {:z.2f} deg".format(*(math.degrees(angle) for angle in target.rpy))
    frame = "" if target.frame == "base" else f" in frame {target.frame}"
    state = _state_words(target, target_state(target, results))
    return f"{target.name}: {state}.\nx {x}, y {y}, z {z} mm{frame}; {rotation}"


def _state_words(target: Target, state: TargetState) -> str:
    if not state.commands and not state.measured:
        return "not compensated yet as it is now"
    words = []
    if state.refusals:
        words.append(f"refused: {'; '.join(state.refusals)}")
    elif state.commands:
        words.append(f"compensated; {_uncertainty_words(state.commands)}")
    predicted = TargetState(state.commands).verdict
    if predicted:
        limits = [
            f"{shown_tolerance(limit):g} {unit}"
            for limit, unit in ((target.tolerance_mm, "mm"), (target.orientation_tolerance_mrad, "mrad"))
            if limit is not None
        ]
        words.append(f"tolerance {' and '.join(limits)} predicted: {predicted}")
    several = len(state.measured) > 1
    for one in state.measured:
        if (mm := one.final_mm) is not None:
            arm = f"arm {one.arm} " if several else ""
            before = "" if one.nominal_mm is None else f", {one.nominal_mm:.4f} mm without compensation"
            words.append(f"{arm}measured {mm:.4f} mm from the target{before}{_rounds_words(one)}")
    if state.pair is not None and (mm := state.pair.final_mm) is not None:
        words.append(f"distance of both SMRs off by {mm:.4f} mm{_rounds_words(state.pair)}")
    if state.pair is not None and (seen := state.pair.relative) is not None:
        rotation = "" if seen.final_mrad is None else f" and {seen.final_mrad:.4f} mrad"
        words.append(f"partner seen from the first flange off by {seen.final_mm:.4f} mm{rotation}")
    if state.is_measured and state.verdict:
        words.append(_MEASURED_WORDS[state.verdict])
    return "; ".join([*words, *(note for note in state.notes if not state.refusals)])


def _uncertainty_words(commands: Iterable[TargetCommand]) -> str:
    known = [one.uncertainty_mm for one in commands if one.uncertainty_mm is not None]
    if not known:
        return "the model states no uncertainty"
    bounds = [one.within_mm for one in commands if one.within_mm is not None]
    within = f", 95 % of errors within {max(bounds):.4f} mm" if bounds else ""
    return f"standard uncertainty of a coordinate {max(known):.4f} mm{within}"


def _rounds_words(one: Measured) -> str:
    """State the error by the model alone, if the target was corrected by measuring."""
    rounds = len(one.rounds_mm) - 1
    return "" if rounds < 1 else f" ({one.compensated_mm:.4f} mm by the model alone, {rounds} corrected)"


def _row(target: Target, state: TargetState) -> tuple[Cell, ...]:
    degrees = (None, None, None) if target.rpy is None else [math.degrees(angle) for angle in target.rpy]
    bounds = [one.within_mm for one in state.commands if one.within_mm is not None]
    known = [one.uncertainty_mm for one in state.commands if one.uncertainty_mm is not None]
    return (
        target.name,
        arms_words(target.arms),
        shown_tolerance(target.tolerance_mm),
        _short_state(state),
        _errors(state),
        target.frame,
        max(bounds, default=None),
        max(known, default=None),
        max((len(one.rounds_mm) - 1 for one in state.measured if one.rounds_mm), default=None),
        *(value * 1e3 for value in target.position),
        *degrees,
    )


def _errors(state: TargetState) -> str:
    """State the error before and after: of the SMR distance at a cooperative target, else the largest of its arms."""
    shown: list[Measured] = [one for one in state.measured if one.compensated_mm is not None]
    if state.pair is not None and state.pair.compensated_mm is not None:
        shown = [state.pair]
    if not shown:
        return ""
    worst = max(shown, key=lambda one: one.final_mm or 0.0)
    before = "" if worst.nominal_mm is None else f"{worst.nominal_mm:.3f} -> "
    return f"{before}{worst.final_mm:.3f}"


def _short_state(state: TargetState) -> str:
    """Return the verdict, or why there is none."""
    if state.refusals:
        return "; ".join(state.refusals)
    if state.measured:
        if state.notes:
            return "; ".join(state.notes)
        if state.verdict and (state.is_measured or not state.commands):
            return f"{state.verdict}, measured"
    if state.commands and state.verdict and not state.is_measured:
        return f"{state.verdict}, predicted"
    if state.measured:
        return "measured" if state.is_measured else "reached"
    return "compensated" if state.commands else ""
