"""Accepted effects: reviewed terms of the final model with their evidence, as stored in results."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import TRANSMISSION_ERROR, UNKNOWN, ArmData, CandidateLaw, ModelTerm
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.outcome import HeldOut
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    CurveRecord,
    CycleBand,
    Evidence,
    LawRecord,
    Picture,
    Place,
    PlaceMovement,
    RunnerUp,
    TermDescription,
)
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import Posteriors, SearchResult
from cellapp.ground.results import Estimate
from cellapp.robot.effects import (
    EFFECTS,
    ActsOn,
    EffectColumn,
    EffectTerm,
    InputVariable,
    LawForm,
    place_in_words,
    term_to_json,
)
from cellapp.robot.effects.data_driven import FIELD_LENGTH, ActedOn, Quantity, Variable, data_driven_form
from cellapp.robot.effects.effect import is_borrowed, is_contradiction, is_unnamed
from cellapp.robot.effects.unknown import acted_directions
from cellapp.robot.kinematics.transforms import Array, rms_length
from cellapp.robot.model import ArmModel


def accepted_effects(
    found: SearchResult, model: ArmModel, held_out: HeldOut, after_mm: float, probable: Posteriors
) -> tuple[tuple[EffectTerm, ...], tuple[AcceptedEffect, ...]]:
    """Return the reviewed terms of the final model, in order, and the evidence of those that are named, with the
    held-out error without each.

    ``after_mm`` is the held-out rms error with all of them. Terms of data-driven effects carry their description.
    """
    fit, terms, accepted = found.fit, [], []
    for number, review in enumerate(found.reviews):
        term, columns = model.effects[number], fit.term_columns(number)
        if is_unnamed(term.law):
            terms.append(term)
            continue
        described = describe(found.data, fit, number) if term.slug == UNKNOWN else None
        if described is not None:
            term = replace(term, note=described.sentence)
        evidence = Evidence(
            statistic=review.score,
            corrected_p=review.p_value,
            heldout_mm=BeforeAfter(before=held_out.rms_mm(model_without(found, (number,))), after=after_mm),
        )
        where = Place(
            joints=tuple(sorted({column.joint + 1 for column in columns if column.joint is not None})),
            acts_on=tuple(dict.fromkeys(column.where for column in columns)),
            channel=None if described is None else described.channel,
            variables=None if described is None else described.variables,
        )
        terms.append(term)
        accepted.append(
            accepted_effect(
                term,
                where,
                evidence,
                probable.terms[number],
                runners_up=review.alternatives,
                cycles=_cycles(fit, number, term) if term.slug == TRANSMISSION_ERROR else None,
                movements=term_movements(fit, number) or None,
                description=described,
            )
        )
    return tuple(terms), tuple(accepted)


def model_without(found: SearchResult, out: Collection[int]) -> ArmModel:
    """Return the model without the terms ``out``, the other parameters fitted again, linear about the fit."""
    fit = found.fit
    kept = np.all([fit.layout.all_but(number) for number in out], axis=0)
    estimated, first, mean = fit.identification.estimated, fit.layout.geometric, fit.geometry_mean
    deviation = fit.model.geometry.vector()[list(estimated.columns)] - mean
    values = np.concatenate([deviation, fit.identification.effect_values])
    residual = fit.residual + sum(fit.signal(number) for number in out)
    residual = fit.rows[kept] @ residual - (fit.precision * values)[kept]
    values[kept] += fit.normal.take(kept).solver(fit.precision[kept])(residual)
    effects = tuple(
        replace(effect, values=values[fit.layout.parameters(other)])
        for other, effect in enumerate(fit.model.effects)
        if other not in out
    )
    geometry = estimated.moved(fit.model.geometry, mean + values[:first])
    return replace(fit.model, geometry=geometry, effects=effects)


def accepted_effect(
    term: EffectTerm,
    where: Place,
    evidence: Evidence,
    posterior: float,
    *,
    runners_up: tuple[RunnerUp, ...] = (),
    **details: Any,
) -> AcceptedEffect:
    """Build an accepted effect from a term and its evidence; ``details`` are further fields of ``AcceptedEffect``.

    ``posterior`` is NaN if it was not computed.
    """
    effect, shared = EFFECTS[term.slug], term_to_json(term)
    return AcceptedEffect(
        effect=term.slug,
        title=effect.title,
        law=LawRecord(name=shared["law"], constants=shared["constants"]),
        where=where,
        parameters={name: Estimate.model_validate(shared["parameters"][name]) for name in term.law_names},
        evidence=evidence,
        runners_up=runners_up,
        posterior=posterior if math.isfinite(posterior) else None,
        law_misfit=term.law_misfit if term.modulations else None,
        meaning=effect.meaning_of(term.law).at(place_in_words(where.acts_on)),
        **details,
    )


def _cycles(fit: JointFit, number: int, term: EffectTerm) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution of a periodic term, by the values of the final model."""
    here = fit.layout.parameters(number)
    return dominant_cycles(fit.term_columns(number), term.values, fit.identification.covariance[here, here])


