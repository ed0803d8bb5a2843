"""Targets in words: compensated, refused, measured; unknown conditions, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.targets.records import CompensateResult, MeasuredPair, MeasuredTarget, TargetCommand, VerifyResult
from cellapp.commands.view.words import RULE_WORDS, undecided_words
from cellapp.ground.counting import counted, first_few
from cellapp.ground.grouping import grouped

PART_WORDS: Mapping[str, str] = {
    "parameters": "geometry",
    "effects": "effects",
    "network": "network",
    "extrapolation": "extrapolation",
    "noise": "noise",
    "conditions": "conditions",
}
"""Column headings of the parts of an uncertainty."""
_MOST_NOTES = 20
"""Most notes on single targets that are printed; the JSON has all."""
Measured = MeasuredTarget | MeasuredPair
"""A measured target of one arm, or of two."""
_ADVICE: Mapping[str, str] = {
    "temperature": "state conditions: {temperature: ...} of the target, or measure again at its temperature",
    "payload": "state conditions: {payload: ...} of the target, or the payload of the arm in the profile",
    "time": "calibrate again shortly before the work, or state conditions: {time: ...} within that of the readings",
    "dwell": "state conditions: {dwell: ...} of the target: how long the arm rests before it works",
    "approach": "drive so, or state a side: approach: [1, 0, ...] of the target, one sign for each joint",
    "with any rotation": "move the target nearer to the arm",
    "out of reach": "move the target nearer to the arm, or leave its rotation free",
    "beyond limits": "rotate the target about the tool's axis, or leave its rotation free",
    "singular": "rotate or move the target a little, or leave its rotation free",
    "collide": "move or turn the target; bodies and obstacles are those of the profile",
    "asked": "move or turn the target; clearance, bodies and obstacles are those of the profile",
}
"""What to do, by a word in the condition or the reason."""


@dataclass(frozen=True)
class NotStated:
    """An unstated condition over all targets: largest displacement [mm], where, and number of targets."""

    condition: str
    effects: tuple[str, ...]
    mm: float
    worst: str
    targets: int


def advice(reason: str) -> str:
    """Say what to do about an unknown condition or a refusal; empty if its text says that itself."""
    return next((text for word, text in _ADVICE.items() if word in reason), "")


def shown_tolerance(tolerance_mm: float | None) -> float | None:
    """Return a tolerance without rounding errors of the conversion from metres."""
    return None if tolerance_mm is None else round(tolerance_mm, 6)


def arms_words(arms: Iterable[str]) -> str:
    """Return the names of a target's arms, joined by a plus sign."""
    return " + ".join(dict.fromkeys(arms))


def unknown_conditions(targets: Sequence[TargetCommand]) -> list[NotStated]:
    """Summarize the unstated conditions, the most important first."""
    found = grouped((one.condition, (one.mm, target.name, one.effects)) for target in targets for one in target.unknown)
    summaries = []
    for condition, entries in found.items():
        mm, worst, _ = max(entries, key=lambda entry: entry[0])
        effects = tuple(dict.fromkeys(effect for _, _, effects in entries for effect in effects))
        summaries.append(NotStated(condition, effects, mm, worst, len({name for _, name, _ in entries})))
    return sorted(summaries, key=lambda one: -one.mm)


# -- compensate -------------------------------------------------------------------------------------------------------


def compensate_lines(result: CompensateResult) -> list[str]:
    """Return the lines that ``compensate`` prints: the summary, unknown conditions, refusals, notes."""
    lines = [*unknown_lines(result.targets), *note_lines(result.targets), *refusal_lines(result), *result.notes]
    return [*compensate_summary(result), *common_words(result), *dict.fromkeys(lines)]


def compensate_summary(result: CompensateResult) -> list[str]:
    """State how many targets can be commanded and are predicted in or out, the largest bound, what is not seen."""
    return [_count_words(result), *_prediction_words(result), *_bound_words(result), *_unseen_words(result)]


def refusal_lines(result: CompensateResult) -> list[str]:
    """Say why targets cannot be commanded and what to do, one line each."""
    lines = []
    for target in result.targets:
        if target.refusal:
            arm = f", arm {target.arm}" if target.partner else ""
            what = advice(target.refusal)
            lines.append(f"target {target.name}{arm}: {target.refusal}" + (f"; {what}" if what else ""))
    return lines


def note_lines(targets: Sequence[TargetCommand]) -> list[str]:
    """Return the notes on commands that are not refused; only the first of many."""
    lines = [f"target {target.name}, arm {target.arm}: {target.note}" for target in targets if target.note]
    return first_few(lines, f"and {counted(len(lines) - _MOST_NOTES, 'more note')} on targets", _MOST_NOTES)


