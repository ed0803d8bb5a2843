"""Sequential test: it takes stops one by one and ends as soon as it is sure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.monitoring.belief import (
    MISS,
    MOST_STEPS,
    VISIBLE,
    CheckBelief,
    SequentialState,
    measured_vectors,
)
from cellapp.estimation.monitoring.causes import (
    NOT_EXPLAINED,
    SPENT_EARLY,
    Cause,
    Design,
    MinPValueTest,
    explain,
    log_valid,
)
from cellapp.estimation.monitoring.linear import (
    Moments,
    StopRows,
    alternatives_of,
    conditions_now,
    directions_of,
    motions,
    stop_rows,
    visibility,
)
from cellapp.estimation.monitoring.records import CheckedArm, CheckResult, CheckVerdict, FoundChange, WeakChange
from cellapp.estimation.readings import Readings, joined
from cellapp.ground.counting import counted, plain
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array, apply, rms_length, rotation_vectors, rows_of, xyz_of

# -- Choose stops that show every visible change ----------------------------------------------------------------------
#
# Stops are chosen greedily. Direction k has the information I_k = b_k^T R^-1 b_k of one step, the non-centrality of
# its test. The stop that lowers sum_k exp(-I_k / s) most is taken: a smooth form of the least I_k, in which well-shown
# directions weigh little. The uncertainty of the calibration is neglected: it is a fifth of the noise if the
# calibration has twenty times the stops.

_SOFTNESS = 6.0
"""``s``: a direction with an information of 32, at which a change is found with 95 %, weighs 1/200 of one with none."""


def choose_stops(design: Design, candidates: Mapping[str, Readings], count: int) -> NDArray[np.intp]:
    """Choose ``count`` stops of all arms, in order, that show the weakest visible change as well as possible.

    Parameters
    ----------
    design : Design
    candidates : mapping
        Arm -> readings of the calibration; row k of all arms is one stop. They must be reachable and visible.
    count : int
        Number of stops; all n if there are no more.
    """
    weights = np.where(design.visible, 1.0, 0.0) if np.any(design.visible) else np.ones(len(design.directions))
    gains = _information(design, candidates)
    so_far, free, order = np.zeros(len(gains)), np.ones(gains.shape[1], dtype=bool), []
    for _ in range(min(count, len(free))):
        scores = -(weights[:, None] * np.exp(-(so_far[:, None] + gains) / _SOFTNESS)).sum(axis=0)
        chosen = int(np.argmax(np.where(free, scores, -np.inf)))
        so_far = so_far + gains[:, chosen]
        free[chosen] = False
        order.append(chosen)
    return np.array(order, dtype=np.intp)


def _information(design: Design, candidates: Mapping[str, Readings]) -> Array:
    """Compute the information (C, n) of one step of each direction at each candidate."""
    numbered = {name: replace(its, configuration=np.arange(len(its))) for name, its in candidates.items()}
    conditions = conditions_now(design.belief, numbered)
    found: Array = np.zeros((len(design.directions), len(next(iter(candidates.values())))))
    for name, its in numbered.items():
        arm = design.belief.arms[name]
        measured = measured_vectors(arm, its, conditions[name])
        squares = np.sum(motions(design.belief, name, measured, design.directions) ** 2, axis=2)
        for asked, scatter in arm.kinds(measured):
            found[:, measured.readings.configuration[asked]] += squares[:, asked] / scatter.noise**2
    return found


# -- Derive the verdict of a check with its evidence, in the records of its result ------------------------------------

_RIGID: Mapping[str, CheckVerdict] = {"tracker": "tracker moved", "base": "base moved", "smr": "smr moved"}
"""Verdicts of rigid motions; of all else an arm changed."""


_MOST_UNSEEN = 3.0
"""Steps of a visible change that stops may miss while the calibration is still called valid; the notes name it."""
_LEAST_INFORMATION = 1e-9
"""Lower bound of the information in divisions, for directions that the stops do not show at all."""
_MOST_NEEDED = 1e4
"""Upper bound of the search for a non-centrality: a hundred standard errors, above any that is needed."""


def _needed(critical: float, rank: int) -> float:
    """Find the non-centrality at which a test of ``rank`` parameters misses a change with probability ``MISS``."""
    limit = float(scipy.special.chdtri(rank, critical))

    def surplus(size: float) -> float:
        return float(scipy.special.chndtr(limit, rank, size)) - MISS

    return float(scipy.optimize.brentq(surplus, 1e-6, _MOST_NEEDED))


def concluded(design: Design, stops: StopRows, state: SequentialState, planned: int) -> CheckResult:
    """Draw the conclusion from all stops and the state of the test, which says whether something changed."""
    moments = Moments.of(stops)
    test = MinPValueTest.of(moments, design.alternatives)
    verdict, causes, weak, stray = judgement(design, stops, state)
    T = next((one.motion for one in causes if one.alternative.kind == "tracker"), None)
    arms = design.belief.arms
    return CheckResult(
        verdict=verdict,
        planned=planned,
        sure_after=state.stops,
        p_value=test.corrected(test.least(moments)),
        false_alarm=design.false_alarm,
        miss=MISS,
        changes=tuple(_change(design, one) for one in causes),
        arms=_checked(design, stops, causes, verdict != "not explained" and not stray),
        station_shift_mm=None if T is None else float(np.linalg.norm(T[:3, 3])) * 1e3,
        station_turn_deg=None if T is None else math.degrees(float(np.linalg.norm(rotation_vectors(T[None, :3, :3])))),
        T_new_old=None if T is None else rows_of(T),
        moved_bases={
            one.alternative.arm: rows_of(one.motion @ arms[one.alternative.arm].model.geometry.T_M_B())
            for one in causes
            if one.alternative.kind == "base" and one.motion is not None
        },
        smr_offsets_F={
            one.alternative.arm: xyz_of(arms[one.alternative.arm].model.geometry.tool + _in_units(design, one)[:3])
            for one in causes
            if one.alternative.kind == "smr"
        },
        weak=weak,
        visible=_visible(design),
        notes=_notes(design, causes, weak, verdict, stray),
    )


def _visible(design: Design) -> dict[str, dict[str, float]]:
    """Return arm -> change -> its visible size, the largest of several values."""
    found: dict[str, dict[str, float]] = {}
    for one, visible in zip(design.directions, design.visible, strict=True):
        if visible:
            own = found.setdefault(one.arm, {})
            own[one.what] = max(one.step, own.get(one.what, 0.0))
    return found


def judgement(
    design: Design, stops: StopRows, state: SequentialState
) -> tuple[CheckVerdict, tuple[Cause, ...], tuple[WeakChange, ...], bool]:
    """Return the verdict, what changed, visible changes that may be missed, and whether one point is stray."""
    if not state.changed:
        weak = {} if state.valid else _weak(design, Moments.of(stops))
        unseen = any(one.detected > _MOST_UNSEEN * design.directions[k].step for k, one in weak.items())
        return ("not decided" if unseen else "valid"), (), tuple(weak.values()), False
    causes, explained = explain(design, stops)
    if explained:
        return _RIGID.get(causes[0].alternative.kind, "arm changed"), causes, (), False
    return ("not decided", (), (), True) if one_is_stray(stops) else ("not explained", causes, (), False)


def one_is_stray(stops: StopRows) -> bool:
    """Return whether there is a point without which the others show no change."""
    moments, factor = Moments.of(stops), stops.factor
    white, degrees = moments.white, moments.degrees - 3
    own = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True).reshape(len(factor), -1, 3)
    of_points = white @ np.linalg.qr(own.swapaxes(0, 1))[0]
    least = float(white @ white - np.sum(of_points**2, axis=1).max())
    return degrees > 0 and float(scipy.special.chdtrc(degrees, least)) >= NOT_EXPLAINED


def _weak(design: Design, moments: Moments) -> dict[int, WeakChange]:
    """Return visible changes for which the last test has too little power and that the stops do not rule out.

    They are keyed by their directions.
    """
    critical = MinPValueTest.of(moments, design.alternatives).critical(design.last_alarm)
    rank = {k: len(one.members) for one in design.alternatives for k in one.members}
    needed = {r: _needed(critical, r) for r in {1, *rank.values()}}
    information = moments.information
    ruled_out = 0.5 * information - np.abs(moments.moment) >= -math.log(MISS)
    found = {}
    for k in np.flatnonzero(design.visible & ~ruled_out).tolist():
        one, more = design.directions[k], math.sqrt(needed[rank.get(k, 1)] / max(information[k], _LEAST_INFORMATION))
        if more > 1.0:
            found[k] = WeakChange(
                arm=one.arm,
                what=one.what,
                moved_mm=float(design.moved_m[k]) * 1e3,
                detected=one.step * more,
                unit=one.unit,
            )
    return found


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
        turned_mrad=_rotation_mrad(design, cause),
        rivals=cause.confounded,
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


def _rotation_mrad(design: Design, cause: Cause) -> float | None:
    """Compute the rms rotation [mrad] of the probe by a change over the calibration's readings.

    None if the change is not of one arm, or no orientation was measured.
    """
    one = cause.alternative
    arm = design.belief.arms.get(one.arm)
    if arm is None or arm.measured.angular is None:
        return None
    if cause.motion is not None:
        return float(np.linalg.norm(rotation_vectors(cause.motion[None, :3, :3])[0])) * 1e3
    rotations = np.tensordot(cause.sizes, design.motions[one.arm][list(one.members), len(arm.positions) :], axes=1)
    return rms_length(rotations) * 1e3


def _checked(design: Design, stops: StopRows, causes: Sequence[Cause], explained: bool) -> dict[str, CheckedArm]:
    """Summarise every arm at its stops; the remaining accuracy is unknown if the errors are not explained."""
    variance = np.sum(stops.factor**2, axis=1).reshape(-1, 3).sum(axis=1)
    measured = np.sum(stops.residuals**2, axis=1)
    found = {}
    for place, (name, arm) in enumerate(design.belief.arms.items()):
        rows = (stops.arm_of == place) & stops.points
        angular = (stops.arm_of == place) & ~stops.points
        if not rows.any():
            continue
        own = [one for one in causes if one.alternative.arm == name]
        squares = arm.promised_m**2 + sum(moved_m(design, one, name) ** 2 for one in own)
        found[name] = CheckedArm(
            stops=int(rows.sum()),
            expected_mm=math.sqrt(float(variance[rows].mean())) * 1e3,
            rms_mm=math.sqrt(float(measured[rows].mean())) * 1e3,
            left_mm=math.sqrt(squares) * 1e3 if explained else None,
            expected_mrad=math.sqrt(float(variance[angular].mean())) * 1e3 if angular.any() else None,
            rms_mrad=math.sqrt(float(measured[angular].mean())) * 1e3 if angular.any() else None,
        )
    return found


def _notes(
    design: Design, causes: Sequence[Cause], weak: Sequence[WeakChange], verdict: CheckVerdict, stray: bool
) -> tuple[str, ...]:
    notes = [
        f"the stops do not tell {design.name_of(cause.alternative)} from {', '.join(cause.confounded)}"
        for cause in causes
        if cause.confounded
    ]
    if stray:
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
    hidden = int(np.sum(~design.visible[own] | (design.steps[own] > 1.0)))
    if verdict == "valid" and hidden:
        noise_mm = 1e3 * max(arm.of_points.noise for arm in design.belief.arms.values())
        notes.append(
            f"{hidden} of {counted(len(own), 'parameter')} of the arms show a change only from more than 0.05 mm or"
            f" 50 µrad: where it moves the SMR by {VISIBLE:g} times what a measurement scatters ({noise_mm:.3f} mm)"
        )
    return tuple(notes)


def _amount(one: WeakChange) -> str:
    """The size of a change that is found, for people."""
    factor, unit = {"m": (1e3, "mm"), "rad": (1e6, "µrad")}.get(one.unit, (1.0, one.unit))
    return f"{plain(factor * one.detected, 2)} {unit}"


_FEWEST_STOPS = 6
"""Fewest stops to name a change: six parameters of a moved base, and as many data to show whether they explain it."""


NOTHING_YET = SequentialState(0, sure=False, changed=False, valid=False, log_evidence=0.0, log_valid=0.0, p_value=1.0)
"""State of the test before the first stop."""


class SequentialTest:
    """Sequential test of a calibration: add stops until ``state.sure``, then ask for the conclusion.

    The probability of a false alarm is at most ``FALSE_ALARM`` over all stops, that of calling a visible change valid
    at most ``MISS``.
    """

    def __init__(self, design: Design, planned: int) -> None:
        """Prepare the test; it ends after ``planned`` stops at the latest."""
        self._design = design
        self._planned = planned
        self._readings: dict[str, Readings] = {}
        self.state = NOTHING_YET
        self._stops: StopRows | None = None

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
            self.state = judged(self._design, self._stops, self._planned, self.state)
        return self.state

    def conclusion(self) -> CheckResult:
        """Return the result from all stops so far, with the change that explains them, but without the stops.

        Raises
        ------
        InputError
            If there is no stop.
        """
        if self._stops is None:
            raise InputError("check: no stop was measured; there is nothing to conclude from")
        return concluded(self._design, self._stops, self.state, self._planned)


def design_of(belief: CheckBelief) -> Design:
    """Define what a check of a cell tests: directions by visible steps, and alternatives."""
    least = directions_of(belief)
    by_arm = {name: motions(belief, name, arm.measured, least) for name, arm in belief.arms.items()}
    moved, shown = visibility(belief, least, by_arm)
    located = np.array([one.kind == "tracker" and belief.station is not None for one in least])
    visible = (shown >= VISIBLE / MOST_STEPS) & ~located  # a located station is uncertain by as much
    steps = np.where(visible, np.maximum(1.0, VISIBLE / np.maximum(shown, 1e-300)), 1.0)
    directions = tuple(replace(one, step=one.step * size) for one, size in zip(least, steps.tolist(), strict=True))
    alternatives = tuple(alternatives_of(directions))
    by_arm = {name: its * steps[:, None, None] for name, its in by_arm.items()}
    return Design(belief, directions, alternatives, by_arm, steps, moved * steps, visible)


def judged(design: Design, stops: StopRows, planned: int, before: SequentialState = NOTHING_YET) -> SequentialState:
    """Evaluate the test after one more stop than ``before``."""
    moments, count = Moments.of(stops), len(stops.stop_ends)
    test = MinPValueTest.of(moments, design.alternatives)
    least, early_valid = test.least(moments), log_valid(moments, design.alternatives, design.visible)
    evidence = -math.log(min(max(test.bound(least) * planned, 1e-300), 1.0))
    changed = before.changed or evidence >= -math.log(design.early_alarm)
    valid = not changed and early_valid >= -math.log(SPENT_EARLY * MISS)
    if not changed and not valid and count >= planned:
        changed = test.significant(least, design.last_alarm)
    sure = valid or count >= planned or (changed and count >= _FEWEST_STOPS and _named(design, stops))
    squares = float(moments.white @ moments.white)
    p_value = float(scipy.special.chdtrc(moments.degrees, squares)) if moments.degrees else 1.0
    return SequentialState(count, sure, changed, valid, evidence, early_valid, p_value)


def _named(design: Design, stops: StopRows) -> bool:
    """Return whether the changes explain the stops and no alternatives remain that more stops could exclude."""
    causes, explained = explain(design, stops)
    return explained and not any(cause.undecided for cause in causes)