# ---------------------------------------------------------------------------------------------------------------------
# Displacement of the SMR by each joint or frame of an effect: it orders the parameters and pictures for the reader.


def term_movements(fit: JointFit, number: int) -> tuple[PlaceMovement, ...]:
    """Return the rms displacement of the SMR at the readings by each joint or frame that a term acts on, largest first.

    Parameters are those of the term's law. Its discrepancy term also moves the SMR, but has no named parameters.
    """
    columns, named = fit.term_columns(number), len(fit.terms[number].names)
    signals = fit.term_values(number)[:, None] * fit.term_rows(number)
    found = []
    for where in dict.fromkeys(column.where for column in columns):
        here = [k for k, column in enumerate(columns) if column.where == where]
        names = tuple(columns[k].name for k in here if k < named)
        found.append(
            PlaceMovement(where=where, parameters=names, moves_mm=1e3 * rms_of_whitened(fit, signals[here].sum(axis=0)))
        )
    return tuple(sorted(found, key=lambda place: -place.moves_mm))


def rms_of_whitened(fit: JointFit, whitened: Array) -> float:
    """Return the rms length [m] of whitened displacements (3 n,) over those readings of a fit that are positions."""
    here = fit.identification.positions
    moved = np.linalg.solve(fit.white.transpose(2, 0, 1)[here], whitened.reshape(3, -1).T[here, :, None])[..., 0]
    return rms_length(np.asarray(moved, dtype=np.float64))


# -- Description of a data-driven term: place, variables, and a short formula if one fits as well -------------------


_AS_GOOD = 0.95
"""Share of what the curve explains at which a formula with fewer parameters describes it."""


def describe(data: ArmData, fit: JointFit, number: int) -> TermDescription:
    """Describe a data-driven term of a fit, or one with a law of the library.

    ``size_um`` excludes the part that the other parameters can explain.
    """
    term, size_um = fit.terms[number], _visible_rms(fit, number) * 1e6
    formula = ""
    if is_borrowed(term.law):
        columns = fit.term_columns(number)
        acts_on = ", ".join(dict.fromkeys(column.where for column in columns))
        names = tuple(sorted(variable.value for variable in term.law.form.variables))
        if not is_contradiction(term.law):  # of the joints' own angles
            names = tuple(sorted({f"q{column.joint + 1}" for column in columns if column.joint is not None}))
        said = term.note
    else:
        form = data_driven_form(term.law)
        acts_on, names = form.acts_on.name, tuple(variable.name for variable in form.inputs)
        if form.is_field:
            length = term.law.constants[FIELD_LENGTH.name]
            said = (
                f"{acts_on} depends on the position, a field over the workspace that changes within some {length:.1g} m"
            )
        else:
            values = [variable.values(data.context) for variable in form.inputs]
            formula = _formula(data, fit, number, form.acts_on, form.inputs, values)
            said = f"{acts_on} depends on {' and '.join(names)}{f', about {formula}' if formula else ''}"
    return TermDescription(
        channel=acts_on,
        variables=names,
        size_um=size_um,
        formula=formula,
        sentence=f"{said}; {size_um:.0f} µm rms at the SMR",
    )


