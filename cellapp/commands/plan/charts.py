"""Charts of a plan before it is measured: expected errors, joint ranges, time, correlations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.planning.candidates import joint_ranges
from cellapp.cell.planning.records import (
    ArmDesign,
    FactorCorrelation,
    PlanDesignResult,
    PlannedTime,
    PlanQuality,
    TravelTime,
)
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.commands.plan.check_view import duration_words
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Array, Axis, Chart, bar_chart, enumerated, mm, series
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile

MOST_CORRELATION = 0.1
"""Bound that a plan should keep for the correlations of factors that can be chosen."""
_MOST_BARS = 10
"""Most correlations that are drawn, the largest first."""
_EQUAL = {"parameters": "parameters", "mean": "mean error", "worst": "worst error"}
_MEAN, _WORST, _OTHER_STYLE = 0, 1, 4


def design_charts(design: PlanDesignResult | None, time: PlannedTime | None) -> tuple[Chart, ...]:
    """Show each arm's expected errors by stops, time, correlations; only the time without a design (None)."""
    if design is None:
        return (time_chart(None, time),)
    told = (information_chart(name, arm) for name, arm in design.arms.items())
    return (*told, time_chart(design.travel, time), correlation_chart(design))


# -- information ------------------------------------------------------------------------------------------------------


def information_chart(name: str, arm: ArmDesign) -> Chart:
    """Show the expected position error after the first n stops, mean and worst point, beside random plans."""
    stops = [one.stops for one in arm.by_stops]
    random = arm.random
    drawn = (
        series("mean", stops, [one.mean_mm for one in arm.by_stops], style=_MEAN),
        series("worst point", stops, [one.worst_mm for one in arm.by_stops], style=_WORST),
        series("mean, random stops", [random.stops], [random.mean_mm], "points", style=_MEAN, mark="○"),
        series("worst point, random stops", [random.stops], [random.worst_mm], "points", style=_WORST, mark="△"),
    )
    axes = Axis("stops"), Axis("expected error", "mm", logarithmic=True)
    return Chart(f"Arm {name}: what the first stops tell", *axes, drawn, _information_message(name, arm))


def _information_message(name: str, arm: ArmDesign) -> str:
    designed = arm.designed
    equal = [f"{stops:.0f} in {_EQUAL[what]}" for what, stops in arm.equal_to_random.items()]
    early = next((one for one in arm.by_stops if 4 * one.stops >= designed.stops), None)
    sentences = [f"Arm {name}: {counted(designed.stops, 'stop gives', 'stops give')} {_errors(designed)}"]
    if equal:
        sentences.append(f"They tell as much as random stops: {enumerated(equal)}")
    if early is not None and early.stops < designed.stops:
        sentences.append(f"After {counted(early.stops, 'stop')} {_errors(early)}")
    return ". ".join(sentences) + "."


def _errors(quality: PlanQuality) -> str:
    return f"{mm(quality.mean_mm)} on average, {mm(quality.worst_mm)} at the worst point"


# -- joints -----------------------------------------------------------------------------------------------------------


def coverage_charts(profile: Profile, stops: Sequence[PlannedStop]) -> tuple[Chart, ...]:
    """Show the joint ranges of every arm and the stops in them; none if the profile does not describe the cell."""
    try:
        cell = cell_bodies(profile)
        allowed = {name: joint_ranges(cell, profile, name) for name in cell.arms}
    except InputError:
        return ()
    return tuple(
        coverage_chart(name, ranges, np.array([stop.q[name] for stop in stops]).reshape(-1, len(ranges)))
        for name, ranges in allowed.items()
    )


