"""Fit of the structured process to a model's residuals: hyperparameters by evidence, needed components, terms.

1. Start with the slower waves of all components that the data allow. Amplitudes, length scales and the noise maximise
   the evidence. Drop amplitudes without signal, and components that fall short by as much as they would need.
2. Weight the readings by the stated uncertainty and the scatter found; fit the remaining components with all waves.
3. Remove components that the evidence does not need, the least needed first, and fit the others again.
4. Turn the rest into smooth terms of the model, which is then fitted jointly with the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData, Excess, ModelTerm, ModelTerms, Smoothness
from cellapp.estimation.discovery.joint_fit import (
    JointFit,
    NormalMatrix,
    fit_terms,
    joint_motions,
    uncertainty_with_scatter,
)
from cellapp.estimation.discovery.search.state import SCORE_MARGIN
from cellapp.estimation.readings import covariances_of
from cellapp.robot.effects import EFFECTS, EffectColumn, Law, LawForm
from cellapp.robot.effects.data_driven import FIELD, box_of, field_frequencies, field_variances, position_in_base
from cellapp.robot.effects.law import AMPLITUDE, CYCLES, LENGTH, LengthRange, SmoothLaw, circle_variances
from cellapp.robot.effects.periodic import CURVE, CURVE_AMPLITUDE, CURVE_LENGTH, LINE_AMPLITUDE, TransmissionError
from cellapp.robot.kinematics.transforms import Array

# -- Components of the structured process: an effect's smooth law on the data at hand, and its hyperparameters --------
#
# A component is a place (what moves) with an input (what it depends on), as a smooth form of a named effect. A turn
# about the axis that depends on its own angle is a transmission error, one across the axis a wobble, one that depends
# on gravity's torque a compliance, and so on. The columns are weighted by a spectrum that depends on an amplitude and,
# for functions of an angle, on a length scale.


CURVE_CYCLES = 80
"""Highest cycle count of a joint's curve: at the shortest length scale, 3 degrees, 1 % of its variance is beyond."""
_LEAST_LEVER = 0.05
"""Share of the longest rms lever below which a joint gets no curve: its errors do not show at the SMR."""


CURVE_LENGTHS = LengthRange(math.radians(5.0), math.radians(3.0), math.radians(40.0))
"""Length scales of a joint's curve: a gear's errors have periods from a few degrees to a turn; below 3 degrees lines of
the spectrum describe them."""
_CURVE_START = 2e-4
"""First guess of the amplitudes of curves [rad]."""
FIELD_LENGTHS = LengthRange(0.5, 0.2, 3.0)
"""Length scales of a field: layers of air and bent stands act over a good part of the workspace, and shorter fields
need more readings than there are."""


