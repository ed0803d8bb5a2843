"""Effects of heat on an arm: growth of links, drift of joint zeros."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, joint_column, shift_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, ImpossibleValues, Meaning
from cellapp.robot.effects.law import (
    AMPLITUDE,
    FIXED,
    SCALED,
    Constant,
    InputVariable,
    Law,
    LawForm,
    SmoothLaw,
    with_prior_sd,
)
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.effects.time_functions import (
    FIRST,
    LAST,
    LINEAR_FORM,
    WANDERING,
    WARM_UP_FORM,
    WARM_UP_TIME,
    half_cycles,
    lagged,
    run_fraction,
    run_span,
    times_known,
    warm_up,
    warm_up_laws,
    with_default,
)
from cellapp.robot.kinematics.transforms import Array, rows_at

LAGS = (150.0, 400.0, 900.0, 2000.0, 4500.0)
"""Lags of links behind their joints to try [s]: conduction along tubes of this size takes minutes to an hour."""
_MOST_GROWTH = 4e-5
"""No metal of which arms are made grows more [1/K]: aluminium 23e-6, magnesium 26e-6."""
ALUMINIUM = 23e-6
"""Thermal expansion [1/K] of the links of most arms; magnesium and steel are at 26e-6 and 12e-6."""
_MOST_STRAIN = 2e-3
"""Bound of the whole strain of a warm-up [m/m]: aluminium over 90 K."""
_MOST_HOUSING = 2e-5
"""Bound of a joint housing's growth along its axis [m/K]: half a metre of aluminium."""
_MOST_DRIFT = 5e-3
"""Bound of the drift of a joint zero [rad]: a hundred times the estimated one."""
_MOST_DRIFT_PER_KELVIN = 5e-4
"""As above, over 10 K [rad/K]."""
_NOTICEABLE = 0.1
"""A link shorter than this fraction of the longest has no growth of its own."""

MEAN_AIR = Constant("mean_c", "degC", FIXED)
"""Mean air temperature of the run: growth up to there is part of the geometry."""
MEAN_JOINT = Constant("mean_c", "degC", FIXED, per_joint=True)
"""Mean temperature of each joint in the run."""
LAG = Constant("lag_s", "s", SCALED, "lag {} min", factor=1.0 / 60.0)

_OF_AIR = frozenset({InputVariable.AIR_TEMPERATURE})
_OF_JOINTS = frozenset({InputVariable.JOINT_TEMPERATURE})
_OF_TIME = frozenset({InputVariable.TIME})
_LAGGED = (LAG, MEAN_AIR, MEAN_JOINT)
_WARM_UP = (FIRST, LAST, WARM_UP_TIME)
AIR = LawForm("air", "with the air temperature, all links alike", (MEAN_AIR,), _OF_AIR)
AIR_LINKS = LawForm("air_links", "with the air temperature, link by link", (MEAN_AIR,), _OF_AIR)
JOINTS = LawForm("joints", "with the joints' temperatures, all links alike", (MEAN_JOINT,), _OF_JOINTS)
JOINTS_LINKS = LawForm("joints_links", "with the joints' temperatures, link by link", (MEAN_JOINT,), _OF_JOINTS)
CONDUCTION = LawForm(
    "conduction", "links follow air and joints with a lag, all alike", _LAGGED, _OF_AIR | _OF_JOINTS | _OF_TIME
)
CONDUCTION_LINKS = LawForm(
    "conduction_links", "links follow air and joints with a lag, link by link", _LAGGED, _OF_AIR | _OF_JOINTS | _OF_TIME
)
WARM_UP = LawForm("warm_up", "warming up, all links alike", _WARM_UP, _OF_TIME)
WARM_UP_LINKS = LawForm("warm_up_links", "warming up, link by link", _WARM_UP, _OF_TIME)
_BY_LINK = (AIR_LINKS, JOINTS_LINKS, CONDUCTION_LINKS, WARM_UP_LINKS)
ZERO_BY_TEMPERATURE = LawForm("joint_temperature", "with the joint's temperature", (MEAN_JOINT,), _OF_JOINTS)


