"""What heat does to an arm: links grow, joint zeros wander."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, joint_column, shift_column, unknown_law, varies
from cellapp.effects.history import filled, lagged, linear, span, times_known, warm_up, warm_up_laws
from cellapp.kinematics.transforms import Array

LAGS = (150.0, 400.0, 900.0, 2000.0, 4500.0)
"""With which links may follow their joints [s]."""
_MOST_GROWTH = 4e-5
"""No metal of which arms are made grows more [1/K]: aluminium 23e-6, magnesium 26e-6."""
_NOTICEABLE = 0.1
"""A link shorter than this share of the longest is not judged by itself."""


class ThermalGrowth:
    """Every length of the arm grows: ``da_i = alpha a_i f_i``, ``dd_i = alpha d_i f_i``.

    Laws, each for the whole arm (one column) or link by link (name ends in ``_links``)
    ----
    air, air_links
        ``f = T - T_mean`` of the air [K], alpha in 1/K.
    joints, joints_links
        A link has the mean temperature of the joints at its two ends, against its own mean of the run [K].
    conduction, conduction_links
        A link follows, with a lag that is searched, the air and how much warmer than the air the joints at its ends
        are, each with its own alpha [1/K]. Joint housings grow along their axes with their own temperature [m/K].
    warm_up, warm_up_links
        ``f = 1 - exp(-(t - first) / tau)``, alpha the whole strain [m/m]; tau is searched. Either sign: a cell that is
        switched on late warms up, one that was at work before cools down.

    Size: aluminium 23e-6 1/K times 0.61 m times 5 to 10 K are 70 to 140 um a link (computed); drift of an IRB1200 was
    removed to 90 % by a temperature model (published). Only 27 % is visible, as the constant part is a link length.
    Visible with stretched and folded stops all through the run. Look-alikes: drift of the base (0.4 to 0.6), joint
    drift; uniform growth at one moment is a scale of the tracker.
    """

    slug = "thermal_growth"
    title = "thermal growth of links"
    look_alikes: tuple[str, ...] = ("base_drift", "joint_drift", "base_step", "tracker_scale")
    variables = frozenset({"temperature", "time", "q"})

    def untestable(self, context: EffectContext) -> str:
        """Needs temperatures or times."""
        known = context.known
        if varies(known.air_c) or varies(known.joints_c) or times_known(context):
            return ""
        return "no temperatures and no times"

    def laws(self, context: EffectContext) -> list[Law]:
        """Those whose temperatures or times are known."""
        known, laws = context.known, list[Law]()
        if known.air_c is not None and varies(known.air_c):
            mean = {"mean_c": float(known.air_c.mean())}
            laws += [Law("air", mean), Law("air_links", mean)]
        if known.joints_c is not None and varies(known.joints_c):
            means = joint_means(known.joints_c)
            laws += [Law("joints", means), Law("joints_links", means)]
        if known.record is not None and times_known(context) and varies(known.joints_c):
            assert known.joints_c is not None
            means = joint_means(known.joints_c)
            air = known.air_c if known.air_c is not None and varies(known.air_c) else known.joints_c.mean(axis=1)
            constants = {**means, "mean_c": float(np.nanmean(air))}
            laws += [
                Law(name, {**constants, "lag_s": lag}, len(LAGS))
                for name in ("conduction", "conduction_links")
                for lag in LAGS
            ]
        if times_known(context):
            laws += [*warm_up_laws(context, "warm_up"), *warm_up_laws(context, "warm_up_links")]
        return laws

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column, or one for each link of noticeable length; 0 at the run's mean where no temperature is known."""
        source = law.name.removesuffix("_links")
        if source == "conduction":
            return self._conduction(context, law, wanted)
        if source == "air":
            warmer = np.tile(above_mean(context.known.air_c, law, len(context))[:, None], context.joints)
        elif source == "joints":
            joints = above_joint_means(context, law)
            warmer = (joints + np.column_stack([joints[:, 1:], joints[:, -1]])) / 2.0
        elif source == "warm_up":
            warmer = np.tile(warm_up(context, law)[:, None], context.joints)
        else:
            raise unknown_law(self.slug, law)
        unit, lower, upper = ("m/m", -2e-3, 2e-3) if source == "warm_up" else ("1/K", 0.0, _MOST_GROWTH)
        grown = context.link_growth * warmer.T[:, :, None]
        if law.name == source:
            return [shift_column("growth", unit, "all links", grown.sum(axis=0), lower, upper)]
        lengths = np.hypot(context.geometry.rows[:, 1], context.geometry.rows[:, 2])
        return [
            shift_column(f"growth{i + 1}", unit, f"link {i + 1}", grown[i], lower, upper)
            for i in range(context.joints)
            if lengths[i] >= _NOTICEABLE * lengths.max() or (wanted is not None and f"growth{i + 1}" in wanted)
        ]

    @staticmethod
    def _conduction(context: EffectContext, law: Law, wanted: Collection[str] | None) -> list[EffectColumn]:
        """Columns of the lagged laws, each a block of its own; without record or time, as if all had long settled."""
        known, n = context.known, len(context)
        joints = above_joint_means(context, law)
        air = above_mean(known.air_c, law, n)
        warmer = joints - air[:, None]
        ends = (warmer + np.column_stack([warmer[:, 1:], warmer[:, -1]])) / 2.0
        if known.record is not None and known.time_s is not None:
            record = known.record
            mean = np.array([law.constants[f"mean_c{j + 1}"] for j in range(context.joints)])
            air_then = record.air_c - law.constants["mean_c"]
            warmer_then = record.joints_c - mean - air_then[:, None]
            ends_then = (warmer_then + np.column_stack([warmer_then[:, 1:], warmer_then[:, -1]])) / 2.0
            behind = lagged(np.column_stack([ends_then, air_then]), record.time_s, law.constants["lag_s"])
            order = np.argsort(record.time_s, kind="stable")
            timed = np.isfinite(known.time_s)
            at = known.time_s[timed]
            now = np.column_stack([np.interp(at, record.time_s[order], one[order]) for one in behind.T])
            ends[timed], air[timed] = now[:, :-1], now[:, -1]
        by_joints = context.link_growth * ends.T[:, :, None]
        by_air = context.link_growth.sum(axis=0) * air[:, None]
        rotations = context.frames[0]
        housing = np.einsum("inc,ni->nc", rotations[:-1, :, :, 2], joints)
        columns = [
            shift_column("growth_air", "1/K", "all links", by_air, 0.0, _MOST_GROWTH, "air"),
            shift_column("growth_housings", "m/K", "all joints", housing, 0.0, 2e-5, "housings"),
        ]
        if law.name == "conduction":
            return [
                shift_column("growth_joints", "1/K", "all links", by_joints.sum(axis=0), 0.0, _MOST_GROWTH, "joints"),
                *columns,
            ]
        lengths = np.hypot(context.geometry.rows[:, 1], context.geometry.rows[:, 2])
        return [
            *(
                shift_column(f"growth{i + 1}", "1/K", f"link {i + 1}", by_joints[i], 0.0, _MOST_GROWTH)
                for i in range(context.joints)
                if lengths[i] >= _NOTICEABLE * lengths.max() or (wanted is not None and f"growth{i + 1}" in wanted)
            ),
            *columns,
        ]