def unknown_lines(targets: Sequence[TargetCommand]) -> list[str]:
    """State each unknown condition, by how much it moves the SMR, and what to do."""
    lines = []
    for one in unknown_conditions(targets):
        where = "" if one.targets == 1 else f", the most of {one.targets} targets"
        what = advice(one.condition)
        taken = ", or beyond the readings:" if one.condition == "time" else ":"
        if one.condition == "approach":
            taken = ": commands are for the side that stands beside each (approach); with another side"
        lines.append(
            f"{one.condition} is not stated{taken} {', '.join(one.effects)} may move the SMR by {one.mm:.3f} mm"
            f" at {one.worst}{where}" + (f"; {what}" if what else "")
        )
    return lines


def _count_words(result: CompensateResult) -> str:
    commands = grouped((command.name, command) for command in result.targets)
    refused = sum(any(command.refusal for command in of_target) for of_target in commands.values())
    pairs = sum(len(of_target) > 1 for of_target in commands.values())
    cooperative = f", {pairs} of them cooperative" if pairs else ""
    return f"{len(commands) - refused} of {counted(len(commands), 'target')} compensated{cooperative}" + (
        f", {refused} refused" if refused else ""
    )


def _prediction_words(result: CompensateResult) -> list[str]:
    """State how many targets are predicted in and out, by their position and by their rotation."""
    positions = [(one.verdict, one.name) for one in result.targets if one.verdict]
    rotations = [(its.verdict, one.name) for one in result.targets if (its := one.orientation) and its.verdict]
    rule = "in if the 95 % bound is inside the tolerance, out if the SMR is outside with 95 % probability"
    lines = []
    for of, judged, why in (
        ("", positions, f" ({rule}, else not decided: ISO 14253-1)"),
        (" of orientation", rotations, ""),
    ):
        if judged:
            counts = [
                f"{sum(verdict == word for verdict, _ in judged)} {word}" for word in ("in", "out", "not decided")
            ]
            out = list(dict.fromkeys(name for verdict, name in judged if verdict == "out"))
            named = f"; out: {', '.join(first_few(out))}" if out else ""
            lines.append(f"tolerances{of}, predicted: {', '.join(counts)}{named}{why}")
    return lines


def _bound_words(result: CompensateResult) -> list[str]:
    """State the median and the largest bound, of positions and of rotations."""
    positions = [(one.within_mm, one.name) for one in result.targets if one.within_mm is not None]
    rotations = [(one.orientation.within_mrad, one.name) for one in result.targets if one.orientation is not None]
    sided = "; for the side of approach that stands beside each" if any(one.approach for one in result.targets) else ""
    lines = []
    for what, unit, bounds in (("error", "mm", positions), ("rotation", "mrad", rotations)):
        if bounds:
            (largest, name), median = max(bounds), np.median([bound for bound, _ in bounds])
            words = f"median {median:.3f} {unit}, largest {largest:.3f} {unit} at {name}"
            lines.append(f"95 % bound of the measured {what}: {words}{sided}")
    return lines


def common_words(result: CompensateResult | VerifyResult) -> list[str]:
    """State what is common to all targets of an arm, and each target's own part."""
    return [
        f"arm {name}: of the model's uncertainty the targets' own part is {one.own_mm:.3f} mm (median of a coordinate);"
        f" common to all are {one.sentence}"
        for name, one in result.common.items()
    ]


def _unseen_words(result: CompensateResult) -> list[str]:
    unseen = dict.fromkeys(target.name for target in result.targets if target.visible is False and not target.refusal)
    if not unseen:
        return []
    return [f"not seen by the tracker, so that a push cannot measure them: {', '.join(first_few(list(unseen)))}"]


# -- measured ---------------------------------------------------------------------------------------------------------


def verify_message(verify: VerifyResult) -> str:
    """Summarize the verification: number of targets within tolerance, mean error before and after."""
    parts = [_tolerance_message(verify)] if _judged(verify) else []
    measured = [one for one in verify.targets if None not in (one.nominal_mm, one.final_mm)]
    if measured:
        by_arm = grouped((one.arm, (one.nominal_mm, one.final_mm)) for one in measured)
        means = {name: np.mean(np.array(errors_mm), axis=0) for name, errors_mm in by_arm.items()}
        words = ", ".join(f"{name} {before:.2f} -> {after:.3f} mm" for name, (before, after) in means.items())
        parts.append(f"mean error of {words} at {counted(len(measured), 'target')}")
    pairs = [pair for pair in verify.pairs if pair.nominal_mm is not None and pair.final_mm is not None]
    if pairs:
        nominal = np.mean([pair.nominal_mm for pair in pairs if pair.nominal_mm is not None])
        last = np.mean([mm for pair in pairs if (mm := pair.final_mm) is not None])
        at = counted(len(pairs), "cooperative target")
        parts.append(f"distance of both SMRs {nominal:.2f} -> {last:.3f} mm at {at}")
    parts += _rotation_words("rotation of the flange", verify.targets)
    parts += _rotation_words("rotation of one flange in the other's frame", verify.pairs)
    return "; ".join(parts)