class ThermalGrowth(Effect):
    """Every length of the arm grows: ``da_i = alpha a_i f_i``, ``dd_i = alpha d_i f_i``.

    Laws, each for the whole arm (one column) or link by link (name ends in ``_links``)
    ----
    air, air_links
        ``f = T - T_mean`` of the air [K], alpha in 1/K.
    joints, joints_links
        A link has the mean temperature of the joints at its two ends, relative to its own mean of the run [K].
    conduction, conduction_links
        A link follows, with a lag that is searched, the air and how much warmer than the air the joints at its ends
        are, each with its own alpha [1/K]. Joint housings grow along their axes with their own temperature [m/K].
    warm_up, warm_up_links
        ``f = 1 - exp(-(t - first) / tau)``, alpha the whole strain [m/m]; tau is searched. Either sign: a cell that is
        switched on late warms up, one that was at work before cools down.

    Size: aluminium 23e-6 1/K times 0.61 m times 5 to 10 K are 70 to 140 µm a link (computed); drift of an IRB1200 was
    removed to 90 % by a temperature model (published). Only 27 % is visible, as the constant part is a link length.
    Visible with stretched and folded stops throughout the run. Confounded: drift of the base (0.4 to 0.6), joint
    drift; uniform growth at one moment is a scale of the tracker.
    """

    slug = "thermal_growth"
    lengthens = True
    title = "thermal growth of links"
    meaning = Meaning.of(
        """cause: The links grow with temperature, from their own joints and from the air.
        size (computed): aluminium, 23e-6 1/K, over 0.61 m and 5 to 10 K: 70 to 140 µm a link
        check: Let the arm move for an hour before calibrating, and hold the hall's temperature.
        check: Check for sun, heaters and air outlets that reach the arm.
        check: Log joint or air temperatures, and keep compensating with them.
        settle: Measure one stretched and one folded reference pose, and fixed nests, every 20 stops.
        settle: Continue while the cell cools down."""
    )
    confounded = ("base_drift", "joint_drift", "base_step", "tracker_scale")
    impossible = ImpossibleValues(
        sign="links that shrink as they warm up",
        sign_check="check which temperatures the readings state",
        limit="the expansion of aluminium",
        limit_size=ALUMINIUM,
        size_check="check the unit of the temperatures and where they were taken",
    )
    variables = _OF_AIR | _OF_JOINTS | _OF_TIME | {InputVariable.JOINT_ANGLE}
    forms = (AIR, AIR_LINKS, JOINTS, JOINTS_LINKS, CONDUCTION, CONDUCTION_LINKS, WARM_UP, WARM_UP_LINKS)
    discrepancy_inputs = (TermInput(Quantity.TIME), TermInput(Quantity.TEMPERATURE))

    def missing_data(self, context: EffectContext) -> str:
        """Needs temperatures or times."""
        conditions = context.conditions
        if varies(conditions.air_c) or varies(conditions.joints_c) or times_known(context):
            return ""
        return "no temperatures and no times"

    def laws(self, context: EffectContext) -> list[Law]:
        """Those whose temperatures or times are known."""
        air_c, joints_c = context.conditions.air_c, context.conditions.joints_c
        laws = list[Law]()
        if air_c is not None and varies(air_c):
            mean = {MEAN_AIR.name: float(air_c.mean())}
            laws += [AIR.law(mean), AIR_LINKS.law(mean)]
        if joints_c is not None and varies(joints_c):
            means = joint_means(joints_c)
            laws += [JOINTS.law(means), JOINTS_LINKS.law(means)]
            if context.conditions.record is not None and times_known(context):
                air = air_c if air_c is not None and varies(air_c) else joints_c.mean(axis=1)
                constants = {**means, MEAN_AIR.name: float(np.nanmean(air))}
                laws += [
                    form.law({**constants, LAG.name: lag}, len(LAGS))
                    for form in (CONDUCTION, CONDUCTION_LINKS)
                    for lag in LAGS
                ]
        if times_known(context):
            laws += [*warm_up_laws(context, WARM_UP), *warm_up_laws(context, WARM_UP_LINKS)]
        return laws

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column, or one for each link of noticeable length; 0, as at the run's mean, where unknown."""
        if law.form in (CONDUCTION, CONDUCTION_LINKS):
            return _conduction(context, law, names)
        unit, lower, upper = "1/K", 0.0, _MOST_GROWTH
        if law.form in (AIR, AIR_LINKS):
            warmer = np.tile(above_mean_air(context, law)[:, None], context.joints)
        elif law.form in (JOINTS, JOINTS_LINKS):
            warmer = _at_links(_above_mean_joints(context, law))
        else:
            warmer = np.tile(warm_up(context, law)[:, None], context.joints)
            unit, lower, upper = "m/m", -_MOST_STRAIN, _MOST_STRAIN
        grown = context.link_growth * warmer.T[:, :, None]
        if law.form in _BY_LINK:
            return _link_by_link(context, grown, unit, lower, upper, names)
        return [shift_column("growth", unit, ActsOn.LINK, grown.sum(axis=0), lower, upper)]