@dataclass(frozen=True, eq=False)
class Component:
    """A smooth law on the data at hand.

    Attributes
    ----------
    slug : str
        The effect.
    columns : tuple of EffectColumn, length m
    rows : array, shape (m, d)
        Their whitened displacements.
    constants : mapping
        Constants of the law that are not hyperparameters.
    form : LawForm
    groups : array, shape (m,)
        Index into ``amplitude_keys`` of each column's amplitude.
    amplitude_keys : tuple of str, length a
        Constants of the law that hold the amplitudes.
    start : float
        First guess of the amplitudes.
    weights : array, shape (m,)
        Relative prior variances if no length scale is fitted; else unused.
    amplitudes : array, shape (a,)
    length : float
        The length scale; 1 without one.
    lengths : LengthRange, optional
    length_keys : tuple of str
        Constants of the law that hold the length scale; one value for all.
    frequencies : array, shape (m,), optional
        For a field over the workspace: angular frequency of each column [1/m].
    """

    slug: str
    columns: tuple[EffectColumn, ...]
    rows: Array
    form: LawForm
    constants: Mapping[str, float]
    groups: NDArray[np.intp]
    amplitude_keys: tuple[str, ...]
    start: float
    weights: Array
    amplitudes: Array
    length: float = 1.0
    lengths: LengthRange | None = None
    length_keys: tuple[str, ...] = ()
    frequencies: Array | None = None

    @property
    def hyperparameters(self) -> Array:
        """Logarithms (h,) of the fitted hyperparameters: amplitudes, and the length scale if there is one."""
        return np.log([*self.amplitudes, *(() if self.lengths is None else (self.length,))])

    def at(self, hyperparameters: Array) -> Component:
        """Return the component with other ``hyperparameters`` (h,)."""
        values = np.exp(hyperparameters)
        length = 1.0 if self.lengths is None else float(values[-1])
        return replace(self, amplitudes=values[: len(self.amplitude_keys)], length=length)

    @property
    def bounds(self) -> Array:
        """Least and largest ``hyperparameters`` (2, h)."""
        low, high = _LOG_AMPLITUDE
        found = [(math.log(self.start) + low, math.log(self.start) + high)] * len(self.amplitude_keys)
        if self.lengths is not None:
            found.append((math.log(self.lengths.least), math.log(self.lengths.most)))
        return np.array(found).T

    @property
    def variances(self) -> Array:
        """Prior variances (m,) of the columns."""
        return np.asarray(self.relative_variances(self.length) * self.amplitudes[self.groups] ** 2)

    @property
    def by_hyperparameters(self) -> Array:
        """Derivatives (m, h) of the logarithms of ``variances``."""
        by_amplitudes: Array = 2.0 * (self.groups[:, None] == np.arange(len(self.amplitude_keys)))
        if self.lengths is None:
            return by_amplitudes
        longer = self.relative_variances(self.length * math.exp(_LENGTH_STEP))
        return np.column_stack([by_amplitudes, np.log(longer / self.relative_variances(self.length)) / _LENGTH_STEP])

    def relative_variances(self, length: float) -> Array:
        """Return prior variances (m,) at unit amplitude."""
        if self.lengths is None:
            return self.weights
        if self.frequencies is not None:
            return field_variances(length, self.frequencies)
        waves = circle_variances(length, int(self._cycles.max()))[self._cycles - 1]
        return np.where(self._cycles > CURVE_CYCLES, 1.0, waves)

    @cached_property
    def _cycles(self) -> NDArray[np.intp]:
        """Cycles a turn of each column (m,), zero for columns that are no waves."""
        return np.array([column.cycles or 0 for column in self.columns], dtype=np.intp)

    @property
    def law(self) -> Law:
        """The law with its hyperparameters."""
        amplitudes = dict(zip(self.amplitude_keys, self.amplitudes.tolist(), strict=True))
        return self.form.law({**self.constants, **amplitudes, **dict.fromkeys(self.length_keys, self.length)})

    def of_amplitudes(self, kept: Sequence[int]) -> Component:
        """Return the component with some of its amplitudes only."""
        places = np.flatnonzero(np.isin(self.groups, list(kept)))
        keys = [self.amplitude_keys[k] for k in kept]
        lengths = [key for key in self.length_keys if len(self.length_keys) == 1 or _same_joint(key, keys)]
        some = self._take(places)
        return replace(
            some,
            groups=np.searchsorted(np.asarray(sorted(kept)), some.groups),
            amplitude_keys=tuple(keys),
            amplitudes=self.amplitudes[list(kept)],
            length_keys=tuple(lengths),
        )

    def coarse(self) -> Component:
        """Return the component with the slower half of its waves, if it has a length scale."""
        if self.lengths is None:
            return self
        fast = np.where(self._cycles > CURVE_CYCLES, 0, self._cycles) if self.frequencies is None else self.frequencies
        return self._take(np.flatnonzero(fast <= 0.5 * fast.max()))

    def _take(self, places: NDArray[np.intp]) -> Component:
        return replace(
            self,
            columns=tuple(self.columns[k] for k in places),
            rows=self.rows[places],
            groups=self.groups[places],
            weights=self.weights[places],
            frequencies=None if self.frequencies is None else self.frequencies[places],
        )