def _visible_rms(fit: JointFit, number: int) -> float:
    """Return the rms displacement [m] by a term, without the part that the other parameters of the model can explain.

    That part is arbitrary: for instance a shift of the base pose cancels a constant in a slow drift.
    """
    visible = fit.residual_without(number).projector.project(fit.signal(number))
    return rms_of_whitened(fit, visible)


def _formula(
    data: ArmData, fit: JointFit, number: int, acts_on: ActedOn, variables: Sequence[Variable], values: Sequence[Array]
) -> str:
    """Return the best short formula; empty if it describes the term less well than the curve does.

    It is good enough if its score is higher, having fewer parameters, or if it explains nearly as much.
    """
    if any(not np.isfinite(one).all() for one in values):
        return ""
    basis = fit.term_columns(number)[0]
    directions = [] if basis.joint is not None else acted_directions(data.context, acts_on)
    found = formulas(variables, values)
    candidates = []
    for formula in found:
        columns = _columns(formula.text, formula.values, basis, directions)
        law = LawForm(formula.text, formula.text).law(tried=len(found))
        candidates.append(CandidateLaw(UNKNOWN, law, columns, fit.displacements(columns)))
    if not candidates:
        return ""
    residual = fit.residual_without(number)
    best = LawScan.of(candidates, residual.projector).ranked(residual)[0]
    rows = fit.term_rows(number)
    better = best.value >= residual.bic_gain(rows)
    as_good = best.explained_share >= _AS_GOOD * residual.explained_share(rows)
    return best.candidate.law.name if better or as_good else ""


def _columns(text: str, values: Array, basis: EffectColumn, directions: Sequence[Array]) -> tuple[EffectColumn, ...]:
    """Return the columns of a formula in the place of ``basis``, all in one block; for a shift one a direction."""
    common = ("", text, -np.inf, np.inf, basis.acts_on, basis.index)
    if basis.acts_on is ActsOn.JOINT:
        return tuple(EffectColumn(f"{text}#{k}", *common, offset=values[:, k]) for k in range(values.shape[1]))
    return tuple(
        EffectColumn(f"{text}#{k}#{d}", *common, shift_M=values[:, k, None] * direction)
        for k in range(values.shape[1])
        for d, direction in enumerate(directions)
    )


# -- Short formulas that may describe a data-driven term: functions of one or two variables with a free factor --------


_PERIOD_COUNTS = np.arange(0.5, 24.25, 0.25)
"""Numbers of periods of an oscillation in the run, in steps of a quarter: finer than a run of few periods resolves."""
_DECAY_SHARES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of a decay as shares of the run: shorter ones cover too few stops, longer ones are straight lines."""
_HARMONICS = 8
"""Highest harmonic of an angle."""
_ABSOLUTE_HARMONICS = 4
"""Highest harmonic of an absolute sine or cosine, which has twice as many cycles."""
_STEP_WIDTHS = (0.1, 0.2, 0.4, 0.8)
"""Widths of a smooth step as shares of a variable's range."""
_PAIR_STEP_WIDTHS = (0.3, 0.6, 1.0, 1.6)
"""Widths of a smooth step of two angles [rad]."""
_PAIR_FACTORS = ((1, 1), (1, -1), (1, 0.5), (0.5, 1), (1, -0.5), (0.5, -1), (2, 1), (1, 2))
"""Factors of two variables in one argument: sums and differences, as for coupled joints, with factors 1, 2 and 1/2."""


@dataclass(frozen=True, eq=False)
class Formula:
    """A formula: its text, and the values (n, k) of its k functions, each with a free factor."""

    text: str
    values: Array


