"""Accepted effects: reviewed terms of the final model with their evidence, as stored in results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.candidates import CandidateLaw
from cellapp.estimation.discovery.held_out import HeldOut
from cellapp.estimation.discovery.joint_fit import JointFit, fitted_model
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    Contradiction,
    Correlation,
    CycleBand,
    EffectMeaning,
    Evidence,
    LawRecord,
    Place,
    PlaceMovement,
    RunnerUp,
    TermDescription,
)
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import Posteriors, SearchResult
from cellapp.estimation.discovery.terms import TRANSMISSION_ERROR, UNKNOWN, without_term
from cellapp.ground.errors import NotConverged
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS, Channel, EffectColumn, EffectTerm, LawForm, place_in_words, term_to_json
from cellapp.robot.effects.contradiction import contradicted_effect, is_borrowed, is_contradiction
from cellapp.robot.effects.data_driven import DataChannel, Quantity, Variable, data_driven_form
from cellapp.robot.effects.field import FIELD_LENGTH
from cellapp.robot.effects.unknown import channel_directions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


def accepted_effects(
    found: SearchResult, model: ArmModel, held_out: HeldOut, after_mm: float, probable: Posteriors
) -> tuple[tuple[EffectTerm, ...], tuple[AcceptedEffect, ...]]:
    """Return the reviewed terms of the final model, in order, and their evidence with the held-out error without each.

    ``after_mm`` is the held-out rms error with all of them. Terms of data-driven effects carry their description.
    """
    fit, terms, accepted = found.fit, [], []
    for number, review in enumerate(found.reviews):
        term, columns = model.effects[number], fit.term_columns(number)
        described = describe(found.data, fit, number) if term.slug == UNKNOWN else None
        if described is not None:
            term = replace(term, note=described.sentence)
        evidence = Evidence(
            statistic=review.score,
            corrected_p=review.p_value,
            heldout_mm=BeforeAfter(before=_error_without(found, number, held_out), after=after_mm),
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
                runners_up=review.rivals,
                correlated_with=_most_correlated(fit, number),
                cycles=_cycles(fit, number, term) if term.slug == TRANSMISSION_ERROR else None,
                movements=term_movements(fit, number) or None,
                description=described,
            )
        )
    return tuple(terms), tuple(accepted)


def _error_without(found: SearchResult, number: int, held_out: HeldOut) -> float:
    """Return the held-out rms error [mm] without a term, the others fitted again; NaN if that fit does not converge."""
    try:
        return held_out.rms_mm(fitted_model(found.data, without_term(found.fit.terms, number)))
    except NotConverged:
        return math.nan


def accepted_effect(
    term: EffectTerm,
    where: Place,
    evidence: Evidence,
    posterior: float,
    *,
    runners_up: tuple[RunnerUp, ...] = (),
    correlated_with: Correlation | None = None,
    **details: Any,
) -> AcceptedEffect:
    """Build an accepted effect from a term and its evidence; ``details`` are further fields of ``AcceptedEffect``.

    ``posterior`` is NaN if it was not computed.
    """
    effect, shared = EFFECTS[term.slug], term_to_json(term)
    indistinguishable = (rival.effect for rival in runners_up if not rival.distinguishable)
    meaning = effect.meaning_of(term.law).at(place_in_words(where.acts_on))
    return AcceptedEffect(
        effect=term.slug,
        title=effect.title,
        law=LawRecord(name=shared["law"], constants=shared["constants"]),
        where=where,
        parameters={name: Estimate.model_validate(shared["parameters"][name]) for name in term.law_names},
        evidence=evidence,
        answer_set=(term.slug, *indistinguishable),
        runners_up=runners_up,
        correlated_with=correlated_with,
        posterior=posterior if math.isfinite(posterior) else None,
        law_misfit=term.law_misfit if term.modulations else None,
        meaning=EffectMeaning.model_validate(meaning, from_attributes=True),
        **details,
    )


def contradictions(terms: Sequence[EffectTerm], accepted: Sequence[AcceptedEffect]) -> tuple[Contradiction, ...]:
    """Return the accepted effects that look like an effect of the library with impossible values."""
    return tuple(
        Contradiction(
            effect=contradicted_effect(term.law).slug,
            joints=effect.where.joints,
            size_um=math.nan if effect.description is None else effect.description.size_um,
            sentence=term.note,
        )
        for term, effect in zip(terms, accepted, strict=True)
        if is_contradiction(term.law)
    )


def _cycles(fit: JointFit, number: int, term: EffectTerm) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution of a periodic term, by the values of the final model."""
    here = fit.layout.parameters(number)
    return dominant_cycles(fit.term_columns(number), term.values, fit.identification.covariance[here, here])


