"""Sequential test: it takes stops one by one and ends as soon as it is sure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from cellapp.estimation.calibration.station_location import FEWEST_POINTS
from cellapp.estimation.monitoring.check.belief import (
    FALSE_ALARM,
    MISS,
    TRACKER,
    ArmBelief,
    CheckBelief,
    ChosenStops,
    Conclusion,
    Power,
    SequentialState,
    noise_covariance,
)
from cellapp.estimation.monitoring.check.linear import (
    Direction,
    Moments,
    StopRows,
    alternatives_of,
    calibration_motions,
    conditions_now,
    directions_of,
    motions,
    stop_rows,
    visibility,
)
from cellapp.estimation.monitoring.check.naming import (
    NOT_EXPLAINED,
    Cause,
    Design,
    Explanation,
    MinPValueTest,
    explain,
    looks,
    with_station,
)
from cellapp.estimation.monitoring.check.records import CheckedArm, CheckVerdict, FoundChange
from cellapp.estimation.prior.belief import Measured
from cellapp.estimation.readings import Readings, joined
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, apply, quaternions_of, rotation_vectors

# -- Choose stops that show every visible change ----------------------------------------------------------------------
#
# Stops are chosen greedily. Each direction k has the information I_k = b_k^T R^-1 b_k of one step, minus the part that
# the motion of a tracker that was set up anew explains; I_k is the non-centrality of its test. The stop that lowers
# sum_k exp(-I_k / s) most is taken: a smooth form of the least I_k, in which well-shown directions weigh little. The
# uncertainty of the calibration is neglected: it is a fifth of the noise if the calibration has twenty times the
# stops.

NEEDED = 32.0
"""Non-centrality at which a change is found with 95 % at 1 % false alarms among some hundred correlated directions: the
square of 4.0 (the corrected quantile) and 1.65 standard errors."""
_SOFTNESS = 6.0
"""``s``: a direction with the needed information weighs 1/200 of one with none."""
_KNOWN = 1e-6
"""Prior information on a step of the tracker's motion: keeps it solvable while one stop does not determine it."""
_LEAST_INFORMATION = 1e-9
"""Lower bound of the information in divisions, for directions that the stops do not show at all."""


def choose_stops(
    belief: CheckBelief, candidates: Mapping[str, Array], count: int, *, start: Mapping[str, Array] | None = None
) -> ChosenStops:
    """Choose ``count`` stops of all arms, in order, that show the weakest visible change as well as possible.

    Parameters
    ----------
    belief : CheckBelief
    candidates : mapping
        Arm -> configurations (n, N) [rad]; row k of all arms is one stop. They must be reachable and visible: the
        configurations of the calibration's own readings are.
    count : int
        Number of stops; all n if there are no more.
    start : mapping, optional
        Arm -> configuration (N,) before the first stop [rad]: determines the approach signs of its joints.
    """
    directions = directions_of(belief)
    moved, visible = visibility(belief, directions, calibration_motions(belief, directions))
    weights = np.where(visible, 1.0, 0.0) if np.any(visible) else np.ones(len(directions))
    n = len(next(iter(candidates.values())))
    here = dict(start or {})
    tracker = [k for k, one in enumerate(directions) if one.arm == TRACKER]
    G = np.zeros((len(directions), len(directions)))
    free, order = np.ones(n, dtype=bool), []
    for _ in range(min(count, n)):
        white = _whitened(belief, candidates, here, directions)
        gained = _beside_station(G, white, tracker) if belief.station_free else _added(G, white)
        scores = np.where(free, -(weights[:, None] * np.exp(-gained / _SOFTNESS)).sum(axis=0), -np.inf)
        chosen = int(np.argmax(scores))
        G += white[:, :, chosen] @ white[:, :, chosen].T
        free[chosen] = False
        order.append(chosen)
        here = {name: q[chosen] for name, q in candidates.items()}
    final = np.diag(G) if not belief.station_free else _projected(G, tracker)
    power = tuple(
        power_of(one, float(final[k]), float(moved[k]), bool(visible[k]), NEEDED) for k, one in enumerate(directions)
    )
    return ChosenStops(np.array(order, dtype=np.intp), power, NEEDED)