def _same_joint(length_key: str, amplitude_keys: Sequence[str]) -> bool:
    number = length_key.removeprefix(CURVE_LENGTH.name)
    return CURVE_AMPLITUDE.name + number in amplitude_keys


def components(data: ArmData, fit: JointFit) -> list[Component]:
    """Return all components that the data allow beside a fit."""
    smooth = (
        _plain(data, fit, effect.slug, effect.form(law.form), law)
        for effect in EFFECTS.values()
        for law in effect.smooth_laws(data.context)
    )
    found = [_curves(data, fit), *smooth, _field(data, fit)]
    return [one for one in found if one is not None]


def _plain(data: ArmData, fit: JointFit, slug: str, form: LawForm, law: SmoothLaw) -> Component | None:
    """Build a component with one amplitude and at most one length scale for all its columns; None if nothing moves.

    The columns' priors at unit amplitude are the relative variances.
    """
    starts = {AMPLITUDE.name: 1.0} if law.lengths is None else {AMPLITUDE.name: 1.0, LENGTH.name: law.lengths.start}
    columns = tuple(data.columns(slug, form.law({**law.constants, **starts})))
    rows = fit.displacements(columns) if columns else np.zeros((0, 3 * len(data)))
    if not rows.any():
        return None
    return Component(
        slug=slug,
        columns=columns,
        rows=rows,
        form=form,
        constants=law.constants,
        groups=np.zeros(len(columns), dtype=np.intp),
        amplitude_keys=(AMPLITUDE.name,),
        start=law.start,
        weights=np.array([column.prior_sd**2 for column in columns]),
        amplitudes=np.array([law.start]),
        length=1.0 if law.lengths is None else law.lengths.start,
        lengths=law.lengths,
        length_keys=() if law.lengths is None else (LENGTH.name,),
    )


def _curves(data: ArmData, fit: JointFit) -> Component | None:
    """Build curves of all joints with a lever: an amplitude for each, one length scale, one amplitude of their
    encoders' lines; None if there is none."""
    joints = _with_lever(fit.by_joint).tolist()
    if not joints:
        return None
    constants: dict[str, float] = {CYCLES.name: float(CURVE_CYCLES)}
    keys = {joint: (CURVE_AMPLITUDE.key(joint), CURVE_LENGTH.key(joint)) for joint in joints}
    full = {**constants, LINE_AMPLITUDE.name: 1.0} | {key: 1.0 for pair in keys.values() for key in pair}
    columns = tuple(data.columns(TransmissionError.slug, CURVE.law(full)))
    place = {joint: k for k, joint in enumerate(joints)}
    return Component(
        slug=TransmissionError.slug,
        columns=columns,
        rows=fit.displacements(columns),
        form=CURVE,
        constants=constants,
        groups=np.array([len(joints) if (c.cycles or 0) > CURVE_CYCLES else place[c.index or 0] for c in columns]),
        amplitude_keys=(*(amplitude for amplitude, _ in keys.values()), LINE_AMPLITUDE.name),
        start=_CURVE_START,
        weights=np.ones(len(columns)),
        amplitudes=np.full(len(joints) + 1, _CURVE_START),
        length=CURVE_LENGTHS.start,
        lengths=CURVE_LENGTHS,
        length_keys=tuple(length for _, length in keys.values()),
    )


def _with_lever(by_joint: Array) -> NDArray[np.intp]:
    """Return the joints whose motions (3, N, n) show at the SMR."""
    levers = np.sqrt(np.mean(np.sum(by_joint**2, axis=0), axis=1))
    return np.flatnonzero(levers > _LEAST_LEVER * levers.max())


