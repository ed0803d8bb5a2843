"""What no named effect explains, in words that need no name: which channel depends on which one or two variables.

A term is a law named ``channel|variable`` or ``channel|variable|variable``.

Channels: ``joint j`` (an offset of the joint), ``base shift`` and ``tool`` (of the base, of the SMR in the flange, in
any direction), ``base shift x|y|z``, ``base turn x|y`` (about z it is an offset of joint 1), ``tool x|y|z``, ``tracker
radial`` (along the beam), ``tracker azimuth`` and ``tracker elevation`` (errors of its angles).

Variables: ``q1`` ..., ``other q1`` ... (of the other arm), ``time``, ``torque1`` ..., ``step1`` ..., ``dwell``,
``payload``, ``temperature`` (of the air), ``range``, ``azimuth``, ``elevation`` (of the SMR as the tracker sees it),
``incidence`` (angle between the SMR's axis and the way back to the tracker).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from itertools import combinations

import numpy as np
from numpy.polynomial.legendre import legvander

from cellapp.effects.effect import (
    EffectColumn,
    EffectContext,
    Law,
    joint_column,
    shift_column,
    unknown_law,
    varies,
)
from cellapp.effects.history import filled, span, times_known
from cellapp.kinematics.transforms import Array

ORDER = 4
TIME_ORDER = 20
PAIR_ORDER = 3
_PERIODS = 48
_ROUNDING = 1e-6
_LARGEST = 1e-2
_TWISTS = tuple(f"base {kind} {axis}" for kind in ("shift", "turn") for axis in "xyz")
_TOOLS = ("tool x", "tool y", "tool z")
_TRACKER = ("tracker radial", "tracker azimuth", "tracker elevation")
_VECTORS = {"base shift": _TWISTS[:3], "tool": _TOOLS}


class Unknown:
    """A data-driven term ``sum_k b_k f_k(v)`` in one channel, or ``sum_k b_k f_k(v, w)``; b in rad or m.

    Of a joint angle v: cosine and sine of v to 4 v. Of time: linear, and cosine of 1 to 20 half cycles over the run, or
    with ``period_s`` cosine and sine of one period. Of
    anything else: Legendre polynomials to order 4 on the range it had in the run, held beyond it. Of two variables: all
    such functions of total order up to 3. Constants: ``order``, ``low``, ``high`` and ``typical`` (what is taken where
    nobody knows: the end of the run for time, no step, the run's median dwell, its mean temperature, the nominal
    payload), ``center`` of an azimuth; with a ``2`` behind for the second variable.

    It is not scanned like the named effects; ``dictionary`` and ``pairs`` list what there is to try. Sizes, bounds and
    look-alikes: whatever the data say; a term here imitates every named effect that has its channel and variable.
    """

    slug = "unknown"
    title = "unknown effect"
    look_alikes: tuple[str, ...] = ()
    variables: frozenset[str] = frozenset()

    def untestable(self, context: EffectContext) -> str:
        """Some variable is always there."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """None: ``dictionary`` and ``pairs`` have them."""
        return []

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a function, all in one block."""
        channel, *names = law.name.split("|")
        if not 1 <= len(names) <= 2 or channel not in channels(context.joints):
            raise unknown_law(self.slug, law)
        functions = _functions(context, law, names)
        prefix = channel.replace(" ", "_")
        if channel.startswith("joint "):
            joint = int(channel.removeprefix("joint ")) - 1
            return [
                joint_column(f"{prefix}.{name}", "rad", joint, values, -_LARGEST, _LARGEST, channel)
                for name, values in functions.items()
            ]
        where = channel.split(" ", 1)[0]
        columns = []
        for one in _VECTORS.get(channel, (channel,)):
            unit, moved = _direction(context, one)
            label = one.replace(" ", "_")
            columns += [
                shift_column(f"{label}.{name}", unit, where, values[:, None] * moved, -_LARGEST, _LARGEST, channel)
                for name, values in functions.items()
            ]
        return columns


def channels(joints: int) -> tuple[str, ...]:
    """All channels of an arm; a turn of the base about its z is an offset of joint 1."""
    return (*(f"joint {j}" for j in range(1, joints + 1)), *_VECTORS, *_TWISTS[:-1], *_TOOLS, *_TRACKER)


def variables(context: EffectContext) -> tuple[str, ...]:
    """The variables that are known at all stops and vary."""
    known, joints = context.known, range(context.joints)
    found = [f"q{j + 1}" for j in joints if np.ptp(context.q[:, j]) > 0.0]
    if known.other_q is not None and varies(known.other_q):
        found += [f"other q{k + 1}" for k in range(known.other_q.shape[1]) if np.ptp(known.other_q[:, k]) > 0.0]
    if times_known(context):
        found.append("time")
    found += [f"torque{j + 1}" for j in joints if np.ptp(context.torques[:, j]) > _ROUNDING]
    if varies(known.step):
        found += [f"step{j + 1}" for j in joints if np.ptp(context.step[:, j]) > 0.0]
    optional = (("dwell", known.dwell_s), ("payload", known.payload_kg), ("temperature", known.air_c))
    found += [name for name, values in optional if varies(values)]
    seen = ("range", "azimuth", "elevation", *(() if context.smr_normal is None else ("incidence",)))
    found += [name for name in seen if np.ptp(_raw(context, name)) > 1e-9]
    return tuple(found)