def _conduction(context: EffectContext, law: Law, names: Collection[str] | None) -> list[EffectColumn]:
    """Columns of the lagged laws, each a block of its own; steady state where record or time is unknown."""
    joints = _above_mean_joints(context, law)
    ends, air = _lagged_temperatures(context, law, joints, above_mean_air(context, law))
    by_joints = context.link_growth * ends.T[:, :, None]
    by_air = context.link_growth.sum(axis=0) * air[:, None]
    housing = context.moved(np.einsum("inc,ni->nc", context.frames[0][:-1, :, :, 2], joints))
    columns = [
        shift_column("growth_air", "1/K", ActsOn.LINK, by_air, 0.0, _MOST_GROWTH, "air"),
        shift_column("growth_housings", "m/K", ActsOn.AXIS, housing, 0.0, _MOST_HOUSING, "housings"),
    ]
    if law.form == CONDUCTION_LINKS:
        return [*_link_by_link(context, by_joints, "1/K", 0.0, _MOST_GROWTH, names), *columns]
    together = by_joints.sum(axis=0)
    return [shift_column("growth_joints", "1/K", ActsOn.LINK, together, 0.0, _MOST_GROWTH, "joints"), *columns]


def _lagged_temperatures(context: EffectContext, law: Law, joints: Array, air: Array) -> tuple[Array, Array]:
    """Temperatures that links follow with a lag [K]: their ends' joints above the air (n, N), and the air (n,).

    Without lag where the record of the run, or the time of a stop, is unknown.
    """
    conditions = context.conditions
    ends = _at_links(joints - air[:, None])
    if conditions.record is None or conditions.time_s is None:
        return ends, air
    record = conditions.record
    air_then = record.air_c - law.constants[MEAN_AIR.name]
    ends_then = _at_links(record.joints_c - _means(context, law) - air_then[:, None])
    behind = lagged(np.column_stack([ends_then, air_then]), record.time_s, law.constants[LAG.name])
    order = np.argsort(record.time_s, kind="stable")
    timed = np.isfinite(conditions.time_s)
    at = conditions.time_s[timed]
    now = rows_at(at, record.time_s[order], behind[order])
    ends[timed], air[timed] = now[:, :-1], now[:, -1]
    return ends, air


def _link_by_link(
    context: EffectContext, grown: Array, unit: str, lower: float, upper: float, names: Collection[str] | None
) -> list[EffectColumn]:
    """One column for each link of noticeable length, from shifts (N, n, 3)."""
    shortest = _NOTICEABLE * context.link_lengths.max()
    return [
        shift_column(f"growth{i + 1}", unit, ActsOn.LINK, grown[i], lower, upper, index=i)
        for i in range(context.joints)
        if context.link_lengths[i] >= shortest or (names is not None and f"growth{i + 1}" in names)
    ]