def _field(data: ArmData, fit: JointFit) -> Component | None:
    """Build a field over the workspace: one amplitude for its three directions, one length scale."""
    box = box_of(position_in_base(data.context))
    found = _plain(data, fit, UNKNOWN, FIELD, SmoothLaw(FIELD.name, 2e-5, box, FIELD_LENGTHS))
    return None if found is None else replace(found, frequencies=np.tile(field_frequencies(box), 3))


# -- Evidence of a structured process from one Gram matrix, its gradient, and the hyperparameters that maximise it ----
#
#     y = X w + e,   w_k ~ N(0, v_k(theta)),   e ~ N(0, s I)
#
# y and the columns X are taken in the complement of the nuisance parameters (geometry, named laws). The evidence
# (marginal likelihood) follows from ``G = X^T X``, ``b = X^T y`` and ``y^T y`` alone (Rasmussen, Williams, Gaussian
# Processes for Machine Learning, 2006, section 5.4, in weight space, section 2.1): its cost does not depend on the
# number of readings. Columns whose prior is negligible against the noise are left out.


NEGLIGIBLE_COLUMN = 1e-2
"""Ratio of prior signal variance to noise variance below which a column is left out: it would change the log evidence
by half of that. All such columns of a measured arm together change it by less than 0.5."""
_LOG_AMPLITUDE = (-7.0, 5.0)
"""Bounds of the log ratio of an amplitude to its first guess: from a thousandth to 150 times."""
_LOG_NOISE = (-9.0, 0.5)
"""Bounds of the log ratio of the noise variance to that of the data: at most slightly above all of it."""
_LENGTH_STEP = 1e-4
"""Step of the log length scale for the derivative of its spectrum by forward difference."""
_LEAST_GAIN = 0.05
"""Gain of the log evidence by a step at which the iteration stops: far below a score that counts."""
_MOST_STEPS, _LONGEST_STEP, _PARTS = 12, 2.0, (1.0, 0.5, 0.25, 0.1)
"""Most steps, the longest step of a logarithm, and the parts of a step that are tried until the evidence rises."""
_RIDGE = 1e-6
"""Added to the information, relative to its largest diagonal element: idle amplitudes have none."""


@dataclass(frozen=True, eq=False)
class ProcessEvidence:
    """Log evidence at prior variances and a noise variance.

    Attributes
    ----------
    value : float
    active : array, shape (m,)
        Indices of the columns whose prior matters.
    root : array, shape (m,)
        Roots of their prior variances.
    lower : array, shape (m, m)
        L of ``I + V^1/2 G V^1/2 / s = L L^T``, zero above the diagonal.
    solution : array, shape (m,)
        x of ``L L^T x = V^1/2 b / s``.
    coordinates, misfit : float
        Number of independent coordinates, and ``y^T K^-1 y`` with K their covariance.
    """

    value: float
    active: NDArray[np.intp]
    root: Array
    lower: Array
    solution: Array
    coordinates: float
    misfit: float

    @classmethod
    def of(cls, data: NormalMatrix, variance: Array, noise: float) -> ProcessEvidence | None:
        """Compute the evidence; None if the matrix is not positive definite, as the noise is nearly zero."""
        active = np.flatnonzero(variance * np.diag(data.gram) > NEGLIGIBLE_COLUMN * noise)
        root = np.sqrt(variance[active])
        gram = data.gram if len(active) == len(variance) else data.gram[active].take(active, axis=1)
        lower = gram * (root / noise)
        lower *= root[:, None]
        lower.flat[:: len(lower) + 1] += 1.0
        scaled = solution = root * data.moment[active] / noise
        if len(active):
            # transposed: in the order of LAPACK, without a copy
            lower, failed = scipy.linalg.lapack.dpotrf(lower.T, lower=1, overwrite_a=1)
            if failed:
                return None
            solution = scipy.linalg.lapack.dpotrs(lower, scaled, lower=1)[0]
        misfit = data.square / noise - float(scaled @ solution)
        log_determinant = 2.0 * float(np.log(np.diag(lower)).sum())
        value = -0.5 * (data.coordinates * math.log(noise) + log_determinant + misfit)
        return cls(value, active, root, lower, solution, data.coordinates, misfit)

    def slope(self, by_parameter: Array) -> tuple[Array, Array]:
        """Return the derivatives (h + 1,) of the value, and the expected information (h + 1, h + 1) about parameters.

        Of h parameters depend the log variances of all columns, with derivatives ``by_parameter``; the last one is the
        log of the noise. ``C = (L L^T)^-1`` is computed in single precision, enough for a step.
        """
        T, inverse = by_parameter[self.active], self.lower.astype(np.float32)
        if len(inverse):
            inverse = scipy.linalg.lapack.spotri(inverse, lower=1, overwrite_c=1)[0]
        own = inverse.diagonal().astype(np.float64)
        inverse.flat[:: len(inverse) + 1] = 0.0
        inverse *= inverse
        half = np.asarray(T.T @ (inverse @ T.astype(np.float32)), dtype=np.float64)
        square = own**2 + inverse.sum(axis=0) + inverse.sum(axis=1)
        with_noise = T.T @ (own - square)
        of_noise = self.coordinates - len(own) + square.sum()
        information = np.block(
            [[half + half.T + (T.T * (1.0 - own) ** 2) @ T, with_noise[:, None]], [with_noise[None], of_noise]]
        )
        by_variance = self.solution**2 + own - 1.0
        by_noise = self.misfit - float(self.solution @ self.solution) - self.coordinates + len(own) - own.sum()
        return 0.5 * np.append(by_variance @ T, by_noise), 0.5 * information