class JointDrift:
    """Joint zeros wander: ``dq_j = k_j f(t)``, or with the joint's own temperature.

    Laws
    ----
    linear
        f from 0 at the beginning of the run to 1 at its end, k in rad.
    warm_up
        ``f = 1 - exp(-(t - first) / tau)``, tau is searched, k in rad.
    joint_temperature
        ``f_j = T_j - T_j,mean`` [K], k in rad/K.

    Size: 20 to 50 urad, 15 to 70 um at a UR10's flange (estimate, not sourced). Visible where poses and time are not
    tied. Look-alikes: drift of the base, thermal growth. Temperatures of the joints, and cooling down, tell them apart.
    """

    slug = "joint_drift"
    title = "drift of joint zeros"
    look_alikes: tuple[str, ...] = ("base_drift", "thermal_growth", "base_step")
    variables = frozenset({"time", "temperature"})

    def untestable(self, context: EffectContext) -> str:
        """Needs times or temperatures of the joints."""
        if times_known(context) or varies(context.known.joints_c):
            return ""
        return "no times and no joint temperatures"

    def laws(self, context: EffectContext) -> list[Law]:
        """Those whose times or temperatures are known."""
        joints_c = context.known.joints_c
        laws = [Law("linear", span(context)), *warm_up_laws(context)] if times_known(context) else []
        if joints_c is not None and varies(joints_c):
            laws.append(Law("joint_temperature", joint_means(joints_c)))
        return laws

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint; the end of the run, or its mean temperature, where nobody knows."""
        unit, largest = "rad", 5e-3
        if law.name == "linear":
            drifted = np.tile(linear(context, law)[:, None], context.joints)
        elif law.name == "warm_up":
            drifted = np.tile(warm_up(context, law)[:, None], context.joints)
        elif law.name == "joint_temperature":
            drifted, unit, largest = above_joint_means(context, law), "rad/K", 5e-4
        else:
            raise unknown_law(self.slug, law)
        return [joint_column(f"drift{j + 1}", unit, j, drifted[:, j], -largest, largest) for j in range(context.joints)]


def above_mean(values: Array | None, law: Law, rows: int) -> Array:
    """Air temperature above the run's mean (n,) [K], 0 where unknown."""
    mean = law.constants["mean_c"]
    return filled(values, mean, rows) - mean


def joint_means(joints_c: Array) -> dict[str, float]:
    """``mean_c1`` ...: mean temperature of each joint in the run [degC]."""
    return {f"mean_c{j}": mean for j, mean in enumerate(joints_c.mean(axis=0).tolist(), 1)}


def above_joint_means(context: EffectContext, law: Law) -> Array:
    """Temperatures of the joints above their means of the run (n, N) [K], 0 where unknown."""
    means = np.array([law.constants[f"mean_c{j + 1}"] for j in range(context.joints)])
    return filled(context.known.joints_c, means, len(context)) - means
