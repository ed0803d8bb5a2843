"""A base that moves during the run, slowly or suddenly."""

from __future__ import annotations

from collections.abc import Collection

from cellapp.effects.column import Channel, EffectColumn, shift_column
from cellapp.effects.context import EffectContext
from cellapp.effects.data_driven import Quantity
from cellapp.effects.effect import Effect
from cellapp.effects.law import DriverVariable, Law, LawForm
from cellapp.effects.modulation import FreeDriver
from cellapp.effects.time_functions import (
    FIRST,
    LAST,
    LINEAR_FORM,
    ONSET_FORM,
    WARM_UP_FORM,
    after_onset,
    missing_for_onset,
    onset_laws,
    run_fraction,
    run_span,
    times_known,
    warm_up,
    warm_up_laws,
)
from cellapp.kinematics.transforms import Array

_COMPONENTS = (("x", "m"), ("y", "m"), ("z", "m"), ("turn_x", "rad"), ("turn_y", "rad"), ("turn_z", "rad"))
_MOST_MOTION = 1e-2
"""Bound of each component [m, rad]: a base that moved by a centimetre must be registered again."""
QUADRATIC = LawForm("quadratic", "over the run, with a bow", (FIRST, LAST))


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

    Drift of the tracker is the same in one arm's readings: fixed nests, or the other arm, distinguish them.
    Size: 10 to 50 um (estimate); a tracker of this class errs by tenths of a millimetre in its first two hours
    (published), 10 to 40 um after (estimate). 49 % visible when linear, 22 % when warming up. Look-alikes: thermal
    growth, a step of the base, joint drift.
    """

    slug = "base_drift"
    title = "drift of the base (drift of the tracker looks the same)"
    look_alikes = ("base_step", "thermal_growth", "joint_drift")
    variables = frozenset({DriverVariable.TIME})
    forms = (LINEAR_FORM, WARM_UP_FORM, QUADRATIC)
    free_drivers = (FreeDriver(Quantity.TIME),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs times."""
        return "" if times_known(context) else "no times"

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
        along = run_fraction(context, law)
        columns = _twist(self.slug, context, along)
        if law.form == QUADRATIC:
            columns += _twist(self.slug, context, 4.0 * along * (1.0 - along), "_bow")
        return columns


class BaseStep(Effect):
    """The base slips: twist ``(d, w)`` of the base frame after an onset, shift d [m] and rotation w [rad] as for drift.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. A tracker that was
    displaced looks the same in one arm's readings. Size: 10 to 50 um (estimate); 61 % visible. Look-alikes: drift of
    the base (0.5 to 0.6), slip of the target.
    """

    slug = "base_step"
    title = "step of the base (a step of the tracker looks the same)"
    look_alikes = ("base_drift", "thermal_growth", "target_slip", "joint_drift")
    variables = frozenset({DriverVariable.TIME})
    forms = (ONSET_FORM,)
    free_drivers = (FreeDriver(Quantity.TIME),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs times."""
        return missing_for_onset(context)

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each onset."""
        return onset_laws(context)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Six columns; after the onset where the time is unknown."""
        return _twist(self.slug, context, after_onset(context, law))


def _twist(name: str, context: EffectContext, along: Array, suffix: str = "") -> list[EffectColumn]:
    """The six components of a base motion, times a function of time (n,)."""
    moved = context.base_twists * along[:, None]
    return [
        shift_column(f"{name}_{component}{suffix}", unit, Channel.BASE, moved[k], -_MOST_MOTION, _MOST_MOTION)
        for k, (component, unit) in enumerate(_COMPONENTS)
    ]