def _most_correlated(fit: JointFit, number: int) -> Correlation | None:
    """Find the geometric parameter most correlated with a term's values, and the correlation; None for smooth terms."""
    if fit.terms[number].smooth is not None:
        return None
    covariance, size = fit.identification.covariance, len(fit.identification.parameter_set.columns)
    here = fit.layout.parameters(number)
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance[:size, here] / sd[:size, None] / sd[here]
    row, column = np.unravel_index(int(np.argmax(np.abs(correlation))), correlation.shape)
    return Correlation(parameter=fit.identification.names[int(row)], correlation=float(correlation[row, column]))


# ---------------------------------------------------------------------------------------------------------------------
# Displacement of the SMR by each joint or frame of an effect: it orders the parameters and pictures for the reader.


def term_movements(fit: JointFit, number: int) -> tuple[PlaceMovement, ...]:
    """Return the rms displacement of the SMR at the readings by each joint or frame that a term acts on, largest first.

    Parameters are those of the term's law. Its free part also moves the SMR, but has no named parameters.
    """
    columns, named = fit.term_columns(number), len(fit.terms[number].names)
    signals = fit.term_values(number)[:, None] * fit.term_rows(number)
    found = []
    for where in dict.fromkeys(column.where for column in columns):
        here = [k for k, column in enumerate(columns) if column.where == where]
        names = tuple(columns[k].name for k in here if k < named)
        found.append(
            PlaceMovement(where=where, parameters=names, moves_mm=1e3 * rms_length(fit, signals[here].sum(axis=0)))
        )
    return tuple(sorted(found, key=lambda place: -place.moves_mm))


def rms_length(fit: JointFit, whitened: Array) -> float:
    """Return the rms length [m] of whitened displacements (3 n,) over those readings of a fit that are positions."""
    here = fit.positions
    moved = np.linalg.solve(fit.white.transpose(2, 0, 1)[here], whitened.reshape(3, -1).T[here, :, None])[..., 0]
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))


# -- Description of a data-driven term: channel, variables, curve, and a short formula if one fits as well ------------


_POINTS = 60
"""Number of points of a curve in the description."""
_AS_GOOD = 0.95
"""Share of what the curve explains at which a formula with fewer parameters describes it."""


def describe(data: ArmData, fit: JointFit, number: int) -> TermDescription:
    """Describe a data-driven term of a fit, or one with a law of the library.

    ``size_um`` excludes the part that the other parameters can explain.
    """
    term, size_um = fit.terms[number], _visible_rms(fit, number) * 1e6
    formula, gain = "", None
    curve: tuple[tuple[float, float], ...] = ()
    if is_borrowed(term.law):
        columns = fit.term_columns(number)
        channel = ", ".join(dict.fromkeys(column.where for column in columns))
        names = tuple(sorted(variable.value for variable in term.law.form.variables))
        if not is_contradiction(term.law):  # of the joints' own angles
            names = tuple(sorted({f"q{column.joint + 1}" for column in columns if column.joint is not None}))
        said = term.note
    else:
        form = data_driven_form(term.law)
        channel, names = form.channel.name, tuple(variable.name for variable in form.drivers)
        if form.is_field:
            length = term.law.constants[FIELD_LENGTH.name]
            said = (
                f"{channel} depends on the position, a field over the workspace that changes within some {length:.1g} m"
            )
        else:
            values = [variable.values(data.context) for variable in form.drivers]
            formula, gain = _formula(data, fit, number, form.channel, form.drivers, values)
            if len(names) == 1 and fit.term_columns(number)[0].joint is not None:
                curve = _curve(fit, number, values[0])
            said = f"{channel} depends on {' and '.join(names)}{f', about {formula}' if formula else ''}"
    return TermDescription(
        channel=channel,
        variables=names,
        size_um=size_um,
        formula=formula,
        gain_over_curve=gain,
        curve=curve,
        sentence=f"{said}; {size_um:.0f} µm rms at the SMR",
    )