def coverage_chart(name: str, allowed: Array, q: Array) -> Chart:
    """Show each joint's allowed range (N, 2) [rad] of one arm, the stops (n, N) [rad] in it, and the largest gap."""
    axes = Axis("joint position", "deg"), Axis("joint")
    title = f"Arm {name}: joint ranges"
    if not len(q):
        return Chart(title, *axes, (), f"Arm {name}: no stops yet.")
    joints = np.arange(1.0, q.shape[1] + 1.0)
    degrees, limits = np.degrees(q), np.degrees(allowed)
    gaps = np.array([_largest_gap(column) for column in degrees.T])
    drawn = (
        series("allowed", *_segments(limits, joints), style=_OTHER_STYLE, mark="·"),
        series("stops", degrees.ravel(), np.tile(joints, len(q)), "points", style=_MEAN),
        series("largest gap", *_segments(gaps, joints), style=_WORST, mark="×"),
    )
    used = np.ptp(degrees, axis=0) / np.maximum(np.ptp(limits, axis=1), 1e-9)
    widest, least = int(np.argmax(np.ptp(gaps, axis=1))), int(np.argmin(used))
    message = (
        f"Arm {name}: the largest part of a travelled range without a stop is {np.ptp(gaps[widest]):.0f} deg, of joint"
        f" {widest + 1}; joint {least + 1} uses the least of its range, {100.0 * used[least]:.0f} %."
    )
    return Chart(title, *axes, drawn, message)


def _largest_gap(values: Array) -> tuple[float, float]:
    """Return the two neighbouring values of (n,) with the largest gap between them."""
    ordered = np.sort(values)
    if len(ordered) < 2:
        return float(ordered[0]), float(ordered[0])
    at = int(np.argmax(np.diff(ordered)))
    return float(ordered[at]), float(ordered[at + 1])


def _segments(ends: Array, height: Array) -> tuple[Array, Array]:
    """Return horizontal lines between ends (m, 2) at heights (m,), with NaN gaps between them."""
    x = np.column_stack([ends, np.full(len(ends), np.nan)])
    return x.ravel(), np.repeat(height, 3)


# -- time -------------------------------------------------------------------------------------------------------------


def time_chart(travel: TravelTime | None, time: PlannedTime | None) -> Chart:
    """Show how the time of collecting is spent, and the motions in a random order too. None: not known."""
    bars = {} if time is None else {"motions": time.moving_s}
    if travel is not None:
        bars = {"motions": travel.planned_s, "in random order": travel.random_order_s}
    if time is not None:
        rest = {"rests": time.resting_s, "measuring": time.measuring_s}
        bars |= rest | {"references": time.references_s, "warm-up": time.warm_up_s}
    shown = {name: (seconds / 60.0, duration_words(seconds)) for name, seconds in bars.items() if seconds > 0.0}
    sentences = [] if time is None else [f"Collecting takes about {duration_words(time.total_s)}."]
    if travel is not None and travel.saved >= 0.005:
        sentences.append(f"The order of the stops saves {100.0 * travel.saved:.0f} % of the motions' time.")
    return bar_chart("Time of the plan", shown, Axis("time", "min"), " ".join(sentences) or "Time is not known yet.")


# -- factors ----------------------------------------------------------------------------------------------------------


def correlation_chart(design: PlanDesignResult) -> Chart:
    """Show the largest correlations of planned factors with each other, with posture and with time."""
    ordered = sorted(design.correlations, key=lambda one: abs(one.correlation), reverse=True)
    pairs = {frozenset((one.factor, one.other)): one for one in reversed(ordered)}  # each pair is listed twice
    largest = list(reversed(pairs.values()))[:_MOST_BARS]
    bars = {_short(_pair(one)): (abs(one.correlation), f"{abs(one.correlation):.2f}") for one in largest}
    return bar_chart("Largest correlations of factors", bars, Axis("correlation"), correlation_sentence(design))


def correlation_sentence(design: PlanDesignResult) -> str:
    """State the largest correlation of a factor that can be chosen, against the bound ``MOST_CORRELATION``."""
    largest = design.largest_correlation
    if largest is None:
        return "No factor of this plan could be chosen."
    size = abs(largest.correlation)
    verdict = "as wanted" if size <= MOST_CORRELATION else "more than wanted: these two may be mistaken for each other"
    return f"Largest correlation where a factor can be chosen: {size:.2f}, {_pair(largest)}; {verdict}."


def _short(words: str) -> str:
    """Shorten words for the label of a bar."""
    for long, short in (("approach side", "side"), ("step size", "size"), ("gravity torque", "torque")):
        words = words.replace(long, short)
    return words


def _pair(one: FactorCorrelation) -> str:
    given = "" if one.can_be_chosen else " (given)"
    return f"{one.factor} with {one.other}{given}"
