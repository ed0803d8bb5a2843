"""A base that moves during the run, slowly or suddenly."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, shift_column
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import AMPLITUDE, FIXED, Constant, InputVariable, Law, LawForm, SmoothLaw, with_prior_sd
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.effects.time_functions import (
    FIRST,
    LAST,
    LINEAR_FORM,
    ONSET_FORM,
    ONSET_MARGIN,
    WANDERING,
    WARM_UP_FORM,
    after_onset,
    half_cycles,
    onset_laws,
    run_fraction,
    run_span,
    times_known,
    warm_up,
    warm_up_laws,
    with_default,
)
from cellapp.robot.kinematics.transforms import Array

# -- What effects have in common that begin at an onset, which is searched between readings ---------------------------


class OnsetEffect(Effect):
    """An effect that is there from an onset on, which is searched between readings."""

    variables = frozenset({InputVariable.TIME})
    forms = (ONSET_FORM,)
    discrepancy_inputs = (TermInput(Quantity.TIME),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs times."""
        if not times_known(context):
            return "no times"
        return "" if onset_laws(context) else f"fewer than {2 * ONSET_MARGIN} readings"

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each onset."""
        return onset_laws(context)


_COMPONENTS = (("x", "m"), ("y", "m"), ("z", "m"), ("turn_x", "rad"), ("turn_y", "rad"), ("turn_z", "rad"))
_MOST_MOTION = 1e-2
"""Bound of each component [m, rad]: a base that moved by a centimetre must be registered again."""
QUADRATIC = LawForm("quadratic", "over the run, with a bow", (FIRST, LAST))
FIRST_STOP = Constant("first_stop", "", FIXED)
LAST_STOP = Constant("last_stop", "", FIXED)
WANDERING_IN_ORDER = LawForm("smooth_in_order", WANDERING.words, (FIRST_STOP, LAST_STOP, AMPLITUDE))
"""As ``WANDERING``, against the place in the order of measurement, where the times are not known."""


class BaseDrift(Effect):
    """The base drifts: its frame is twisted by ``(d, w) f(t)``, shift d [m] along, rotation w [rad] about its x, y, z.

    Laws
    ----
    linear
        f from 0 at the beginning of the run to 1 at its end.
    warm_up
        ``f = 1 - exp(-(t - first) / tau)``, tau is searched.
    quadratic
        Linear, and a bow ``4 f (1 - f)`` of its own size and direction (names end in ``_bow``).

    smooth
        Half cycles ``cos(k pi f)``, k = 1 to 12, small by prior, the more so the faster (1 / k).

    Drift of the tracker is the same in one arm's readings: fixed nests, or the other arm, distinguish them.
    Size: 10 to 50 µm (estimate); a tracker of this class errs by tenths of a millimetre in its first two hours
    (published), 10 to 40 µm after (estimate). 49 % visible when linear, 22 % when warming up. Confounded: thermal
    growth, a step of the base, joint drift.
    """

    slug = "base_drift"
    title = "drift of the base (drift of the tracker looks the same)"
    meaning = Meaning.of(
        """cause: The base moves slowly against the tracker: stand or head of the tracker warms up, a pedestal
          settles, the floor creeps.
        size (sourced): tenths of a millimetre in a tracker's first two hours (published), 10 to 40 µm after that
          (estimate)
        check: Let the tracker run for two hours before measuring.
        check: Check the tracker's stand: clamps, feet, cables that pull.
        check: Check the bolts of pedestal and base plate.
        settle: Measure four fixed nests every 20 stops: if they move, it is the tracker.
        settle: Measure both arms by turns: what both share is the tracker's."""
    )
    confounded = ("base_step", "thermal_growth", "joint_drift")
    variables = frozenset({InputVariable.TIME})
    forms = (LINEAR_FORM, WARM_UP_FORM, QUADRATIC, WANDERING, WANDERING_IN_ORDER)
    discrepancy_inputs = (TermInput(Quantity.TIME),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs times."""
        return "" if times_known(context) else "no times"

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Over the time of the run, or over its order where no times are known."""
        if times_known(context) and FIRST.name in run_span(context):
            return [SmoothLaw("smooth", 2e-5, run_span(context))]
        if found := order_span(context):
            return [SmoothLaw("smooth_in_order", 2e-5, found)]
        return []

    def laws(self, context: EffectContext) -> list[Law]:
        """Linear; warming up; quadratic."""
        if not times_known(context):
            return []
        run = run_span(context)
        return [LINEAR_FORM.law(run), *warm_up_laws(context), QUADRATIC.law(run)]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Six columns, twelve for the quadratic law; the end of the run where the time is unknown."""
        if law.form == WARM_UP_FORM:
            return _twist(self.slug, context, warm_up(context, law))
        along = _place_in_order(context, law) if law.form == WANDERING_IN_ORDER else run_fraction(context, law)
        if law.form in (WANDERING, WANDERING_IN_ORDER):
            return [
                with_prior_sd(column, law.constants[AMPLITUDE.name] / k)
                for k, wave in half_cycles(along).items()
                for column in _twist(self.slug, context, wave, f"_{k}")
            ]
        columns = _twist(self.slug, context, along)
        if law.form == QUADRATIC:
            columns += _twist(self.slug, context, 4.0 * along * (1.0 - along), "_bow")
        return columns


class BaseStep(OnsetEffect):
    """The base slips: twist ``(d, w)`` of the base frame after an onset, shift d [m] and rotation w [rad] as for drift.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. A tracker that was
    displaced looks the same in one arm's readings. Size: 10 to 50 µm (estimate); 61 % visible. Confounded: drift of
    the base (0.5 to 0.6), slip of the target.
    """

    slug = "base_step"
    title = "step of the base (a step of the tracker looks the same)"
    meaning = Meaning.of(
        """cause: The base or the tracker moved at once: a bumped stand, a bolt that slipped, a crane or fork-lift.
        size (estimate): 10 to 50 µm
        check: Look in the log for what happened at the time of the step.
        check: Check the bolts of the base plate and the clamps of the tracker's stand.
        check: If the step is large, orient the tracker again and repeat the stops before or after it.
        settle: Measure the fixed nests again: if they moved, it was the tracker.
        settle: Repeat five of the first stops: a step stays, a drift goes on."""
    )
    confounded = ("base_drift", "thermal_growth", "target_slip", "joint_drift")

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Six columns; after the onset where the time is unknown."""
        return _twist(self.slug, context, after_onset(context, law))


def order_span(context: EffectContext) -> dict[str, float]:
    """Constants ``FIRST_STOP`` and ``LAST_STOP`` of a run; empty where the order of measurement is not known."""
    order = context.conditions.order
    if order is None or not np.isfinite(order).all() or np.ptp(order) == 0.0:
        return {}
    return {FIRST_STOP.name: float(order.min()), LAST_STOP.name: float(order.max())}


def _place_in_order(context: EffectContext, law: Law) -> Array:
    """Place in the order of measurement (n,), 0 for the first stop to 1 for the last, or where it is unknown."""
    first, last = law.constants[FIRST_STOP.name], law.constants[LAST_STOP.name]
    return np.clip((with_default(context.conditions.order, last, len(context)) - first) / (last - first), 0.0, 1.0)


def _twist(name: str, context: EffectContext, along: Array, suffix: str = "") -> list[EffectColumn]:
    """The six components of a base motion, times a function of time (n,)."""
    moved = context.base_twists * along[:, None]
    return [
        shift_column(f"{name}_{component}{suffix}", unit, ActsOn.BASE, moved[k], -_MOST_MOTION, _MOST_MOTION)
        for k, (component, unit) in enumerate(_COMPONENTS)
    ]
