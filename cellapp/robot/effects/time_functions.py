"""Functions of time shared by effects: linear, warm-up, onset, first-order lag; their constants come from a run."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.robot.effects.context import EffectContext
from cellapp.robot.effects.law import AMPLITUDE, FIXED, SCALED, Constant, Law, LawForm, NeighbouringPauses
from cellapp.robot.kinematics.transforms import Array

TIME_CONSTANTS = (900.0, 1800.0, 3600.0, 7200.0, 14400.0)
"""Time constants of warm-up to try [s]: a quarter of an hour to four hours covers machines of this size."""
ONSETS_MOST = 120
"""Onsets to try: one every few minutes of a run of some hours; tuning then moves to the neighbouring pauses."""
ONSET_MARGIN = 8
"""Readings before the first onset to try, and after the last: enough to estimate the six parameters of a step."""
FIRST = Constant("first_s", "s", FIXED)
"""Beginning of the run."""
LAST = Constant("last_s", "s", FIXED)
"""End of the run."""
WARM_UP_TIME = Constant("tau_s", "s", SCALED, "time constant {} min", factor=1.0 / 60.0)
ONSET = Constant(
    "onset_s",
    "s",
    NeighbouringPauses(reach=6, margin=ONSET_MARGIN - 1),
    "{} h after the run began",
    factor=1.0 / 3600.0,
)
LINEAR_FORM = LawForm("linear", "steadily over the run", (FIRST, LAST))
WANDERING = LawForm("smooth", "slowly to and fro over the run", (FIRST, LAST, AMPLITUDE))
_HALF_CYCLES = 12
"""Half cycles over the run of what wanders: the shortest is a sixth of the run."""
WARM_UP_FORM = LawForm("warm_up", "warming up", (FIRST, LAST, WARM_UP_TIME))
ONSET_FORM = LawForm("onset", "at once", (ONSET,))


def run_span(context: EffectContext) -> dict[str, float]:
    """Constants ``FIRST`` and ``LAST`` of a run; empty where times are unknown."""
    time_s = context.conditions.time_s
    if time_s is None or not np.isfinite(time_s).any():
        return {}
    return {FIRST.name: float(np.nanmin(time_s)), LAST.name: float(np.nanmax(time_s))}


def times(context: EffectContext, constants: Mapping[str, float]) -> Array:
    """Times (n,) [s]; the end of the fitted run where unknown."""
    return with_default(context.conditions.time_s, constants[LAST.name], len(context))


def run_fraction(context: EffectContext, law: Law) -> Array:
    """Fraction of the run (n,), 0 at its beginning to 1 at its end; constant beyond, where nothing was measured."""
    first, last = law.constants[FIRST.name], law.constants[LAST.name]
    return np.clip((times(context, law.constants) - first) / (last - first), 0.0, 1.0)


def half_cycles(along: Array) -> dict[int, Array]:
    """``cos(k pi f)`` (n,) at fractions f (n,) of a run, for k = 1 to 12."""
    return {k: np.cos(k * math.pi * along) for k in range(1, _HALF_CYCLES + 1)}


def warm_up(context: EffectContext, law: Law) -> Array:
    """``1 - exp(-(t - first) / tau)`` (n,), 0 at the beginning of the run."""
    elapsed = np.maximum(times(context, law.constants) - law.constants[FIRST.name], 0.0)
    return -np.expm1(-elapsed / law.constants[WARM_UP_TIME.name])


def warm_up_laws(context: EffectContext, form: LawForm = WARM_UP_FORM) -> list[Law]:
    """One law for each time constant to try."""
    run = run_span(context)
    return [form.law({**run, WARM_UP_TIME.name: tau}, len(TIME_CONSTANTS)) for tau in TIME_CONSTANTS]


def onset_laws(context: EffectContext) -> list[Law]:
    """Laws of a sudden change between two readings; the onsets are spread over the run."""
    time_s = context.conditions.time_s
    if time_s is None or not np.isfinite(time_s).all():
        return []
    ordered = np.sort(time_s)
    before, after = ordered[ONSET_MARGIN - 1 : -ONSET_MARGIN], ordered[ONSET_MARGIN : len(ordered) - ONSET_MARGIN + 1]
    onsets = ((before + after) / 2.0)[before < after]
    if len(onsets) > ONSETS_MOST:
        onsets = onsets[np.unique(np.rint(np.linspace(0, len(onsets) - 1, ONSETS_MOST)).astype(np.intp))]
    return [ONSET_FORM.law({ONSET.name: onset}, len(onsets)) for onset in onsets.tolist()]


def after_onset(context: EffectContext, law: Law) -> Array:
    """1 after the onset, else 0 (n,); 1 where the time is unknown."""
    return (with_default(context.conditions.time_s, np.inf, len(context)) >= law.constants[ONSET.name]).astype(
        np.float64
    )


def times_known(context: EffectContext) -> bool:
    """Whether all times are known and not all equal."""
    time_s = context.conditions.time_s
    return time_s is not None and len(time_s) > 0 and bool(np.isfinite(time_s).all()) and float(np.ptp(time_s)) > 0.0


def lagged(values: Array, time_s: Array, lag_s: float) -> Array:
    """Response of a first-order lag to inputs (n, k) at times (n,), settled at the first of them.

    Between two times the input is their mean. One cumulative sum, exact for the sampled input.
    """
    order = np.argsort(time_s, kind="stable")
    # exp(t / lag) must not overflow: below 1/500 of the run a lag is not distinguishable from none
    t = (time_s[order] - time_s[order[0]]) / max(lag_s, float(np.ptp(time_s)) / 500.0)
    inputs = values[order]
    steps = 0.5 * (inputs[1:] + inputs[:-1]) * np.diff(np.exp(t))[:, None]
    out = np.empty_like(inputs)
    out[0] = inputs[0]
    out[1:] = (inputs[0] + np.cumsum(steps, axis=0)) * np.exp(-t[1:])[:, None]
    found = np.empty_like(out)
    found[order] = out
    return found


def with_default(values: Array | None, default: float | Array, rows: int) -> Array:
    """Values (n, ...) with ``default`` where unknown."""
    if values is None:
        return np.broadcast_to(default, (rows, *np.shape(default))).astype(np.float64)
    return np.where(np.isnan(values), default, values)
