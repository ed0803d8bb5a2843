"""Derive the verdict of a check with its evidence, in the records of its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from cellapp.estimation.monitoring.check.linear import Moments, StopRows
from cellapp.estimation.monitoring.check.model import Conclusion, Power, SequentialState
from cellapp.estimation.monitoring.check.naming import NOT_EXPLAINED, Cause, Design, Explanation, explain, with_station
from cellapp.estimation.monitoring.check.records import CheckedArm, CheckVerdict, FoundChange
from cellapp.estimation.monitoring.check.statistics import MinPValueTest
from cellapp.estimation.monitoring.check.stops import power_of
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array, apply, rotation_vectors

_VERDICTS: Mapping[str, CheckVerdict] = {
    "tracker": "tracker moved",
    "base": "base moved",
    "smr": "smr moved",
    "parameter": "arm changed",
    "effect": "arm changed",
}


_MOST_NEEDED = 1e4
"""Upper bound of the search for a non-centrality: a hundred standard errors, above any that is needed."""


def powers(design: Design, moments: Moments, critical: float) -> list[Power]:
    """Compute the power of the last test for every direction, with p-values up to ``critical`` significant."""
    rank = {k: len(one.members) for one in design.alternatives for k in one.members}
    needed = {r: _needed(critical, r, design.miss) for r in {1, *rank.values()}}
    information = moments.information[-1].tolist()
    return [
        power_of(one, information[k], float(design.moved_m[k]), bool(design.visible[k]), needed[rank.get(k, 1)])
        for k, one in enumerate(design.directions)
    ]


def _needed(critical: float, rank: int, miss: float) -> float:
    """Find the non-centrality at which a test of ``rank`` parameters misses a change with probability ``miss``."""
    limit = float(scipy.special.chdtri(rank, critical))

    def surplus(size: float) -> float:
        return float(scipy.special.chndtr(limit, rank, size)) - miss

    return float(scipy.optimize.brentq(surplus, 1e-6, _MOST_NEEDED))


def concluded(design: Design, stops: StopRows, state: SequentialState) -> Conclusion:
    """Draw the conclusion from all stops and the state of the test, which says whether something changed."""
    here, station = with_station(design, stops)
    moments = Moments.of(here)
    test = MinPValueTest.of(moments, design.alternatives)
    verdict, found, weak, stray = judgement(design, here, state)
    explained = verdict != "not explained" and stray is None
    return Conclusion(
        verdict=verdict,
        sure_after=state.stops,
        p_value=test.corrected(float(test.p_values(moments.white[:, None]).min())),
        changes=tuple(_change(design, one) for one in found.causes),
        arms=_checked(design, here, found.causes, explained),
        T_new_old=_station(design, station @ found.station, found.causes),
        moved_bases={
            one.alternative.arm: one.motion @ design.belief.arms[one.alternative.arm].model.geometry.T_M_B()
            for one in found.causes
            if one.alternative.kind == "base" and one.motion is not None
        },
        smr_offsets_F={
            one.alternative.arm: design.belief.arms[one.alternative.arm].model.geometry.tool
            + _in_units(design, one)[:3]
            for one in found.causes
            if one.alternative.kind == "smr"
        },
        weak=weak,
        notes=_notes(design, found, weak, verdict, stray),
    )


def judgement(
    design: Design, stops: StopRows, state: SequentialState
) -> tuple[CheckVerdict, Explanation, tuple[Power, ...], int | None]:
    """Return the verdict, its explanation, visible changes that may be missed, and the index of a stray point or None.

    The stops are relative to the belief, with a new station already fitted.
    """
    nothing = Explanation((), 1.0, np.eye(4))
    if not state.changed:
        weak = () if state.valid else _weak(design, Moments.of(stops))
        return ("cannot say" if weak else "valid"), nothing, weak, None
    found = explain(design, stops)
    if found.holds:
        return _VERDICTS[found.causes[0].alternative.kind], found, (), None
    stray = stray_point(stops)
    return ("not explained", found, (), None) if stray is None else ("cannot say", nothing, (), stray)


def stray_point(stops: StopRows) -> int | None:
    """Find the point without which the others show no change; None if no single point does that."""
    moments, factor = Moments.of(stops), stops.factor
    white, degrees = moments.white, int(moments.degrees[-1]) - 3
    own = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True).reshape(len(factor), -1, 3)
    left = []
    for point in range(own.shape[1]):
        basis = np.linalg.qr(own[:, point])[0]
        left.append(float(white @ white - np.sum((white @ basis) ** 2)))
    best = int(np.argmin(left))
    return best if degrees > 0 and scipy.special.chdtrc(degrees, left[best]) >= NOT_EXPLAINED else None


def _weak(design: Design, moments: Moments) -> tuple[Power, ...]:
    """Return visible changes for which the last test has too little power and that the stops do not rule out."""
    critical = MinPValueTest.of(moments, design.alternatives).critical(design.last_alarm)
    ruled_out = 0.5 * moments.information[-1] - np.abs(moments.moment[-1]) >= -math.log(design.miss)
    found = zip(powers(design, moments, critical), design.directions, ruled_out, strict=True)
    return tuple(one for one, direction, out in found if one.visible and one.detected > direction.step and not out)


def _in_units(design: Design, cause: Cause) -> Array:
    steps = np.array([design.directions[k].step for k in cause.alternative.members])
    return np.asarray(cause.sizes * steps)


def _change(design: Design, cause: Cause) -> FoundChange:
    one = cause.alternative
    single = len(one.members) == 1
    direction = design.directions[one.members[0]]
    return FoundChange(
        arm=one.arm,
        what=design.name_of(one) if one.kind in ("tracker", "base", "smr") else one.what,
        value=float(_in_units(design, cause)[0]) if single else None,
        standard_error=math.sqrt(float(cause.covariance[0, 0])) * direction.step if single else None,
        unit=direction.unit if single else "",
        p_value=cause.p_value,
        moved_mm=moved_m(design, cause, None) * 1e3,
        turned_mrad=_turned_mrad(design, cause),
        rivals=cause.rivals,
    )


def moved_m(design: Design, cause: Cause, arm: str | None) -> float:
    """Compute the rms motion [m] of the SMR by a change over the calibration's readings of ``arm``.

    If ``arm`` is None, of all arms that the change moves.
    """
    one, belief = cause.alternative, design.belief
    names = [arm] if arm is not None else (list(belief.arms) if one.kind == "tracker" else [one.arm])
    squares, count = 0.0, 0
    for name in names:
        p_M = belief.arms[name].positions.readings.p_M
        if cause.motion is not None:
            moved = apply(cause.motion, p_M) - p_M
        else:
            moved = np.tensordot(cause.sizes, design.motions[name][list(one.members), : len(p_M)], axes=1)
        squares, count = squares + float(np.sum(moved**2)), count + len(p_M)
    return math.sqrt(squares / count)


def _turned_mrad(design: Design, cause: Cause) -> float | None:
    """Compute the rms rotation [mrad] of the probe by a change over the calibration's readings.

    None if the change is not of one arm, or no orientation was measured.
    """
    one = cause.alternative
    arm = design.belief.arms.get(one.arm)
    if arm is None or arm.measured.turned is None:
        return None
    if cause.motion is not None:
        return float(np.linalg.norm(rotation_vectors(cause.motion[None, :3, :3])[0])) * 1e3
    turned = np.tensordot(cause.sizes, design.motions[one.arm][list(one.members), len(arm.positions) :], axes=1)
    return math.sqrt(float(np.mean(np.sum(turned**2, axis=1)))) * 1e3


def _checked(design: Design, stops: StopRows, causes: Sequence[Cause], explained: bool) -> dict[str, CheckedArm]:
    """Summarise every arm at its stops; the remaining accuracy is unknown if the errors are not explained."""
    variance = np.sum(stops.factor**2, axis=1).reshape(-1, 3).sum(axis=1)
    found = {}
    for place, (name, arm) in enumerate(design.belief.arms.items()):
        rows = (stops.arm_of == place) & stops.points
        turned = (stops.arm_of == place) & ~stops.points
        if not rows.any():
            continue
        own = [one for one in causes if one.alternative.arm == name]
        squares = arm.promised_m**2 + sum(moved_m(design, one, name) ** 2 for one in own)
        found[name] = CheckedArm(
            stops=int(rows.sum()),
            expected_mm=math.sqrt(float(variance[rows].mean())) * 1e3,
            rms_mm=math.sqrt(float(np.sum(stops.left[rows] ** 2) / rows.sum())) * 1e3,
            left_mm=math.sqrt(squares) * 1e3 if explained else None,
            expected_mrad=math.sqrt(float(variance[turned].mean())) * 1e3 if turned.any() else None,
            rms_mrad=math.sqrt(float(np.sum(stops.left[turned] ** 2) / turned.sum())) * 1e3 if turned.any() else None,
        )
    return found


def _station(design: Design, station: Array, causes: Sequence[Cause]) -> Array | None:
    moved = next((one.motion for one in causes if one.alternative.kind == "tracker"), None)
    if not design.belief.station_free:
        return moved
    rough = design.belief.T_new_old
    return station if rough is None else np.asarray(station @ rough)


def _notes(
    design: Design, found: Explanation, weak: Sequence[Power], verdict: CheckVerdict, stray: int | None
) -> tuple[str, ...]:
    notes = [
        f"the stops do not tell {design.name_of(cause.alternative)} from {', '.join(cause.rivals)}"
        for cause in found.causes
        if cause.rivals
    ]
    if stray is not None:
        notes.append(
            "one point alone does not agree with the model, and the others show no change; look at its SMR, at what it"
            " may have touched, and check again"
        )
    if verdict == "not explained":
        notes.append("something changed, but none of the known changes explains the stops; calibrate again")
    if weak:
        names = dict.fromkeys(f"{one.what} of arm {one.arm}, found from {_amount(one)}" for one in weak)
        notes.append(f"visible changes that the measured stops may miss: {'; '.join(names)}; measure more stops")
    own = [k for k, one in enumerate(design.directions) if one.kind == "parameter"]
    hidden = int(np.sum(~design.visible[own]))
    if verdict == "valid" and hidden:
        noise_mm = 1e3 * max(arm.noise_m for arm in design.belief.arms.values())
        notes.append(
            f"a change of 0.05 mm or 50 µrad of {hidden} of {counted(len(own), 'parameter')} of the arms would not"
            f" be seen: it moves the SMR by less than a measurement scatters ({noise_mm:.3f} mm)"
        )
    return tuple(notes)


def _amount(one: Power) -> str:
    """The size of a change that is found, for people."""
    factor, unit = {"m": (1e3, "mm"), "rad": (1e6, "µrad")}.get(one.unit, (1.0, one.unit))
    return f"{factor * one.detected:.2g} {unit}"
