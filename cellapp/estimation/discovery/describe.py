"""Description of a data-driven term: channel, variables, curve, and a short formula if one fits as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.candidates import CandidateLaw
from cellapp.estimation.discovery.formulas import formulas
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.movement import rms_length
from cellapp.estimation.discovery.records import TermDescription
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import Channel, EffectColumn, LawForm
from cellapp.robot.effects.contradiction import is_borrowed, is_contradiction
from cellapp.robot.effects.data_driven import DataChannel, Variable, data_driven_form
from cellapp.robot.effects.field import FIELD_LENGTH
from cellapp.robot.effects.unknown import channel_directions
from cellapp.robot.kinematics.transforms import Array

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