def losses(at: ProcessEvidence, ends: Sequence[int]) -> Array:
    """Return the loss of log evidence (c,) without each of c consecutive groups of columns, which end at ``ends``.

    With x the solution of A x = b for all columns, and C = A^-1, the loss without the group g follows from its blocks:
    ``(ln det C_gg + x_g^T C_gg^-1 x_g) / 2`` (inverse of a partitioned matrix).
    """
    solution = at.solution
    inverse = scipy.linalg.lapack.dpotri(at.lower, lower=1)[0] if len(solution) else at.lower
    found, first = np.zeros(len(ends)), 0
    for group, end in enumerate(np.searchsorted(at.active, ends).tolist()):
        if end > first:
            block, x = inverse[first:end, first:end], solution[first:end]
            lower = scipy.linalg.lapack.dpotrf(block, lower=1)[0]
            explained = float(x @ scipy.linalg.lapack.dpotrs(lower, x, lower=1)[0])
            found[group] = float(np.log(np.diag(lower)).sum()) + 0.5 * explained
        first = end
    return found


LEAST_READINGS = 40
"""Least number of readings for a process: 120 coordinates for some 20 hyperparameters beside 30 of geometry."""
_NOISE_STEPS, _LEAST_VARIANCE = 40, 1e-16
"""Corrections of the noise's variances, and the least variance [m^2, rad^2] of a coordinate."""
_LEAST_SIGNAL = 0.03
"""Ratio of signal to noise (rms) below which an amplitude is removed at once."""
_SMALLEST = 1e-300
"""Guard for the precision of columns without any variance."""


