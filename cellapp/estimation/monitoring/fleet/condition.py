"""The condition of one arm from its history, with the reasons for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cellapp.estimation.monitoring.fleet.records import (
    ArmCondition,
    ArmHistory,
    EffectHistory,
    Figure,
    ParameterHistory,
    Trend,
)
from cellapp.ground.times import day_of

_CHANGED = ("appeared", "vanished", "grew", "shrank")
FIGURE_WORDS: Mapping[Figure, str] = {
    "heldout": "mean held-out error",
    "verified": "largest distance from a target",
    "check": "rms error of checks",
    "noise": "noise of a position (rms)",
    "repeatability": "repeatability RP of repeated stops",
    "pose_accuracy": "largest pose accuracy AP",
    "pose_repeatability": "largest pose repeatability RP",
    "temperature": "mean temperature",
}


def condition_of(arm: ArmHistory) -> tuple[ArmCondition, tuple[str, ...]]:
    """The worst condition that the history proves, and the reasons for this one and all better ones."""
    beyond, changed = list(_beyond(arm)), list(_changed(arm))
    drifting = [drift_words(trend) for trend in arm.trends if leads_away(trend)]
    reasons = (*beyond, *changed, *drifting)
    if beyond:
        return "beyond tolerance", reasons
    if changed:
        return "changed", reasons
    if drifting:
        return "drifting", reasons
    compared = len(arm.compared) > 1 or bool(arm.trends) or bool(arm.checks)
    return ("unchanged" if compared else "not compared"), ()


def _beyond(arm: ArmHistory) -> Iterator[str]:
    verified = arm.figures.get("verified", ())
    if verified and arm.tolerance_mm is not None and verified[-1].value > arm.tolerance_mm:
        newest = verified[-1]
        yield (
            f"largest distance from a target {newest.value:.3f} mm on {day_of(newest.time)}, tolerance"
            f" {arm.tolerance_mm:g} mm"
        )
    newest_test = arm.iso9283[-1].time if arm.iso9283 else ""
    for point in arm.iso9283:
        if point.time == newest_test and point.conformity == "does not conform":
            value = "" if point.value_mm is None else f" {point.value_mm:.3f} mm"
            yield (
                f"ISO 9283 {point.characteristic.replace('_', ' ')}{value} on {day_of(point.time)}, tolerance"
                f" {point.tolerance_mm:g} mm"
            )


def _changed(arm: ArmHistory) -> Iterator[str]:
    for parameter in arm.parameters:
        if parameter.last is not None and parameter.last.proven:
            yield change_words(parameter)
    for effect in arm.effects:
        if effect.state in _CHANGED:
            yield effect_words(effect)
    newest = arm.checks[-1] if arm.checks else None
    calibrated = max((p.changes[-1].time if p.changes else p.first.time for p in arm.parameters), default="")
    if newest is None or newest.time <= calibrated:
        return
    if newest.verdict == "arm changed" and newest.changes:
        yield f"the check of {day_of(newest.time)} says that the arm changed: {', '.join(newest.changes)}"
    elif newest.verdict == "not explained":
        yield f"the check of {day_of(newest.time)} found errors that no single change explains"


def leads_away(trend: Trend) -> bool:
    """Whether a trend is proven and makes the arm worse: an error that falls does not."""
    return trend.proven and (trend.figure == "parameter" or trend.slope > 0.0)


def drift_words(trend: Trend) -> str:
    """``theta2 drifts: it moves the SMR by 0.0166 mm (rms) a month``."""
    rate = f"{abs(trend.slope):.4f} mm"
    if trend.figure == "parameter":
        return f"{trend.name} drifts: it moves the SMR by {rate} (rms) a month"
    return f"the {FIGURE_WORDS[trend.figure]} {'grows' if trend.slope > 0.0 else 'falls'} by {rate} a month"


def change_words(parameter: ParameterHistory) -> str:
    """``theta2 changed by 120 +/- 8 µrad, which moves the SMR by 0.1 mm``."""
    last = parameter.last
    assert last is not None
    factor, unit = _micro(parameter.unit)
    moved = "" if parameter.moved_mm is None else f", which moves the SMR by {parameter.moved_mm:.3f} mm (rms)"
    return (
        f"{parameter.name} changed by {factor * last.difference:+.1f} {unit} (standard uncertainty"
        f" {factor * last.standard_uncertainty:.1f}){moved}"
    )


def _micro(unit: str) -> tuple[float, str]:
    """Factor and unit in which an angle, a length or either per something is shown."""
    return (1e6, f"µ{unit}") if unit.partition("/")[0] in ("rad", "m") else (1.0, unit)


def effect_words(effect: EffectHistory) -> str:
    """``backlash (joints 1, 2) grew: half_play1 by ...``."""
    joints = ", ".join(map(str, effect.where.joints))
    where = f" (joint{'s' if len(effect.where.joints) > 1 else ''} {joints})" if joints else ""
    subject = f"{effect.effect.replace('_', ' ')}{where} {effect.state}"
    if effect.difference is None or effect.standard_uncertainty is None:
        return subject
    factor, unit = _micro(effect.unit)
    return (
        f"{subject}: {effect.parameter} by {factor * effect.difference:+.3g} {unit} (standard uncertainty"
        f" {factor * effect.standard_uncertainty:.2g})"
    )
