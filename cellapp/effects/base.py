"""A base that moves while the arm is measured, slowly or at once."""

from __future__ import annotations

from collections.abc import Collection

from cellapp.effects.effect import EffectColumn, EffectContext, Law, shift_column, unknown_law
from cellapp.effects.history import (
    after_onset,
    linear,
    no_onset,
    onset_laws,
    span,
    times_known,
    warm_up,
    warm_up_laws,
)
from cellapp.kinematics.transforms import Array

_WAYS = (("x", "m"), ("y", "m"), ("z", "m"), ("turn_x", "rad"), ("turn_y", "rad"), ("turn_z", "rad"))


class BaseDrift:
    """The base wanders: its frame is twisted by ``(d, w) f(t)``, shifts d [m] along, turns w [rad] about its x, y, z.

    Laws
    ----
    linear
        f from 0 at the beginning of the run to 1 at its end.
    warm_up
        ``f = 1 - exp(-(t - first) / tau)``, tau is searched.
    quadratic
        Linear, and a bow ``4 f (1 - f)`` of its own size and direction (names end in ``_bow``).

    A tracker that drifts looks exactly the same in one arm's readings: fixed nests, or the other arm, tell them apart.
    Size: 10 to 50 um (estimate); a tracker of this class errs by tenths of a millimetre in its first two hours
    (published), 10 to 40 um after (estimate). 49 % visible when linear, 22 % when warming up. Look-alikes: thermal
    growth, a step of the base, joint drift.
    """

    slug = "base_drift"
    title = "drift of the base (drift of the tracker looks the same)"
    look_alikes: tuple[str, ...] = ("base_step", "thermal_growth", "joint_drift")
    variables = frozenset({"time"})

    def untestable(self, context: EffectContext) -> str:
        """Needs times."""
        return "" if times_known(context) else "no times"

    def laws(self, context: EffectContext) -> list[Law]:
        """Linear; warming up; quadratic."""
        if not times_known(context):
            return []
        return [Law("linear", span(context)), *warm_up_laws(context), Law("quadratic", span(context))]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Six columns, twelve for the quadratic law; the end of the run where the time is unknown."""
        if law.name == "warm_up":
            return _twist("base_drift", context, warm_up(context, law))
        if law.name not in ("", "linear", "quadratic"):
            raise unknown_law(self.slug, law)
        along = linear(context, law)
        columns = _twist("base_drift", context, along)
        if law.name == "quadratic":
            columns += _twist("base_drift", context, 4.0 * along * (1.0 - along), "_bow")
        return columns


class BaseStep:
    """The base slips: twist ``(d, w)`` of the base frame after an onset, shifts d [m] and turns w [rad] as for drift.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. A tracker that was
    knocked looks exactly the same in one arm's readings. Size: 10 to 50 um (estimate); 61 % visible. Look-alikes: drift
    of the base (0.5 to 0.6), slip of the target.
    """

    slug = "base_step"
    title = "step of the base (a step of the tracker looks the same)"
    look_alikes: tuple[str, ...] = ("base_drift", "thermal_growth", "target_slip", "joint_drift")
    variables = frozenset({"time"})

    def untestable(self, context: EffectContext) -> str:
        """Needs times."""
        return no_onset(context)

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each onset."""
        return onset_laws(context)

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Six columns; after the onset where the time is unknown."""
        if law.name != "onset":
            raise unknown_law(self.slug, law)
        return _twist("base_step", context, after_onset(context, law))


def _twist(name: str, context: EffectContext, along: Array, suffix: str = "") -> list[EffectColumn]:
    """All six ways in which a base can move, times a function of time (n,)."""
    moved = context.base_twists * along[:, None]
    return [
        shift_column(f"{name}_{way}{suffix}", unit, "base", moved[k], -1e-2, 1e-2)
        for k, (way, unit) in enumerate(_WAYS)
    ]