@dataclass(frozen=True, eq=False)
class StructuredProcess:
    """Components in the complement of a model's parameters.

    Attributes
    ----------
    components : tuple of Component
    noise : float
        Variance s of the noise.
    gram : NormalMatrix
        Gram matrix of their columns.
    """

    components: tuple[Component, ...]
    noise: float
    gram: NormalMatrix

    @classmethod
    def fitted(cls, fit: JointFit, chosen: Sequence[Component], noise: float | None = None) -> StructuredProcess:
        """Find hyperparameters near those of the components; drop amplitudes that move the SMR by far less than noise.

        Without a ``noise`` to begin with all variance is noise, as from less the evidence can rise to none.
        """
        gram = gathered(fit, chosen)
        noise = gram.square / gram.coordinates if noise is None else noise
        return cls(tuple(chosen), noise, gram).most_evident().without_idle()

    @property
    def variances(self) -> Array:
        """Prior variances of all columns."""
        return np.concatenate([np.zeros(0), *(one.variances for one in self.components)])

    @cached_property
    def evidence(self) -> ProcessEvidence | None:
        """Evidence of the columns; None if the noise is nearly zero."""
        return ProcessEvidence.of(self.gram, self.variances, self.noise)

    @property
    def log_evidence(self) -> float:
        """Its value; minus infinity without."""
        return -math.inf if self.evidence is None else self.evidence.value

    @property
    def ends(self) -> list[int]:
        """Places one past the last column of each component."""
        return list(accumulate(len(one.columns) for one in self.components))

    def most_evident(self) -> StructuredProcess:
        """Maximise the evidence near the present values by Fisher scoring (Longford, Biometrika 74 (1987) 817)."""
        noise = np.log(self.gram.square / self.gram.coordinates) + np.array(_LOG_NOISE)
        low, high = np.column_stack([*(one.bounds for one in self.components), noise])
        start = [*(value for one in self.components for value in one.hyperparameters), math.log(self.noise)]
        theta = np.clip(start, low, high)
        best = self._at(theta)
        for _ in range(_MOST_STEPS):
            if best.evidence is None:
                break
            slope, information = best.evidence.slope(
                scipy.linalg.block_diag(*(one.by_hyperparameters for one in best.components))
            )
            free = ((theta > low) | (slope > 0.0)) & ((theta < high) | (slope < 0.0))
            information.flat[:: len(theta) + 1] += _RIDGE * information.diagonal().max()
            step = np.zeros(len(theta))
            step[free] = np.linalg.solve(information[free][:, free], slope[free])
            step = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
            trials = [np.clip(theta + part * step, low, high) for part in _PARTS]
            tried = ((trial, self._at(trial)) for trial in trials)
            better = next(((trial, found) for trial, found in tried if found.log_evidence > best.log_evidence), None)
            if better is None:
                break
            gain = better[1].log_evidence - best.log_evidence
            theta, best = better
            if gain < _LEAST_GAIN:
                break
        return best

    def _at(self, theta: Array) -> StructuredProcess:
        """Return the process at other hyperparameters, the log of the noise last."""
        *of_components, noise = np.split(theta, np.cumsum([len(one.hyperparameters) for one in self.components]))
        components = (one.at(own) for one, own in zip(self.components, of_components, strict=True))
        return replace(self, components=tuple(components), noise=math.exp(noise[0]))

    def without_idle(self) -> StructuredProcess:
        """Return the process without amplitudes whose signal is negligible against the noise."""
        kept, places, first = list[Component](), [np.zeros(0, dtype=np.intp)], 0
        power = np.diag(self.gram.gram) * self.variances / self.gram.coordinates
        for one, end in zip(self.components, self.ends, strict=True):
            signal = np.bincount(one.groups, power[first:end], minlength=len(one.amplitudes)) / self.noise
            used = np.flatnonzero(signal > _LEAST_SIGNAL**2)
            if len(used):
                kept.append(one.of_amplitudes(used.tolist()))
                places.append(first + np.flatnonzero(np.isin(one.groups, used)))
            first = end
        return StructuredProcess(tuple(kept), self.noise, self.gram.take(np.concatenate(places)))

    def without(self, component: int) -> StructuredProcess:
        """Return the process without one component, at the hyperparameters of the others."""
        first, end = [0, *self.ends][component], self.ends[component]
        rest = self.components[:component] + self.components[component + 1 :]
        taken = np.delete(np.arange(len(self.gram.moment)), np.s_[first:end])
        return StructuredProcess(rest, self.noise, self.gram.take(taken))

    def without_weak(self, least: float) -> StructuredProcess:
        """Remove components whose gain is at most ``least``, the weakest first."""
        process = self
        while process.gains and min(process.gains) <= least:
            process = process.without(process.gains.index(min(process.gains)))
        return process

    def expected(self) -> dict[tuple[str, str], float]:
        """Return the expected value of each column, by effect and name."""
        at = self.evidence
        if at is None:
            return {}
        values = np.zeros(len(self.gram.moment))
        values[at.active] = at.root * at.solution
        keys = [(one.slug, column.name) for one in self.components for column in one.columns]
        return dict(zip(keys, values.tolist(), strict=True))

    def price(self, component: Component) -> float:
        """Return the price of a component: of its hyperparameters by the Bayesian information criterion, and a margin
        for what is no effect of the library."""
        of_choice = SCORE_MARGIN if component.slug == UNKNOWN else 0.0
        return len(component.hyperparameters) * math.log(self.gram.coordinates) + of_choice

    @cached_property
    def gains(self) -> list[float]:
        """Each component's gain of the score at fixed hyperparameters: twice the log evidence less its price."""
        lost = [math.inf] * len(self.components) if self.evidence is None else losses(self.evidence, self.ends).tolist()
        return [2.0 * loss - self.price(one) for one, loss in zip(self.components, lost, strict=True)]