class JointDrift(Effect):
    """Joint zeros drift: ``dq_j = k_j f(t)``, or with the joint's own temperature.

    Laws
    ----
    linear
        f from 0 at the beginning of the run to 1 at its end, k in rad.
    warm_up
        ``f = 1 - exp(-(t - first) / tau)``, tau is searched, k in rad.
    joint_temperature
        ``f_j = T_j - T_j,mean`` [K], k in rad/K.
    smooth
        Half cycles ``cos(i pi f)`` of each joint, i = 1 to 12, small by prior, the more so the faster (1 / i).

    Size: 20 to 50 µrad, 15 to 70 µm at a UR10's flange (estimate, not sourced). Visible where poses and time are not
    correlated. Confounded: drift of the base, thermal growth. Joint temperatures, and cooling down, distinguish them.
    """

    slug = "joint_drift"
    shifts_zero = True
    title = "drift of joint zeros"
    meaning = Meaning.of(
        """cause: The zero of {place} drifts, mostly as its housing or encoder warms up.
        size (estimate): 20 to 50 µrad, 15 to 70 µm at the flange of a UR10
        check: Warm the arm up before measuring.
        check: Compare the temperature of {place} with its neighbours: a hot joint has too much friction or a dragging
          brake.
        check: After a repair of {place}, check the seat of the encoder.
        settle: Measure a reference pose every 20 stops, while the cell cools down, too.
        settle: Measure fixed nests every 20 stops: a drift of the tracker shows in all of them."""
    )
    confounded = ("base_drift", "thermal_growth", "base_step")
    variables = _OF_TIME | _OF_AIR | _OF_JOINTS
    forms = (LINEAR_FORM, WARM_UP_FORM, ZERO_BY_TEMPERATURE, WANDERING)
    discrepancy_inputs = (TermInput(Quantity.TIME), TermInput(Quantity.TEMPERATURE))

    def missing_data(self, context: EffectContext) -> str:
        """Needs times or temperatures of the joints."""
        if times_known(context) or varies(context.conditions.joints_c):
            return ""
        return "no times and no joint temperatures"

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Over the time of the run."""
        return [SmoothLaw(WANDERING.name, 2e-5, run_span(context))] if times_known(context) else []

    def laws(self, context: EffectContext) -> list[Law]:
        """Those whose times or temperatures are known."""
        joints_c = context.conditions.joints_c
        laws = [LINEAR_FORM.law(run_span(context)), *warm_up_laws(context)] if times_known(context) else []
        if joints_c is not None and varies(joints_c):
            laws.append(ZERO_BY_TEMPERATURE.law(joint_means(joints_c)))
        return laws

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint, twelve where it wanders; the end of the run, or its mean temperature, where unknown."""
        unit, largest = "rad", _MOST_DRIFT
        if law.form == WANDERING:
            amplitude = law.constants[AMPLITUDE.name]
            return [
                with_prior_sd(joint_column(f"drift{j + 1}_{k}", unit, j, wave, -largest, largest), amplitude / k)
                for k, wave in half_cycles(run_fraction(context, law)).items()
                for j in range(context.joints)
            ]
        if law.form == ZERO_BY_TEMPERATURE:
            drifted, unit, largest = _above_mean_joints(context, law), "rad/K", _MOST_DRIFT_PER_KELVIN
        else:
            along = run_fraction(context, law) if law.form == LINEAR_FORM else warm_up(context, law)
            drifted = np.tile(along[:, None], context.joints)
        return [joint_column(f"drift{j + 1}", unit, j, drifted[:, j], -largest, largest) for j in range(context.joints)]


def joint_means(joints_c: Array) -> dict[str, float]:
    """Constants ``MEAN_JOINT`` of a run's joint temperatures (n, N) [degC]."""
    return {MEAN_JOINT.key(j): mean for j, mean in enumerate(joints_c.mean(axis=0).tolist())}


def _means(context: EffectContext, law: Law) -> Array:
    """Mean temperature of each joint in the run (N,) [degC]."""
    return np.array([law.constants[MEAN_JOINT.key(j)] for j in range(context.joints)])


def above_mean_air(context: EffectContext, law: Law) -> Array:
    """Air temperature relative to the run's mean (n,) [K], 0 where unknown."""
    mean = law.constants[MEAN_AIR.name]
    return with_default(context.conditions.air_c, mean, len(context)) - mean


def _above_mean_joints(context: EffectContext, law: Law) -> Array:
    """Joint temperatures relative to their means of the run (n, N) [K], 0 where unknown."""
    means = _means(context, law)
    return np.asarray(with_default(context.conditions.joints_c, means, len(context)) - means)


def _at_links(joints: Array) -> Array:
    """Mean of the joints at both ends of each link (n, N); the last link has one joint."""
    return np.asarray((joints + np.column_stack([joints[:, 1:], joints[:, -1]])) / 2.0)