def _visible_rms(fit: JointFit, number: int) -> float:
    """Return the rms displacement [m] by a term, without the part that the other parameters of the model can explain.

    That part is arbitrary: for instance a shift of the base pose cancels a constant in a slow drift.
    """
    visible = fit.residual_without(number).projector.project(fit.signal(number))
    return rms_length(fit, visible)


def _curve(fit: JointFit, number: int, x: Array) -> tuple[tuple[float, float], ...]:
    """Return points of a joint offset [rad] over its variable."""
    offset = np.zeros(len(x))
    for column, value in zip(fit.term_columns(number), fit.term_values(number).tolist(), strict=True):
        if column.offset is not None:
            offset += value * column.offset
    order = np.argsort(x, kind="stable")
    chosen = order[np.linspace(0, len(order) - 1, min(_POINTS, len(order))).astype(np.intp)]
    return tuple((float(x[i]), float(offset[i])) for i in chosen)


def _formula(
    data: ArmData,
    fit: JointFit,
    number: int,
    channel: DataChannel,
    variables: Sequence[Variable],
    values: Sequence[Array],
) -> tuple[str, float | None]:
    """Return the best short formula and its gain over the curve; no text if it describes the term less well.

    It is good enough if its score is higher, having fewer parameters, or if it explains nearly as much.
    """
    if any(not np.isfinite(one).all() for one in values):
        return "", None
    basis = fit.term_columns(number)[0]
    directions = [] if basis.joint is not None else channel_directions(data.context, channel)
    found = formulas(variables, values)
    candidates = []
    for formula in found:
        columns = _columns(formula.text, formula.values, basis, directions)
        law = LawForm(formula.text, formula.text).law(tried=len(found))
        candidates.append(CandidateLaw(UNKNOWN, law, columns, fit.displacements(columns)))
    if not candidates:
        return "", None
    residual = fit.residual_without(number)
    best = LawScan.of(candidates, residual.projector).ranked(residual)[0]
    rows = fit.term_rows(number)
    gain = best.value - residual.bic_gain(rows)
    if gain < 0.0 and best.explained_share < _AS_GOOD * residual.explained_share(rows):
        return "", gain
    return best.candidate.law.name, gain


def _columns(text: str, values: Array, basis: EffectColumn, directions: Sequence[Array]) -> tuple[EffectColumn, ...]:
    """Return the columns of a formula in the channel of ``basis``, all in one block; for a shift one a direction."""
    common = ("", text, -np.inf, np.inf, basis.channel, basis.index)
    if basis.channel is Channel.JOINT:
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


def dominant_cycles(
    columns: Sequence[EffectColumn], values: Array, covariance: Array | None = None
) -> dict[str, CycleBand]:
    """Return the dominant cycles per revolution by joint (key: its number), from wave columns with values (m,) [rad].

    ``covariance`` (m, m) of the values gives the standard error of each joint's rms.
    """
    power: dict[int, dict[int, float]] = {}
    for column, value in zip(columns, values.tolist(), strict=True):
        if column.cycles is not None and column.joint is not None:
            of_joint = power.setdefault(column.joint, {})
            of_joint[column.cycles] = of_joint.get(column.cycles, 0.0) + 0.5 * value**2
    found = {str(joint + 1): _band(power[joint]) for joint in sorted(power) if any(power[joint].values())}
    if covariance is None:
        return found
    return {joint: _with_error(band, int(joint) - 1, columns, values, covariance) for joint, band in found.items()}


def _with_error(
    band: CycleBand, joint: int, columns: Sequence[EffectColumn], values: Array, covariance: Array
) -> CycleBand:
    """Add to the band the standard error of its rms; rms^2 is half the sum of the squared coefficients."""
    own = np.array([column.cycles is not None and column.joint == joint for column in columns])
    gradient = np.where(own, values, 0.0) / (2e-6 * band.rms_urad)
    error = math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
    return band.model_copy(update={"rms_standard_error_urad": error * 1e6})


def _band(power: dict[int, float]) -> CycleBand:
    counts = sorted(power)
    each = np.array([power[count] for count in counts])
    share = np.cumsum(each) / each.sum()
    first, last = (counts[min(int(np.searchsorted(share, at)), len(counts) - 1)] for at in _BAND)
    rms = float(np.sqrt(each.sum()))
    return CycleBand(first=first, last=last, peak=counts[int(np.argmax(each))], rms_urad=rms * 1e6)