def gathered(fit: JointFit, chosen: Sequence[Component]) -> NormalMatrix:
    """Compute the Gram matrix of the components' columns in the complement of all parameters of a fit."""
    rows = np.concatenate([fit.rows, *(one.rows for one in chosen)])
    normal = NormalMatrix.of(rows, fit.target)
    return normal.behind(len(fit.rows), fit.precision)


def fit_process(
    data: ArmData, fit: JointFit, needed: float, candidates: Sequence[Component] | None = None
) -> tuple[StructuredProcess, Excess] | None:
    """Fit the process that residuals need; return it and the scatter beyond the stated uncertainty. None if not needed.

    ``needed`` is the gain of the score at which a component is kept. ``candidates`` are the components to choose from;
    None for all that the data allow.
    """
    if len(data) < LEAST_READINGS:
        return None
    candidates = components(data, fit) if candidates is None else candidates
    if not candidates:
        return None
    process = StructuredProcess.fitted(fit, [one.coarse() for one in candidates]).without_weak(-needed)
    weighed = data
    for with_all_waves in (False, True):  # the noise about few waves without the first of these fits gives poor weights
        if not process.components:
            return None
        weighed = replace(data, sigma=uncertainty_with_scatter(data, _noise(weighed, fit, process)))
        chosen = _whole(candidates, process.components) if with_all_waves else process.components
        fit = fit_terms(weighed, fit.terms)
        here = [replace(one, rows=fit.displacements(one.columns)) for one in chosen]
        process = StructuredProcess.fitted(fit, here, noise=1.0)
    if not process.components:
        return None
    scatter, process = _noise(weighed, fit, process), process.without_weak(needed)
    return (process, scatter) if process.components else None