def power_of(one: Direction, noncentrality: float, moved_m: float, visible: bool, needed: float) -> Power:
    """Compute the power of stops to show a change; ``needed`` is the non-centrality at which it is found."""
    return Power(
        arm=one.arm,
        what=one.what,
        kind=one.kind,
        noncentrality=noncentrality,
        moved_mm=moved_m * 1e3,
        visible=visible,
        unit=one.unit,
        detected=one.step * math.sqrt(needed / max(noncentrality, _LEAST_INFORMATION)),
    )


def _whitened(
    belief: CheckBelief, candidates: Mapping[str, Array], here: Mapping[str, Array], directions: Sequence[Direction]
) -> Array:
    """Compute motions (C, d, n) of all arms at each candidate in units of the noise, approached from ``here``."""
    readings = {name: _imagined(q, here.get(name)) for name, q in candidates.items()}
    conditions = conditions_now(belief, readings)
    found = []
    for name, its in readings.items():
        arm = belief.arms[name]
        measured = _as_measured(arm, its, conditions[name])
        rows, noise = motions(belief, name, measured, directions), noise_covariance(arm, arm.measured)
        kinds = ((measured.points, arm.measured.points), (~measured.points, ~arm.measured.points))
        found += [
            np.einsum("ac,knc->kan", _whitener(noise[known]), rows[:, asked]) for asked, known in kinds if asked.any()
        ]
    return np.concatenate(found, axis=1)


def _as_measured(arm: ArmBelief, imagined: Readings, conditions: MeasurementConditions) -> Measured:
    """Convert simulated readings to vectors, with the predicted orientation if the check measures it."""
    if arm.measured.turned is not None:
        turns = arm.model.orientation(imagined.q, conditions)
        imagined = replace(imagined, quaternion_M=quaternions_of(turns))
    return Measured.of(imagined, conditions)