def formulas(variables: Sequence[Variable], values: Sequence[Array]) -> list[Formula]:
    """Generate formulas of one or two variables whose values (n,) are finite and vary."""
    found: list[Formula] = []
    for variable, x in zip(variables, values, strict=True):
        name = variable.name
        found += [Formula(f"c {name}", x[:, None]), Formula(f"c {name}^2", x[:, None] ** 2)]
        found.append(Formula(f"c |{name}|", np.abs(x)[:, None]))
        found += _of_time(x) if variable.quantity is Quantity.TIME else _of_one(variable, x)
    if len(variables) == 2:
        found += _of_two(variables[0].name, variables[1].name, values[0], values[1])
    return [one for one in found if np.isfinite(one.values).all() and np.ptp(one.values, axis=0).max() > 0.0]


def _of_time(t: Array) -> Iterator[Formula]:
    """Generate oscillations and decays."""
    run_s = float(np.ptp(t)) or 1.0
    for count in _PERIOD_COUNTS:
        period = run_s / float(count)
        yield Formula(f"c sin(2 pi time / {period / 60.0:.3g} min + phase)", _waves(2.0 * np.pi * t / period))
    for share in _DECAY_SHARES:
        text = f"c exp(-time / {share * run_s / 60.0:.3g} min)"
        yield Formula(text, np.exp(-(t - t.min()) / (share * run_s))[:, None])


def _of_one(variable: Variable, x: Array) -> Iterator[Formula]:
    """Generate harmonics of an angle and their absolute values; smooth steps of any variable."""
    name, is_angle = variable.name, variable.is_angle
    for k in range(1, _HARMONICS + 1 if is_angle else 1):
        yield Formula(f"c sin({_times(k, name)} + phase)", _waves(k * x))
    for k in range(1, _ABSOLUTE_HARMONICS + 1 if is_angle else 1):
        label = _times(k, name)
        yield Formula(f"c |sin({label})|", np.abs(np.sin(k * x))[:, None])
        yield Formula(f"c |cos({label})|", np.abs(np.cos(k * x))[:, None])
    extent = float(np.ptp(x)) or 1.0
    for width in _STEP_WIDTHS:
        text = f"c tanh({name} / {width * extent:.2g})"
        yield Formula(text, np.tanh((x - np.median(x)) / (width * extent))[:, None])


def _of_two(v: str, w: str, x: Array, y: Array) -> Iterator[Formula]:
    """Generate waves and smooth steps of sums, and products."""
    for a, b in _PAIR_FACTORS:
        total = a * x + b * y
        text = f"{_times(a, v)} {'+' if b > 0 else '-'} {_times(abs(b), w)}"
        yield Formula(f"c sin({text} + phase)", _waves(total))
        for width in _PAIR_STEP_WIDTHS:
            yield Formula(f"c tanh(({text}) / {width:g})", np.tanh(total / width)[:, None])
    yield Formula(f"c {v} {w}", (x * y)[:, None])
    for f, first in ((np.sin, "sin"), (np.cos, "cos")):
        for g, second in ((np.sin, "sin"), (np.cos, "cos")):
            yield Formula(f"c {first}({v}) {second}({w})", (f(x) * g(y))[:, None])


def _waves(phase: Array) -> Array:
    """Return cosine and sine (n, 2)."""
    return np.stack([np.cos(phase), np.sin(phase)], axis=1)


def _times(factor: float, name: str) -> str:
    return name if factor == 1 else f"{factor:g} {name}"


# -- Dominant cycles per revolution of periodic joint errors, from the power of their Fourier coefficients ------------


_BAND = (0.1, 0.9)
"""Shares of the cumulative power that bound the dominant cycles: the middle 80 %."""