def dictionary(context: EffectContext) -> list[tuple[str, str, Law]]:
    """Channel, variable and law of every term of one variable that the data at hand allow.

    Whoever chooses among them pays for as many as there are: a law cannot know with how many others it was tried.
    """
    constants = {name: _constants(context, name) for name in variables(context)}
    # a straight line beside the curve: it is not led astray by a few stops far from the others
    terms = [
        (channel, name, Law(f"{channel}|{name}", {**constants[name], "order": 1.0}))
        for channel in channels(context.joints)
        for name in constants
        if not _is_angle(name) and name != "time" and constants[name]["order"] > 1.0
    ]
    terms += [
        (channel, name, Law(f"{channel}|{name}", constants[name]))
        for channel in channels(context.joints)
        for name in constants
    ]
    if "time" in constants:  # a sway of any one period: from two spans of the run to a dozen stops
        ends = constants["time"]
        run_s = ends["high"] - ends["low"]
        shortest = 12.0 * run_s / max(len(context), 24)
        for period in np.geomspace(2.0 * run_s, shortest, _PERIODS).tolist():
            sway = {**ends, "order": 1.0, "period_s": period}
            terms += [(channel, "time", Law(f"{channel}|time", sway)) for channel in channels(context.joints)]
    return terms


def pairs(context: EffectContext, channel: str | None = None, among: Collection[str] | None = None) -> list[Law]:
    """Laws of all terms of two variables in one channel, or in every channel.

    Both variables are of ``among``; where it is not given, of all that vary for one channel, and of the arm's own joint
    angles for every channel, as there would be thousands of terms.
    """
    chosen = channels(context.joints) if channel is None else (channel,)
    if among is None and channel is None:
        among = [name for name in variables(context) if name.startswith("q")]
    names = [name for name in variables(context) if among is None or name in among]
    constants = {name: _constants(context, name) for name in names}
    laws = []
    for first, second in combinations(names, 2):
        both = {**constants[first], **{f"{key}2": value for key, value in constants[second].items()}}
        for key in ("order", "order2"):
            both[key] = min(both[key], float(PAIR_ORDER))
        laws += [Law(f"{one}|{first}|{second}", both) for one in chosen]
    return laws


def values_of(context: EffectContext, variable: str) -> Array:
    """Values (n,) of a variable; NaN where nobody knows."""
    return _raw(context, variable)


def channel_directions(context: EffectContext, channel: str) -> list[Array]:
    """Shifts of the SMR (n, 3) [m, tracker frame] per unit of a channel that turns no joint, in each direction."""
    return [_direction(context, one)[1] for one in _VECTORS.get(channel, (channel,))]


def _is_angle(variable: str) -> bool:
    return variable.startswith(("q", "other q"))


def _raw(context: EffectContext, variable: str) -> Array:
    """Values (n,) of a variable; NaN where nobody knows."""
    known, nothing = context.known, np.full(len(context), np.nan)
    if variable.startswith("other q"):
        return nothing if known.other_q is None else known.other_q[:, int(variable[7:]) - 1]
    for name, values in (("torque", context.torques), ("step", context.step), ("q", context.q)):
        if variable.startswith(name):
            return np.asarray(values[:, int(variable.removeprefix(name)) - 1])
    if variable == "payload":
        return context.payload_kg
    if variable == "range":
        return context.beam[0]
    if variable in ("azimuth", "elevation"):
        return context.across[("azimuth", "elevation").index(variable)]
    if variable == "incidence":
        if context.smr_normal is None:
            return nothing
        back = -np.einsum("na,na->n", context.frames[0][-1] @ context.smr_normal, context.beam[1])
        return np.asarray(np.arccos(np.clip(back, -1.0, 1.0)))
    logged = {"time": known.time_s, "dwell": known.dwell_s, "temperature": known.air_c}[variable]
    return nothing if logged is None else logged


def _constants(context: EffectContext, variable: str) -> dict[str, float]:
    """What a law must remember of the run about a variable."""
    if _is_angle(variable):
        return {"order": float(ORDER)}
    if variable == "time":
        ends = span(context)
        return {
            "order": float(TIME_ORDER),
            "low": ends["first_s"],
            "high": ends["last_s"],
            "typical": ends["last_s"],
        }
    values = _raw(context, variable)
    constants = {}
    if variable == "azimuth":
        constants["center"] = math.atan2(float(np.sin(values).mean()), float(np.cos(values).mean()))
        values = _about(values, constants["center"])
    typical = float(np.mean(values))
    if variable == "dwell":
        typical = float(np.median(values))
    elif variable == "payload":
        typical = context.bodies.payload_mass
    elif variable.startswith("step"):
        typical = 0.0
    order = float(min(ORDER, len(np.unique(values)) - 1))
    return {"order": order, "low": float(values.min()), "high": float(values.max()), "typical": typical, **constants}


