"""``trials power``: from which size on effects would be named."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cellapp.cell.run import RunFile
from cellapp.commands.view.charts import Axis, Chart, bar_chart
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.table import Interval, Table, table_of
from cellapp.estimation.discovery.records import SmallestSize
from cellapp.ground.counting import counted
from cellapp.ground.results import Record, Result

POWER_RESULT = "plan-power"
"""Name of the document in a run with the result."""
SHARE = 0.95
"""Share of the trials in which an effect must be named."""


class NamingTrial(Record):
    """One blind trial: an effect hidden in an arm, its rms displacement of the SMR, and what was accepted.

    ``visible`` is the share of the displacement that the geometry cannot follow. ``named`` is the largest value of the
    effect where it was named.
    """

    arm: str
    effect: str
    size_mm: float
    seed: int
    visible: float = 0.0
    accepted: tuple[str, ...] = ()
    named: SmallestSize | None = None


class NamedSize(Record):
    """Rms displacement of the SMR [mm] from which an effect is named in ``SHARE`` of the trials: median of the belief,
    and the limits of 90 %; ``high_mm`` is None where the trials set none. ``size`` is the effect's largest value."""

    value_mm: float
    low_mm: float
    high_mm: float | None
    size: SmallestSize | None


class EffectPower(Record):
    """What the trials say of one effect in one arm.

    Attributes
    ----------
    named_from : NamedSize or None
        None: the trials do not show that it would be named in ``SHARE`` of the runs, whatever its size.
    not_up_to_mm : float or None
        Then the largest rms displacement that was tried [mm]; None where no trial was made.
    visible_share : float or None
        Median share of its displacement that geometry cannot follow at these stops.
    trials, named, with_others : int
        Trials, those in which its name was accepted, and those of them in which another name was, too.
    limit : str
        What limits it.
    """

    effect: str
    title: str
    named_from: NamedSize | None = None
    not_up_to_mm: float | None = None
    visible_share: float | None = None
    trials: int = 0
    named: int = 0
    with_others: int = 0
    limit: str = ""


class ArmPower(Record):
    """One arm: stops, rms length of the tracker's noise [mm], and every effect of the library that it can have."""

    stops: int
    noise_rms_mm: float
    effects: tuple[EffectPower, ...]


class PowerResult(Result, schema="cellapp-plan-power"):
    """``trials power``: arms, every trial, what failed, and whether the time ended it before all trials were made."""

    date: str
    program: str
    profile: str
    trials_of_each: int
    seed: int
    share: float
    arms: Mapping[str, ArmPower]
    trials: tuple[NamingTrial, ...]
    failed: tuple[str, ...] = ()
    ended_by_time: bool = False


def stored_power(run: RunFile) -> PowerResult | None:
    """Return the stored result of a run; None if its plan was not tried."""
    text = run.read_result(POWER_RESULT)
    return None if text is None else PowerResult.from_json(text, str(run.folder))


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