def dominant_cycles(columns: Sequence[EffectColumn], values: Array, covariance: Array) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution by joint (key: its number), from wave columns with values (m,) [rad].

    ``covariance`` (m, m) of the values gives the standard error of each joint's rms: rms^2 is half the sum of the
    squared coefficients.
    """
    joints = np.array([-1 if column.cycles is None or column.joint is None else column.joint for column in columns])
    cycles, found = np.array([column.cycles or 0 for column in columns]), {}
    for joint in np.unique(joints[(joints >= 0) & (values != 0.0)]).tolist():
        own = np.where(joints == joint, values, 0.0)
        power = np.bincount(cycles, 0.5 * own**2)
        rms = float(np.sqrt(power.sum()))
        first, last = np.searchsorted(np.cumsum(power) / power.sum(), _BAND).tolist()
        error = math.sqrt(max(float(own @ covariance @ own), 0.0)) / (2.0 * rms)
        found[str(joint + 1)] = CycleBand(
            first=first,
            last=min(last, len(power) - 1),
            peak=int(np.argmax(power)),
            rms_urad=rms * 1e6,
            rms_standard_error_urad=error * 1e6,
        )
    return found


# -- Pictures of a fit: each term's partial residuals in its own place, against the variable of the term ------------
#
# The partial residual is residual + term: the readings minus everything else in the model. A joint offset is estimated
# along the direction J_j in which the joint moves the SMR,
#
#     dq_j = J_j^T r / (J_j^T J_j)   (whitened),
#
# a shift of the SMR along its main direction or, if it has none, along the computed shift.

_MOST_JOINTS = 6
"""Most joints of one term that are shown: all joints of the usual arms."""
_LEAST_LEVER = 0.05
"""Share of the longest lever below which a joint is not shown: its offsets hardly move the SMR."""
_LEAST_OWN_LEVER = 0.2
"""Share of a joint's median lever below which a reading is not shown: noise over lever would fill the picture."""
_MOST_DRAWN = 40
"""Most cycles per revolution of a line drawn over a whole turn: more, below 9 degrees a cycle, are too dense."""
_ONE_DIRECTION = 0.9
"""Share of a shift's sum of squares in one direction at which it is shown along that direction, with its sign."""
_NO_SHIFT = 1e-9
"""Length [m] below which a shift has no direction."""
_CYCLE_POINTS = 181
"""Points of a curve over one cycle; twice as many over a turn."""
_POINTS_A_CYCLE = 7
"""Points for each cycle of a curve over a turn."""


def pictures(data: ArmData, fit: JointFit) -> tuple[Picture, ...]:
    """Draw one picture for each joint with a lever that a term offsets, or one for the term's shift of the SMR.

    The term that moves the SMR most comes first, and within a term the joint that moves it most. A data-driven term of
    two variables has one picture against each of them.
    """
    levers = np.sqrt(np.mean(np.einsum("cjn,cjn->jn", fit.by_joint, fit.by_joint), axis=1))
    found: list[Picture] = []
    movements = {number: term_movements(fit, number) for number in range(len(fit.terms))}
    for number in sorted(movements, key=lambda number: -movements[number][0].moves_mm):
        one = _TermPictures(data, fit, number)
        columns = fit.term_columns(number)
        joint_of = {column.where: column.joint for column in columns if column.joint is not None}
        joints = [joint_of[place.where] for place in movements[number] if place.where in joint_of]
        for joint in joints[:_MOST_JOINTS]:
            if levers[joint] > _LEAST_LEVER * levers.max():
                found += one.of_joint(joint)
        if not joints:
            # a tilting joint axis is shown against its own joint; all other columns shift the SMR together
            axis_of = {column.where: column.index if column.acts_on is ActsOn.AXIS else None for column in columns}
            for axis in dict.fromkeys(axis_of[place.where] for place in movements[number]):
                found += one.of_shift(axis)
    return tuple(picture for picture in found if picture.x)


@dataclass(frozen=True, eq=False)
class _JointView:
    """Columns of a joint to show together, their horizontal axis, and their curve over a turn or a cycle."""

    columns: Sequence[int]
    x_label: str
    x: Array
    title: str = ""
    curve: CurveRecord | None = None