def _about(azimuth: Array, center: float) -> Array:
    """Azimuths from a centre (n,), between -pi and pi: no jump inside the cell wherever the tracker's x axis points."""
    return np.asarray(np.remainder(azimuth - center + np.pi, 2.0 * np.pi) - np.pi)


def _functions(context: EffectContext, law: Law, names: list[str]) -> dict[str, Array]:
    """Functions (n,) of the law's variable or variables, by name."""
    first = _own(law.constants, "")
    if len(names) == 1:
        if names[0] == "time" and "period_s" in first:
            phase = 2.0 * np.pi * _unit(context, "time", first) * (first["high"] - first["low"]) / first["period_s"]
            return {"cos_time": np.cos(phase), "sin_time": np.sin(phase)}
        if names[0] == "time":
            return _of_time(_unit(context, "time", first), round(first["order"]))
        return {name: values for _, name, values in _family(context, names[0], first)}
    second = _own(law.constants, "2")
    if all(_is_angle(name) for name in names):
        return _of_two_angles(context, names)
    ones = [(0, "", np.ones(len(context)))]
    products = {}
    for m, left, f in ones + _family(context, names[0], first):
        for k, right, g in ones + _family(context, names[1], second):
            if 1 <= m + k <= PAIR_ORDER:
                products["*".join(filter(None, (left, right)))] = f * g
    return products


def _or_zero(values: Array) -> Array:
    """Zero where an angle is not known: a cosine's mean over the turn."""
    return np.asarray(np.nan_to_num(values), dtype=np.float64)


def _own(constants: Mapping[str, float], suffix: str) -> dict[str, float]:
    """The constants of the first (no suffix) or of the second variable."""
    names = ("order", "low", "high", "typical", "center", "period_s")
    return {name: constants[name + suffix] for name in names if name + suffix in constants}


def _family(context: EffectContext, variable: str, constants: Mapping[str, float]) -> list[tuple[int, str, Array]]:
    """Order, name and values (n,) of the functions of one variable; zero where an angle is not known."""
    label, order = variable.replace(" ", "_"), round(constants["order"])
    if _is_angle(variable):
        angle = _raw(context, variable)
        return [
            (m, f"{letter}{m}_{label}", _or_zero(wave(m * angle)))
            for m in range(1, order + 1)
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]
    polynomials = np.asarray(legvander(2.0 * _unit(context, variable, constants) - 1.0, order), dtype=np.float64)
    return [(m, f"p{m}_{label}", polynomials[:, m]) for m in range(1, order + 1)]


def _unit(context: EffectContext, variable: str, constants: Mapping[str, float]) -> Array:
    """A variable (n,) on its range in the run, 0 to 1, held at its ends beyond."""
    values = _raw(context, variable)
    if variable == "azimuth":
        values = _about(values, constants["center"])
    low, high = constants["low"], constants["high"]
    return np.clip((filled(values, constants["typical"], len(context)) - low) / (high - low), 0.0, 1.0)


def _of_time(x: Array, order: int) -> dict[str, Array]:
    functions = {"linear_time": 2.0 * x - 1.0}
    for k in range(1, order + 1):
        functions[f"cos{k}_time"] = np.cos(np.pi * k * x)
    return functions


def _of_two_angles(context: EffectContext, names: list[str]) -> dict[str, Array]:
    """Cosine and sine of m v + k w for 1 <= |m| + |k| <= 3, each pair of opposite signs once."""
    v, w = (_raw(context, name) for name in names)
    labels = [name.replace(" ", "_") for name in names]
    functions = {}
    for m in range(PAIR_ORDER + 1):
        for k in range(m - PAIR_ORDER, PAIR_ORDER - m + 1):
            if m == 0 and k <= 0:
                continue
            phase = m * v + k * w
            for letter, wave in (("cos", np.cos), ("sin", np.sin)):
                functions[f"{letter}({_phase_text(m, k, labels)})"] = _or_zero(wave(phase))
    return functions


def _phase_text(m: int, k: int, labels: list[str]) -> str:
    """``2*q1-q2`` and the like."""
    terms = [f"{count:+d}*{label}" for count, label in zip((m, k), labels, strict=True) if count]
    return "".join(terms).replace("+1*", "+").replace("-1*", "-").removeprefix("+")


def _direction(context: EffectContext, channel: str) -> tuple[str, Array]:
    """Unit of a channel that turns no joint, and the shift of the SMR (n, 3) per unit."""
    if channel in _TWISTS:
        place = _TWISTS.index(channel)
        return ("m" if place < 3 else "rad"), context.base_twists[place]
    if channel in _TOOLS:
        return "m", context.frames[0][-1][:, :, _TOOLS.index(channel)]
    distance, beam = context.beam
    _, elevation, horizontal, upward = context.across
    if channel == "tracker radial":
        return "m", beam
    if channel == "tracker azimuth":
        return "rad", (distance * np.cos(elevation))[:, None] * horizontal
    return "rad", distance[:, None] * upward