def _rotation_words(what: str, measured: Sequence[Measured]) -> list[str]:
    rotated = [one.orientation for one in measured if one.orientation is not None]
    was = [rotation.nominal_mrad for rotation in rotated if rotation.nominal_mrad is not None]
    final = [rotation.final_mrad for rotation in rotated if rotation.final_mrad is not None]
    if not (was and final):
        return []
    judged = [rotation.verdict for rotation in rotated if rotation.verdict]
    met = f" ({judged.count('in')} of {len(judged)} within tolerance)" if judged else ""
    return [f"{what} {np.mean(was):.2f} -> {np.mean(final):.3f} mrad{met}"]


def push_lines(pushed: VerifyResult) -> list[str]:
    """Return the lines that ``push`` prints: measurements, or else which targets were reached and why not the
    others."""
    if any(target.compensated_mm is not None for target in pushed.targets):
        return verify_lines(pushed)
    notes = {target.name: target.note for target in reversed(pushed.targets) if target.note}
    count = len({target.name for target in pushed.targets})
    missing = [f"target {target.name}: {target.note}" for target in pushed.targets if target.note]
    reached = f"{count - len(notes)} of {counted(count, 'target')} reached"
    return [reached, *common_words(pushed), *dict.fromkeys([*missing, *pushed.notes])]


def verify_lines(verify: VerifyResult) -> list[str]:
    """Return the lines that ``push --verify`` prints: the summary, what was not measured, notes."""
    missing = [f"target {target.name}: {target.note}" for target in verify.targets if target.note]
    missing += [f"target {pair.name}, both arms: {pair.note}" for pair in verify.pairs if pair.note]
    return [*verify_summary(verify), *common_words(verify), *dict.fromkeys([*missing, *verify.notes])]


def verify_summary(verify: VerifyResult) -> list[str]:
    """Return the message, the errors by the model alone, and whether its bounds held."""
    message = verify_message(verify)
    return [
        *([message] if message else []),
        *rounds_words(verify),
        *promise_words(verify),
        *decision_words(verify),
        *([verify.stopped] if verify.stopped else []),
    ]


def rounds_words(verify: VerifyResult) -> list[str]:
    """State the errors by the model alone, and after correction by measuring; empty without corrections."""
    lines = []
    for measured, what in ((verify.targets, ""), (verify.pairs, ", of the distance of both SMRs")):
        asked = [one for one in measured if one.rounds_mm]
        corrected = [one for one in asked if one.corrected_mm is not None]
        if not asked:
            continue
        brought = ""
        if corrected:
            errors_mm = np.array([(one.rounds_mm[0], one.final_mm) for one in corrected], dtype=np.float64)
            alone, last = errors_mm.mean(axis=0)
            rounds = max(len(one.rounds_mm) for one in corrected) - 1
            times = f"{'up to ' if rounds > 1 else ''}{counted(rounds, 'correction')}"
            brought = f", from {alone:.4f} mm by the model alone to {last:.4f} mm in the mean, with {times}"
        lines.append(
            f"corrected by measuring{what}: {len(corrected)} of {counted(len(asked), 'target')}{brought}; the error of"
            " the others is not significant, or no correction made it significantly smaller"
        )
    return lines


def decision_words(verify: VerifyResult) -> list[str]:
    """State the decision rule of the tolerances and what it lacks; empty without a tolerance."""
    if not _judged(verify):
        return []
    return [line for line in (RULE_WORDS[verify.rule], undecided_words(verify.not_given)) if line]


def promise_words(verify: VerifyResult) -> list[str]:
    """State how many errors by the model alone are within its bound; empty if it stated none."""
    known = [
        error <= one.within_mm
        for one in verify.targets
        if one.within_mm is not None and (error := one.compensated_mm) is not None
    ]
    errors = counted(len(known), "measured error is", "measured errors are")
    return [f"{sum(known)} of {errors} within the predicted 95 % bound"] if known else []


def _judged(verify: VerifyResult) -> list[Measured]:
    measured: list[Measured] = [*verify.targets, *verify.pairs]
    return [one for one in measured if one.verdict]


def _tolerance_message(verify: VerifyResult) -> str:
    judged = _judged(verify)
    out = [f"{one.name} ({one.final_mm or 0.0:.3f} mm)" for one in judged if one.verdict == "out"]
    unsure = [f"{one.name} ({one.final_mm or 0.0:.3f} mm)" for one in judged if one.verdict == "not decided"]
    within = f"{len(judged) - len(out) - len(unsure)} of {counted(len(judged), 'measurement')} within tolerance"
    within += f", {len(out)} out: {', '.join(first_few(out))}" if out else ""
    return within + (f", {len(unsure)} not decided: {', '.join(first_few(unsure))}" if unsure else "")