@dataclass(frozen=True, eq=False)
class _TermPictures:
    """Pictures of one term of a fit."""

    data: ArmData
    fit: JointFit
    number: int

    @property
    def _covariance(self) -> Array:
        """Covariance of the term's parameters."""
        here = self.fit.layout.parameters(self.number)
        return self.fit.identification.covariance[here, here]

    @property
    def _title(self) -> str:
        term = self.fit.terms[self.number]
        title = EFFECTS[term.slug].title
        if term.slug != UNKNOWN or is_borrowed(term.law):
            return title
        acts_on = data_driven_form(term.law).acts_on
        return title if acts_on.acts_on is ActsOn.JOINT else f"{title}, {acts_on.name}"

    def of_joint(self, joint: int) -> list[Picture]:
        """Draw the offset of a joint (from 0)."""
        fit, n = self.fit, len(self.data)
        lever = fit.by_joint[:, joint]
        square = np.maximum(np.einsum("cn,cn->n", lever, lever), 1e-300)
        rest = np.einsum("cn,cn->n", lever, fit.residual.reshape(3, n)) / square
        shown = square > _LEAST_OWN_LEVER**2 * np.median(square)
        columns, values, covariance = fit.term_columns(self.number), fit.term_values(self.number), self._covariance
        found = []
        for view in self._joint_views(joint):
            own = list(view.columns)
            offsets = np.array([columns[k].offset for k in own]).reshape(-1, n)
            band = _standard_deviation(offsets, covariance[np.ix_(own, own)])
            title, labels = f", joint {joint + 1}{view.title}", (view.x_label, f"offset of joint {joint + 1} [urad]")
            arrays = (view.x, rest, values[own] @ offsets, band, shown)
            found.append(self._picture(title, labels, *arrays, view.curve))
        return found

    def _joint_views(self, joint: int) -> list[_JointView]:
        """Return the views of one joint: waves by cycle count, all other columns together."""
        columns = self.fit.term_columns(self.number)
        own = [k for k, column in enumerate(columns) if column.joint == joint]
        cycles = {k: count for k in own if (count := columns[k].cycles) is not None}
        if not own or len(cycles) < len(own):
            axes = axes_of(self.data, self.fit.terms[self.number], joint)
            return [_JointView(own, label, x) for label, x in axes]
        return self._periodic_views(joint, cycles)

    def _periodic_views(self, joint: int, cycles: dict[int, int]) -> list[_JointView]:
        """Return views of waves over a whole turn; fast lines, which would blur there, have their cycles overlaid."""
        angle = np.degrees(self.data.readings.q[:, joint])
        smooth = self.fit.terms[self.number].smooth is not None
        fast = [] if smooth else sorted({count for count in cycles.values() if count > _MOST_DRAWN})
        slow = [k for k, count in cycles.items() if count not in fast]
        views = []
        if slow:
            points = max(2 * _CYCLE_POINTS - 1, _POINTS_A_CYCLE * max(cycles[k] for k in slow) + 1)
            folded = np.remainder(angle + 180.0, 360.0) - 180.0
            curve = self._curve(slow, np.linspace(-180.0, 180.0, points))
            views.append(_JointView(slow, f"joint {joint + 1} [deg]", folded, curve=curve))
        while fast:
            base = math.gcd(*fast)
            base = base if base > _MOST_DRAWN else fast[0]
            period = 360.0 / base
            own = [k for k, count in cycles.items() if count in fast and count % base == 0]
            label = f"joint {joint + 1}, within a cycle of {period:.3g} deg [deg]"
            title = f", its {base} cycles per revolution laid over one another"
            curve = self._curve(own, np.linspace(0.0, period, _CYCLE_POINTS))
            views.append(_JointView(own, label, np.remainder(angle, period), title, curve))
            fast = [count for count in fast if count % base]
        return views

    def _curve(self, own: Sequence[int], angle_deg: Array) -> CurveRecord:
        """Return the curve of waves, also at angles without readings."""
        columns = self.fit.term_columns(self.number)
        waves = np.array([wave(np.radians(angle_deg)) for k in own if (wave := columns[k].wave) is not None])
        chosen = list(own)
        band = _standard_deviation(waves, self._covariance[np.ix_(chosen, chosen)])
        value = self.fit.term_values(self.number)[chosen] @ waves
        return CurveRecord(x=rounded(angle_deg), value=rounded(value * 1e6), band=rounded(band * 1e6))

    def of_shift(self, axis: int | None) -> list[Picture]:
        """Draw the shift of the SMR by the columns that act on the axis of joint ``axis`` (from 0), by all if None."""
        term, columns = self.fit.terms[self.number], self.fit.term_columns(self.number)
        here = self.fit.identification.positions
        own = [k for k, one in enumerate(columns) if one.shift_M is not None and axis in (None, one.index)]
        shifts = np.array([columns[k].shift_M for k in own]).reshape(-1, len(self.data), 3)[:, here]
        shift_M = np.einsum("k,kna->na", self.fit.term_values(self.number)[own], shifts)
        direction_M, y_label, along = _shift_direction(shift_M)
        rest = np.einsum("na,na->n", direction_M, self.fit.identification.residuals[here])
        computed = np.einsum("na,na->n", direction_M, shift_M)
        along_columns = np.einsum("kna,na->kn", shifts, direction_M)
        band = _standard_deviation(along_columns, self._covariance[np.ix_(own, own)])
        shown = np.asarray(direction_M.any(axis=1))
        title = along if axis is None else f", joint {axis + 1}{along}"
        return [
            self._picture(title, (x_label, y_label), x[here], rest, computed, band, shown)
            for x_label, x in axes_of(self.data, term, None, axis)
        ]

    def _picture(
        self,
        title: str,
        labels: tuple[str, str],
        x: Array,
        rest: Array,
        computed: Array,
        band: Array,
        shown: NDArray[np.bool_],
        curve: CurveRecord | None = None,
    ) -> Picture:
        """Sort by ``x``, thin out, and convert to micrometres or microradians.

        ``rest`` (n,) is the residual, ``band`` the standard deviation of ``computed``, ``shown`` a mask of the
        readings; all in SI units in the order of the readings.
        """
        places = np.flatnonzero(shown & np.isfinite(x))
        places = places[np.argsort(x[places], kind="stable")]
        if len(places) > _MOST_POINTS:
            places = places[np.linspace(0, len(places) - 1, _MOST_POINTS).astype(np.intp)]
        return Picture(
            title=f"{self._title}{title}",
            effect=self.fit.terms[self.number].slug,
            x_label=labels[0],
            y_label=labels[1],
            x=rounded(x[places]),
            measured=rounded((rest + computed)[places] * 1e6),
            computed=rounded(computed[places] * 1e6),
            band=rounded(band[places] * 1e6),
            curve=curve,
        )


