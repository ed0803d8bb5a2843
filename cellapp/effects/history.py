"""Functions of time, and of quantities that drift with it, whose constants are taken from a run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.effects.effect import EffectContext, Law
from cellapp.kinematics.transforms import Array

TIME_CONSTANTS = (900.0, 1800.0, 3600.0, 7200.0, 14400.0)
"""In which machines of this size may warm up [s]."""
ONSETS_MOST = 120
ONSET_MARGIN = 8
"""Readings before the first onset that is tried, and after the last."""


def span(context: EffectContext) -> dict[str, float]:
    """``first_s`` and ``last_s``: when the run began and ended; empty where times are not known."""
    known = context.known.time_s
    if known is None or not np.isfinite(known).any():
        return {}
    return {"first_s": float(np.nanmin(known)), "last_s": float(np.nanmax(known))}


def times(context: EffectContext, constants: Mapping[str, float]) -> Array:
    """Times (n,) [s]; the end of the run that taught the law where unknown."""
    return filled(context.known.time_s, constants["last_s"], len(context))


def linear(context: EffectContext, law: Law) -> Array:
    """0 at the beginning of the run to 1 at its end (n,), and held beyond: nobody knows how it went on."""
    first, last = law.constants["first_s"], law.constants["last_s"]
    return np.clip((times(context, law.constants) - first) / (last - first), 0.0, 1.0)


def warm_up(context: EffectContext, law: Law) -> Array:
    """``1 - exp(-(t - first) / tau)`` (n,), 0 at the beginning of the run."""
    elapsed = np.maximum(times(context, law.constants) - law.constants["first_s"], 0.0)
    return -np.expm1(-elapsed / law.constants["tau_s"])


def warm_up_laws(context: EffectContext, name: str = "warm_up") -> list[Law]:
    """One law for each time constant."""
    return [Law(name, {**span(context), "tau_s": tau}, len(TIME_CONSTANTS)) for tau in TIME_CONSTANTS]


def onset_laws(context: EffectContext) -> list[Law]:
    """Laws ``onset`` of something that happened between two readings; the onsets are spread over the run."""
    known = context.known.time_s
    if known is None or not np.isfinite(known).all():
        return []
    ordered = np.sort(known)
    before, after = ordered[ONSET_MARGIN - 1 : -ONSET_MARGIN], ordered[ONSET_MARGIN : len(ordered) - ONSET_MARGIN + 1]
    onsets = ((before + after) / 2.0)[before < after]
    if len(onsets) > ONSETS_MOST:
        onsets = onsets[np.unique(np.rint(np.linspace(0, len(onsets) - 1, ONSETS_MOST)).astype(np.intp))]
    return [Law("onset", {"onset_s": onset}, len(onsets)) for onset in onsets.tolist()]


def after_onset(context: EffectContext, law: Law) -> Array:
    """1 after the onset, else 0 (n,); after it where the time is unknown."""
    return (filled(context.known.time_s, np.inf, len(context)) >= law.constants["onset_s"]).astype(np.float64)


def no_onset(context: EffectContext) -> str:
    """Why no onset can be looked for; empty when it can."""
    if not times_known(context):
        return "no times"
    return "" if onset_laws(context) else f"fewer than {2 * ONSET_MARGIN} readings"


def times_known(context: EffectContext) -> bool:
    """Whether all times are known and not one moment."""
    known = context.known.time_s
    return known is not None and len(known) > 0 and bool(np.isfinite(known).all()) and float(np.ptp(known)) > 0.0


def lagged(values: Array, time_s: Array, lag_s: float) -> Array:
    """Values (n, k) at times (n,) behind a first-order lag that was settled at the first of them.

    Between two times the input is their mean. Exact for the sampled input, by one cumulative sum.
    """
    order = np.argsort(time_s, kind="stable")
    t = (time_s[order] - time_s[order[0]]) / max(lag_s, float(np.ptp(time_s)) / 500.0)
    inputs = values[order]
    steps = 0.5 * (inputs[1:] + inputs[:-1]) * np.diff(np.exp(t))[:, None]
    out = np.empty_like(inputs)
    out[0] = inputs[0]
    out[1:] = (inputs[0] + np.cumsum(steps, axis=0)) * np.exp(-t[1:])[:, None]
    found = np.empty_like(out)
    found[order] = out
    return found


def filled(values: Array | None, instead: float | Array, rows: int) -> Array:
    """Values (n, ...) with ``instead`` where nobody knows."""
    if values is None:
        return np.broadcast_to(instead, (rows, *np.shape(instead))).astype(np.float64)
    return np.where(np.isnan(values), instead, values)
