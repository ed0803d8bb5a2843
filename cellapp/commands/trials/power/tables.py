"""Tables and charts of the sizes from which effects are named."""

from __future__ import annotations

import math

from cellapp.commands.trials.power.result import SHARE, ArmPower, EffectPower, NamedSize, PowerResult
from cellapp.commands.view.charts import Axis, Chart, bar_chart
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.table import Interval, Table, table_of
from cellapp.ground.counting import counted


def power_parts(result: PowerResult) -> Parts:
    """Show what the plan would name: the method, then a table and a chart for each arm."""
    parts: list[str | Table | Chart] = [power_sentence(result)]
    for name, arm in result.arms.items():
        parts += [power_chart(name, arm), power_table(name, arm)]
    return [*parts, *(f"not computed: {one}" for one in result.failed[:10])]


def power_sentence(result: PowerResult) -> str:
    """Say what was tried, in one sentence."""
    ended = f"; the time ended them before all {result.trials_of_each} of each" if result.ended_by_time else ""
    return (
        f"Sizes from which an effect is named in {result.share:.0%} of the runs, from {len(result.trials)} blind trials"
        f" of the planned stops with the tracker's noise (seed {result.seed}{ended}); the interval holds with 90 %."
    )


def power_table(name: str, arm: ArmPower) -> Table:
    """Show every effect of an arm; those named from the smallest sizes first."""
    return table_of(
        f"Arm {name}: {counted(arm.stops, 'stop')}, noise {arm.noise_rms_mm:.3f} mm rms",
        _ordered(arm),
        ("effect", lambda one: one.title),
        ("named from", lambda one: one.named_from and one.named_from.value_mm, ".3f", "mm rms"),
        ("interval", _interval, ".3f", "mm rms"),
        ("largest value", _value),
        ("not up to", lambda one: one.not_up_to_mm, ".2f", "mm rms"),
        ("trials", lambda one: one.trials, "d"),
        ("named", lambda one: one.named, "d"),
        ("with another name", lambda one: one.with_others, "d"),
        ("what limits it", lambda one: one.limit),
    )


def power_chart(name: str, arm: ArmPower) -> Chart:
    """Show a bar for each effect that is named from some size on."""
    shown = {one.title: one.named_from for one in _ordered(arm) if one.named_from is not None}
    bars = {title: (size.value_mm, _words(size)) for title, size in shown.items()}
    least = next((f"{title} from {text}" for title, (_, text) in bars.items()), "no effect")
    return bar_chart(
        f"Arm {name}: size from which an effect is named in {100 * SHARE:.0f} % of the runs",
        bars,
        Axis("rms displacement of the SMR", "mm"),
        f"Named at the smallest size: {least}. {len(arm.effects) - len(bars)} effects were not shown to be named.",
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _ordered(arm: ArmPower) -> list[EffectPower]:
    return sorted(arm.effects, key=lambda one: math.inf if one.named_from is None else one.named_from.value_mm)


def _interval(one: EffectPower) -> Interval | str | None:
    if one.named_from is None:
        return None
    low, high = one.named_from.low_mm, one.named_from.high_mm
    return f"{low:.3f} and more" if high is None else Interval(low, high)


def _value(one: EffectPower) -> str:
    size = None if one.named_from is None else one.named_from.size
    return "" if size is None else f"{size.value:.3g} {size.unit}"


def _words(size: NamedSize) -> str:
    until = "and more" if size.high_mm is None else f"to {size.high_mm:.3f}"
    return f"{size.value_mm:.3f} ({size.low_mm:.3f} {until}) mm"