def _shift_direction(shift_M: Array) -> tuple[Array, str, str]:
    """Return the unit direction (n, 3) of the shown shifts (zero without one), the axis label and a title suffix.

    One direction serves for all if it holds nearly all of the shifts; else each has its own.
    """
    _, sizes, directions = np.linalg.svd(shift_M, full_matrices=False)
    if sizes[0] ** 2 >= _ONE_DIRECTION * np.sum(sizes**2) and sizes[0] > 0.0:
        one = directions[0] * np.sign(directions[0][np.argmax(np.abs(directions[0]))])
        # adding zero turns minus zero into zero
        text = ", ".join(f"{round(value, 2) + 0.0:.2f}" for value in one.tolist())
        direction = np.broadcast_to(one, shift_M.shape)
        return direction, "shift of the SMR that way [um]", f", along ({text}) of the tracker frame"
    length = np.linalg.norm(shift_M, axis=1)[:, None]
    direction = np.where(length > _NO_SHIFT, shift_M / np.maximum(length, _NO_SHIFT), 0.0)
    return direction, "shift of the SMR along the effect [um]", ""


def _standard_deviation(columns: Array, covariance: Array) -> Array:
    """Return the standard deviation (n,) of the sum of columns (k, n) whose coefficients have ``covariance`` (k, k)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("kn,kn->n", columns, covariance @ columns), 0.0)))


# -- Horizontal axis of a term's picture: the main variable of the term, with its label and unit ----------------------


Axis = tuple[str, Array]
"""Label and values (n,)."""
_LOADED_JOINT = 1
"""Joint (from 0) whose gravity torque represents the load on the whole arm: the shoulder carries it on most arms."""


def axes_of(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None = None) -> list[Axis]:
    """Return the axes to show a term against; for a data-driven term one for each of its variables.

    ``joint`` (from 0) is the joint that the term offsets; ``beside`` a joint on which the term acts without an offset.
    """
    if term.slug != UNKNOWN or is_borrowed(term.law):
        return [_axis_of_effect(data, term, joint, beside)]
    axes = (_axis(data, variable) for variable in data_driven_form(term.law).inputs)
    return [(label, values) for label, values in axes if np.isfinite(values).any()]


def _axis(data: ArmData, variable: Variable) -> Axis:
    quantity = variable.quantity
    return quantity.label.format((variable.joint or 0) + 1), variable.values(data.context) * quantity.factor


def _axis_of_effect(data: ArmData, term: ModelTerm, joint: int | None, beside: int | None) -> Axis:
    """Return the axis of a library effect: the first that applies of motion, time, temperature, field, load, angle."""
    variables = term.law.form.variables or EFFECTS[term.slug].variables
    context, now = data.context, data.conditions
    torque = InputVariable.TORQUE in variables
    if joint is not None and (torque or variables & {InputVariable.STEP, InputVariable.APPROACH}):
        approach = context.approach[:, joint] if InputVariable.APPROACH in variables else None
        if InputVariable.STEP in variables and now.step is not None:
            return _axis(data, Variable(Quantity.STEP, joint))
        if torque:
            label, load = _axis(data, Variable(Quantity.TORQUE, joint))
            return (label, load) if approach is None else (f"{label}, signed by the approach", load * approach)
        if approach is not None:
            return f"approach direction of joint {joint + 1}", approach
    if InputVariable.TIME in variables and now.time_s is not None and np.isfinite(now.time_s).any():
        return _axis(data, Variable(Quantity.TIME))
    if InputVariable.AIR_TEMPERATURE in variables and now.air_c is not None:
        return _axis(data, Variable(Quantity.TEMPERATURE))
    if InputVariable.JOINT_TEMPERATURE in variables and now.joints_c is not None:
        if joint is None:
            return "mean temperature of the joints [degC]", now.joints_c.mean(axis=1)
        return f"temperature of joint {joint + 1} [degC]", now.joints_c[:, joint]
    if InputVariable.OTHER_ARM in variables and now.other_moment_M is not None:
        return "moment of the other arm [Nm]", np.linalg.norm(now.other_moment_M, axis=1)
    if InputVariable.BEAM in variables:
        return _axis(data, Variable(Quantity.RANGE))
    if InputVariable.INCIDENCE in variables and context.smr_normal is not None:
        return _axis(data, Variable(Quantity.INCIDENCE))
    if joint is None and torque:
        return _axis(data, Variable(Quantity.TORQUE, min(_LOADED_JOINT, context.joints - 1)))
    return _axis(data, Variable(Quantity.JOINT_ANGLE, (beside or 0) if joint is None else joint))


# -- One picture of a term: measured and computed values against the variable of the term, thinned and sorted ---------


_MOST_POINTS = 600
"""Most points of one picture: as many as a figure of that width in pixels can show."""
_DIGITS = 5
"""Significant digits of its numbers: far finer than a figure, and a third of the size in JSON."""


def rounded(values: Array) -> tuple[float, ...]:
    """Round values to the digits that a picture needs."""
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