def _noise(data: ArmData, fit: JointFit, process: StructuredProcess) -> Excess:
    """Estimate the noise of the readings about a process: their own, and that of each joint's position.

    With the variances v_k of the kinds of noise, a reading has the covariance ``V = sum_k v_k D_k``. The likelihood of
    the residuals r is largest where ``sum tr(V^-1 D_k V^-1 S) = sum tr(V^-1 D_k)``, with S = r r^T plus the covariance
    of what was fitted, which shares V (MacKay, Neural Comput. 4 (1992) 415). The quotient of both sides corrects v_k.
    """
    white = fit.white.transpose(2, 0, 1)
    residual, determined = _about(fit, process, len(data))
    root = np.linalg.inv(white)
    residual, eye = np.einsum("nab,nb->na", root, residual), np.eye(3)
    angular = np.zeros(len(data), dtype=np.bool_) if data.angular is None else data.angular
    kinds = [np.where(rows[:, None, None], eye, 0.0) for rows in (~angular, angular)]
    if data.stated is not None:
        kinds.append(covariances_of(data.stated))
    by_joint = joint_motions(data)
    seen = _with_lever(by_joint)
    D = np.array([*kinds, *(by_joint[:, j].T[:, :, None] * by_joint[:, j].T[:, None] for j in seen)])
    square = np.mean(residual**2, axis=1)
    size = np.einsum("knaa->k", D) / np.maximum(np.count_nonzero(np.einsum("knaa->kn", D), axis=1), 1) / 3.0
    v = np.where(size > 0.0, float(np.mean(square[~angular])) / np.maximum(size, _SMALLEST) / len(D), 0.0)
    v[1] = float(np.mean(square[angular])) / 2.0 if angular.any() else 0.0
    if data.stated is not None:
        v[2] = 1.0
    for _ in range(_NOISE_STEPS):
        V = np.einsum("k,knab->nab", v, D) + _LEAST_VARIANCE * eye
        root = np.linalg.cholesky(V)
        S = residual[:, :, None] * residual[:, None] + root @ determined @ root.transpose(0, 2, 1)
        inverse = np.linalg.inv(V)
        weight = inverse @ S @ inverse
        v *= np.einsum("knab,nab->k", D, weight) / np.maximum(np.einsum("knab,nab->k", D, inverse), _SMALLEST)
        if data.stated is not None:
            v[2] = min(v[2], 1.0)
    sd, joints = np.sqrt(v).tolist(), np.zeros(by_joint.shape[1])
    joints[seen] = sd[len(kinds) :]
    return Excess(sd[0], sd[1], tuple(joints.tolist()), 1.0 if data.stated is None else sd[2])


def _about(fit: JointFit, process: StructuredProcess, n: int) -> tuple[Array, Array]:
    """Return whitened residuals (n, 3) about a process, and the share (n, 3, 3) of each reading's own noise in what
    was fitted to it."""
    rows = np.concatenate([one.rows for one in process.components])
    noise, projector = process.noise, fit.projector
    variances = np.maximum(process.variances, _SMALLEST)
    lower = scipy.linalg.cholesky(process.gram.gram / noise + np.diag(1.0 / variances), lower=True, check_finite=False)
    half = scipy.linalg.solve_triangular(lower, projector.project(rows), lower=True, check_finite=False)
    half /= math.sqrt(noise)
    behind = fit.projected_residual.projected
    residual = behind - (half @ behind) @ half
    half, basis = half.reshape(len(half), 3, n), projector.basis.reshape(3, n, -1)
    determined = np.einsum("man,mbn->nab", half, half) + np.einsum("anp,bnp->nab", basis, basis)
    return residual.reshape(3, n).T, determined


def _whole(candidates: Sequence[Component], screened: Sequence[Component]) -> list[Component]:
    """Return the candidates with the amplitudes left by a screening, and with all their waves."""
    found = []
    for one in screened:
        whole = next(other for other in candidates if (other.slug, other.form) == (one.slug, one.form))
        some = whole.of_amplitudes([whole.amplitude_keys.index(key) for key in one.amplitude_keys])
        found.append(some.at(one.hyperparameters))
    return found


def process_terms(process: StructuredProcess, scatter: Excess) -> ModelTerms:
    """Return the components as smooth terms of a model, with the columns whose prior matters."""
    terms, first = [], 0
    matters = np.diag(process.gram.gram) * process.variances / process.noise > NEGLIGIBLE_COLUMN
    for one, end, gain in zip(process.components, process.ends, process.gains, strict=True):
        names = tuple(one.columns[k].name for k in np.flatnonzero(matters[first:end]))
        terms.append(ModelTerm(one.slug, one.law, names, Smoothness(gain, len(one.hyperparameters), scatter)))
        first = end
    return tuple(terms)