def _whitener(covariances: Array) -> Array:
    """Compute the whitening matrix (3, 3) from the mean covariance (n, 3, 3) of the calibration's readings."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(np.mean(covariances, axis=0))))


def _imagined(q: Array, here: Array | None) -> Readings:
    """Build hypothetical readings at configurations ``q`` (n, N) [rad], each approached from ``here`` (N,)."""
    step = np.zeros_like(q) if here is None else q - here
    return Readings(
        configuration=np.arange(len(q)),
        time_s=np.full(len(q), np.nan),
        q=q,
        approach=np.sign(step).astype(np.int8),
        step=None if here is None else step,
        p_M=np.zeros((len(q), 3)),
    )


def _added(G: Array, white: Array) -> Array:
    """Compute the information (C, n) of each direction if one of n stops with motions ``white`` (C, d, n) is added."""
    return np.asarray(np.diag(G)[:, None] + np.einsum("kdn,kdn->kn", white, white))


def _projected(G: Array, tracker: Sequence[int]) -> Array:
    """Compute the information (C,) of each direction with an unknown tracker, from the joint information G (C, C)."""
    own = G[np.ix_(tracker, tracker)] + _KNOWN * np.eye(len(tracker))
    return np.asarray(np.diag(G) - np.einsum("tk,tk->k", G[tracker], np.linalg.solve(own, G[tracker])))


def _beside_station(G: Array, white: Array, tracker: Sequence[int]) -> Array:
    """Compute ``_projected`` (C, n) if one of n stops with motions ``white`` (C, d, n) is added."""
    rows = white[tracker]
    own = G[np.ix_(tracker, tracker)] + _KNOWN * np.eye(len(tracker))
    own = own + np.einsum("idn,jdn->nij", rows, rows)
    cross = G[tracker] + np.einsum("idn,kdn->nik", rows, white)
    lost = np.einsum("nik,nik->kn", cross, np.linalg.solve(own, cross))
    return np.asarray(_added(G, white) - lost)


# -- Derive the verdict of a check with its evidence, in the records of its result ------------------------------------

_VERDICTS: Mapping[str, CheckVerdict] = {
    "tracker": "tracker moved",
    "base": "base moved",
    "smr": "smr moved",
    "parameter": "arm changed",
    "effect": "arm changed",
}


_MOST_UNSEEN = 3.0
"""Steps of a visible change that stops may miss while the calibration is still called valid; the notes name it."""
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
        steps = {(one.arm, one.what): one.step for one in design.directions}
        unseen = any(one.detected > _MOST_UNSEEN * steps[one.arm, one.what] for one in weak)
        return ("cannot say" if unseen else "valid"), nothing, weak, None
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


_FEWEST_STOPS = 6
"""Fewest stops to name a change: six parameters of a moved base, and as many data to show whether they explain it."""


class SequentialTest:
    """Sequential test of a calibration: add stops until ``state.sure``, then ask for the conclusion.

    The probability of a false alarm is at most ``FALSE_ALARM`` over all stops, that of calling a visible change valid
    at most ``MISS``.
    """

    def __init__(self, belief: CheckBelief, planned: int) -> None:
        """Prepare the test; it ends after ``planned`` stops at the latest."""
        self._design = design_of(belief)
        self._planned = planned
        self._readings: dict[str, Readings] = {}
        self._standing = SequentialState(0, False, False, False, 0.0, 0.0, 1.0)
        self._stops: StopRows | None = None

    @property
    def state(self) -> SequentialState:
        """State after the stops so far."""
        return self._standing

    def add(self, readings: Mapping[str, Readings]) -> SequentialState:
        """Add one or more stops: arm -> its readings (same ``configuration`` at the same stop) in the order of
        measurement, with approach signs, steps, temperatures and covariance as logged by collection. An arm that was
        not measured may be missing.

        Raises
        ------
        InputError
            If a reading is not finite or of an unknown arm.
        """
        for name, its in readings.items():
            if name not in self._design.belief.arms:
                raise InputError(
                    f"check: the calibration has no arm '{name}'; it has {', '.join(self._design.belief.arms)}"
                )
            if not (np.isfinite(its.p_M).all() and np.isfinite(its.q).all()):
                raise InputError(f"check: a reading of arm '{name}' is not finite; measure the stop again")
            if len(its):
                before = self._readings.get(name)
                self._readings[name] = its if before is None else joined([before, its])
        if self._readings:
            self._stops = stop_rows(self._design.belief, self._readings, self._design.directions)
            self._standing = judged(self._design, self._stops, self._planned)
        return self._standing

    def conclusion(self) -> Conclusion:
        """Return the verdict from all stops so far, with the change that explains them.

        Raises
        ------
        InputError
            If there is no stop.
        """
        if self._stops is None:
            raise InputError("check: no stop was measured; there is nothing to conclude from")
        return concluded(self._design, self._stops, self._standing)


def design_of(belief: CheckBelief) -> Design:
    """Define what a check of a cell tests: directions, alternatives, visibility."""
    directions = tuple(directions_of(belief))
    motions = calibration_motions(belief, directions)
    moved, visible = visibility(belief, directions, motions)
    alternatives = tuple(alternatives_of(belief, directions))
    return Design(belief, directions, alternatives, motions, moved, visible, FALSE_ALARM, MISS)


def judged(design: Design, stops: StopRows, planned: int) -> SequentialState:
    """Evaluate the test after some stops."""
    here, _ = with_station(design, stops)
    moments = Moments.of(here)
    if stops.free and np.sum(stops.points) < FEWEST_POINTS:  # too few points to locate the tracker
        return SequentialState(len(stops.stop_ends), len(stops.stop_ends) >= planned, False, False, 0.0, 0.0, 1.0)
    seen = looks(moments, design.alternatives, design.visible)
    count = len(seen.log_evidence)
    changed_at = _first(seen.log_evidence, design.early_alarm)
    valid_at = _first(seen.log_valid, design.early_miss)
    changed, valid = changed_at < count and changed_at <= valid_at, valid_at < changed_at
    if not changed and not valid and count >= planned:
        test = MinPValueTest.of(moments, design.alternatives)
        changed = test.significant(float(test.p_values(moments.white[:, None]).min()), design.last_alarm)
    sure = valid or count >= planned or (changed and count >= _FEWEST_STOPS and _named(design, here))
    return SequentialState(
        stops=valid_at + 1 if valid else count,
        sure=sure,
        changed=changed,
        valid=valid,
        log_evidence=float(seen.log_evidence[-1]),
        log_valid=float(seen.log_valid[-1]),
        p_value=float(seen.p_values[-1]),
    )


def _first(values: Array, chance: float) -> int:
    """Return the first index with a logarithm of at least log(1 / ``chance``); the number of values if none."""
    reached = np.flatnonzero(values >= -math.log(chance))
    return int(reached[0]) if len(reached) else len(values)


def _named(design: Design, stops: StopRows) -> bool:
    """Return whether the changes explain the stops and no rivals remain that more stops could exclude."""
    found = explain(design, stops)
    return found.holds and not any(cause.open_rivals for cause in found.causes)
