"""One arm's readings as discovery sees them: fits with any choice of effects, and what such a model can follow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cellapp.calibration.curves import CYCLES, Curves, spread, variances
from cellapp.calibration.identification import Identification, identify
from cellapp.calibration.normal_equations import EffectColumns
from cellapp.calibration.parameters import ParameterSet
from cellapp.calibration.weights import excess_variance, whitener, with_excess
from cellapp.discovery.scan import Candidate, Follower, displacements
from cellapp.effects import EFFECTS, Circumstances, EffectColumn, EffectContext, EffectTerm, Law
from cellapp.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.model.nominal import prior_sigmas
from cellapp.profile import Profile
from cellapp.run import Readings, stated_uncertainty

_WEIGHING_ROUNDS = 3
_CHANCE = 4.0
"""Standard errors by which a value may pass its bound: a joint that hardly feels an effect may come out negative."""
_SPREAD_POINTS = 180


@dataclass(frozen=True)
class Part:
    """An effect in a model: which law, which of its columns, and for free curves their prior.

    ``free`` are columns of a free curve that have no prior: sharp lines.
    """

    slug: str
    law: Law
    names: tuple[str, ...]
    curves: Curves | None = None
    free: frozenset[str] = frozenset()
    note: str = ""


Choice = tuple[Part, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """A choice of effects fitted together with the geometry.

    ``columns`` are those of all parts in their order, ``by_joint`` (3, N, n) and ``rows`` the whitened derivatives of
    the positions by the joints and by all that was fitted (p, 3 n), ``precision`` (p,) of its priors, ``residual``
    (3 n,) whitened.
    """

    choice: Choice
    identification: Identification
    columns: tuple[EffectColumn, ...]
    model: ArmModel
    white: Array
    by_joint: Array
    rows: Array
    precision: Array
    residual: Array

    @cached_property
    def follower(self) -> Follower:
        """What this model follows."""
        return Follower.of(np.ascontiguousarray(self.rows.T), self.precision)

    def follower_without(self, part: int) -> Follower:
        """What it would follow without one of its parts."""
        begin = len(self.rows) - len(self.columns) + sum(len(p.names) for p in self.choice[:part])
        kept = np.ones(len(self.rows), dtype=bool)
        kept[begin : begin + len(self.choice[part].names)] = False
        return Follower.of(np.ascontiguousarray(self.rows[kept].T), self.precision[kept])

    def signal(self, part: int) -> Array:
        """What a part explains, whitened (3 n,): its columns times their values."""
        begin = sum(len(p.names) for p in self.choice[:part])
        place = len(self.rows) - len(self.columns) + begin
        count = len(self.choice[part].names)
        values = self.identification.effect_values[begin : begin + count]
        return np.asarray(values @ self.rows[place : place + count])

    @cached_property
    def target(self) -> Array:
        """What linear refits with priors about zero aim at, whitened (3 n,): the residual and what priors hold back."""
        first = len(self.rows) - len(self.columns)
        held = np.flatnonzero(self.precision[first:] > 0.0)
        if not len(held):
            return self.residual
        return np.asarray(self.residual + self.identification.effect_values[held] @ self.rows[first + held])


@dataclass(frozen=True, eq=False)
class ArmData:
    """Readings of one arm, what is known of their stops, and the weights in use.

    The parameter set is fixed once: decided anew in each joint refit it would let redundant directions creep in through
    an effect. ``stated`` is what the readings say of their uncertainty, ``sigma`` the weights.
    """

    profile: Profile
    model: ArmModel
    readings: Readings
    known: Circumstances
    stated: Array | None
    sigma: Array | None
    parameter_set: ParameterSet
    stands: Array | None = None
    cache: dict[tuple[str, str], list[EffectColumn]] = field(default_factory=dict)

    @classmethod
    def of(cls, profile: Profile, model: ArmModel, readings: Readings, known: Circumstances) -> ArmData:
        """With the weights that the readings state themselves."""
        bare = replace(model, effects=(), network=None)
        found = identify(
            bare.geometry,
            readings.q,
            readings.p_M,
            parameter_set=profile.calibration.parameter_set,
            max_iterations=1,
        )
        stated = stated_uncertainty(readings)
        return cls(profile, bare, readings, known, stated, stated, found.parameter_set)

    def __len__(self) -> int:
        return len(self.readings)

    @cached_property
    def context(self) -> EffectContext:
        """What effects may depend on, at the geometry of ``model``."""
        return replace(self.model.context(self.readings.q, known=self.known), stands=self.stands)

    def at(self, model: ArmModel) -> ArmData:
        """The same with another model for what effects depend on: its geometry, and where its joints really stand."""
        stands = model.true_joints(self.readings.q, known=self.known) if model.effects else None
        return replace(self, model=replace(model, effects=(), network=None), stands=stands, cache={})

    def columns(self, slug: str, law: Law, names: Sequence[str] | None = None) -> list[EffectColumn]:
        """Columns of a law, all or those of ``names`` in that order."""
        key = (slug, f"{law.name} {sorted(law.constants.items())}")
        if names is None:
            if key not in self.cache:
                self.cache[key] = EFFECTS[slug].columns(self.context, law)
            return self.cache[key]
        source = self.cache.get(key) or EFFECTS[slug].columns(self.context, law, frozenset(names))
        by_name = {column.name: column for column in source}
        return [by_name[name] for name in names]

    def candidates(self, fit: Fit, slugs: Sequence[str]) -> list[Candidate]:
        """All laws of some effects that these data can be asked for."""
        found = []
        for slug in slugs:
            effect = EFFECTS[slug]
            if effect.untestable(self.context):
                continue
            for law in effect.laws(self.context):
                found.append(self.candidate(fit, slug, law))
        return found

    def candidate(self, fit: Fit, slug: str, law: Law) -> Candidate:
        """One law as a candidate beside a fitted model."""
        columns = self.columns(slug, law)
        return Candidate(slug, law, tuple(columns), displacements(columns, fit.by_joint, fit.white))

    def weighed(self, choice: Choice) -> ArmData:
        """With weights that hold what a model with ``choice`` leaves beyond the stated uncertainty."""
        if self.stated is None:
            return self
        if any(part.curves is not None for part in choice):
            noise = next(part.curves.noise for part in choice if part.curves is not None)
            return replace(self, sigma=self.stated * (noise if self.stated.ndim == 1 else noise**2))
        sigma = self.stated
        excess = -1.0
        for _ in range(_WEIGHING_ROUNDS):
            found = replace(self, sigma=sigma).identified(choice)[0]
            before, excess = excess, excess_variance(found.residuals, self.stated, found.degrees_of_freedom)
            sigma = with_excess(self.stated, excess)
            if abs(excess - before) <= 0.02 * excess:
                break
        return replace(self, sigma=sigma)

    def chosen(self, choice: Choice) -> tuple[EffectColumn, ...]:
        """The columns of a choice, part by part."""
        return tuple(column for part in choice for column in self.columns(part.slug, part.law, part.names))

    def identified(
        self, choice: Choice, rows: NDArray[np.intp] | None = None
    ) -> tuple[Identification, tuple[EffectColumn, ...]]:
        """Joint refit of geometry and ``choice``, on some rows or on all; and the columns in its order."""
        picked = np.arange(len(self)) if rows is None else rows
        columns = self.chosen(choice)
        settings = self.profile.calibration
        return (
            identify(
                self.model.geometry,
                self.readings.q[picked],
                self.readings.p_M[picked],
                sigma=None if self.sigma is None else self.sigma[picked],
                parameter_set=self.parameter_set,
                prior_sigma=prior_sigmas(self.model.nominal, settings.priors),
                prior_mean=self.model.nominal,
                robust=settings.robust,
                effects=None if not columns else self._effects(choice, columns).take(picked),
                tolerance=settings.tolerance,
                max_iterations=settings.max_iterations,
            ),
            columns,
        )

    def _effects(self, choice: Choice, columns: Sequence[EffectColumn]) -> EffectColumns:
        """As the identification wants them: turning columns first."""
        order = _order(columns)
        turning = [columns[place] for place in order if columns[place].joint is not None]
        shifting = [columns[place] for place in order if columns[place].joint is None]
        prior = self.prior_sd(choice)
        n = len(self)
        return EffectColumns(
            names=tuple(columns[place].name for place in order),
            units=tuple(columns[place].unit for place in order),
            joints=np.array([column.joint for column in turning], dtype=np.intp),
            offsets=np.array([column.offset for column in turning]).reshape(-1, n),
            shifts_M=np.array([column.shift_M for column in shifting]).reshape(-1, n, 3).swapaxes(1, 2),
            prior_sd=None if prior is None else prior[order],
        )

    def prior_sd(self, choice: Choice) -> Array | None:
        """Standard deviation of each column's prior, infinite without; None where no part has any."""
        if all(part.curves is None for part in choice):
            return None
        return np.concatenate([curve_prior(part) for part in choice])

    def fit(self, choice: Choice) -> Fit:
        """Fit a choice and linearise there."""
        found, columns = self.identified(choice)
        order = _order(columns)
        back = np.argsort(order)
        size = len(found.parameter_set.columns)
        place = np.concatenate([np.arange(size), size + back]).astype(np.intp)
        covariance = found.covariance[np.ix_(place, place)]
        found = replace(
            found,
            names=tuple(found.names[i] for i in place),
            units=tuple(found.units[i] for i in place),
            values=found.values[place],
            standard_errors=found.standard_errors[place],
            covariance=covariance,
            effect_values=found.effect_values[back],
        )
        white = whitening(self.sigma, len(self))
        turns = JointAngles.of(self.readings.q)
        _, J = jacobian(found.geometry, turns, found.parameter_set.columns)
        _, by_joint = joint_jacobian(found.geometry, turns)
        by_joint = np.einsum("acn,cjn->ajn", white, by_joint)
        geometric = np.einsum("acn,ckn->kan", white, J).reshape(size, -1)
        rows = np.concatenate([geometric, displacements(columns, by_joint, white)])
        sd = self.prior_sd(choice)
        precision = np.zeros(len(rows))
        if self.sigma is not None:
            beliefs = prior_sigmas(self.model.nominal, self.profile.calibration.priors)
            for row, name in enumerate(found.names[:size]):
                if name in beliefs:
                    precision[row] = 1.0 / beliefs[name] ** 2
        if sd is not None:
            precision[size:] = 1.0 / sd**2
        return Fit(
            choice=choice,
            identification=found,
            columns=columns,
            model=self.model_of(found, choice, columns),
            white=white,
            by_joint=by_joint,
            rows=rows,
            precision=precision,
            residual=np.einsum("acn,nc->an", white, found.residuals).ravel(),
        )

    def model_of(self, found: Identification, choice: Choice, columns: Sequence[EffectColumn]) -> ArmModel:
        """The arm with a fitted choice; ``found`` has the columns in the order of the choice."""
        terms: list[EffectTerm] = []
        place = len(found.parameter_set.columns)
        curved: set[int] = set()
        for part in choice:
            here = slice(place, place + len(part.names))
            bands: dict[int, Array] = {}
            if part.curves is not None:
                curved.update(range(here.start, here.stop))
                for joint in part.curves.joints:
                    own = columns[place - len(found.parameter_set.columns) :][: len(part.names)]
                    rows = [
                        place + i
                        for i, column in enumerate(own)
                        if column.joint == joint and cycles_of(column.name) <= CYCLES
                    ]
                    bands[joint] = spread(found.covariance[np.ix_(rows, rows)], _SPREAD_POINTS)
            terms.append(
                EffectTerm(
                    slug=part.slug,
                    names=part.names,
                    values=found.values[here],
                    standard_errors=found.standard_errors[here],
                    units=found.units[here],
                    law=part.law,
                    note=part.note,
                    spread=bands,
                )
            )
            place += len(part.names)
        kept = [i for i in range(len(found.names)) if i not in curved]
        return replace(
            self.model,
            geometry=found.geometry,
            effects=tuple(terms),
            identified=tuple(found.names[i] for i in kept),
            covariance=found.covariance[np.ix_(kept, kept)],
        )

    def impossible(self, fit: Fit, part: int) -> set[str]:
        """Blocks of a part whose values are outside their physical bounds by more than chance allows."""
        begin = sum(len(p.names) for p in fit.choice[:part])
        size = len(fit.identification.parameter_set.columns)
        blocks = set()
        for place in range(begin, begin + len(fit.choice[part].names)):
            column = fit.columns[place]
            value = float(fit.identification.effect_values[place])
            error = float(fit.identification.standard_errors[size + place])
            if not column.lower - _CHANCE * error <= value <= column.upper + _CHANCE * error:
                blocks.add(column.block)
        return blocks

    def left_out(self, fit: Fit, folds: int) -> float:
        """Root mean square [m, or whitened without weights] of coordinates that are left out of a fit in turns.

        Linear in all parameters, about the fit, which the left-out readings helped to find.
        """
        fold = np.tile(np.random.default_rng([self.profile.seed, 0xF01D]).permutation(len(self)) % folds, 3)
        off = np.empty(len(fold))
        for out, solution in _solutions(fit.rows, fit.precision, fit.target, fold, folds):
            off[out] = fit.target[out] - solution @ fit.rows[:, out]
        white = off.reshape(3, -1)
        return float(np.sqrt(np.mean(np.linalg.solve(fit.white.transpose(2, 0, 1), white.T[:, :, None]) ** 2)))

    def confirmed(self, fit: Fit, new: Array, folds: int) -> float:
        """By how much the sum of squares of readings left out falls when columns ``new`` (m, 3 n) join a fit.

        Linear in all parameters, about the fit; positive is good.
        """
        n = len(self)
        fold = np.random.default_rng([self.profile.seed, 0xF01D]).permutation(n) % folds
        fold = np.tile(fold, 3)
        gains = 0.0
        for rows, sign in ((fit.rows, 1.0), (np.concatenate([fit.rows, new]), -1.0)):
            precision = np.concatenate([fit.precision, np.zeros(len(rows) - len(fit.rows))])
            for out, solution in _solutions(rows, precision, fit.target, fold, folds):
                gains += sign * float(np.sum((fit.target[out] - solution @ rows[:, out]) ** 2))
        return gains


def _solutions(
    rows: Array, precision: Array, target: Array, fold: NDArray[np.intp], folds: int
) -> Iterator[tuple[NDArray[np.bool_], Array]]:
    """For each fold the coordinates that are left out, and the parameters (p,) that the others ask for."""
    scale = 1.0 / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    X = rows * scale[:, None]
    gram, moment = X @ X.T + np.diag(precision * scale**2), X @ target
    for k in range(folds):
        out = fold == k
        part = X[:, out]
        inside = gram - part @ part.T
        factor, solution, failed = lapack.dposv(inside, moment - part @ target[out], lower=1)
        diagonal = np.diag(factor)
        if failed or diagonal.min() <= 1e-6 * diagonal.max():
            values, vectors = np.linalg.eigh(inside)
            kept = values > 1e-11 * values[-1]
            solution = vectors[:, kept] @ ((vectors[:, kept].T @ (moment - part @ target[out])) / values[kept])
        yield out, solution * scale


def curve_prior(part: Part) -> Array:
    """Standard deviation of the prior of each of a part's columns, infinite for those without."""
    sd = np.full(len(part.names), math.inf)
    if part.curves is None:
        return sd
    by_joint: Mapping[int, Array] = {
        joint: np.sqrt(variances(length, amplitude, CYCLES))
        for joint, length, amplitude in zip(
            part.curves.joints, part.curves.lengths.tolist(), part.curves.amplitudes.tolist(), strict=True
        )
    }
    for place, name in enumerate(part.names):
        cycles, joint = cycles_of(name), int(name.rpartition("q")[2]) - 1
        if name in part.free:
            continue
        if cycles <= CYCLES and joint in by_joint:
            sd[place] = max(float(by_joint[joint][cycles - 1]), 1e-9)
    return sd


def cycles_of(name: str) -> int:
    """Cycles a turn of a column such as ``cos12q3``."""
    return int(name[3:].partition("q")[0])


def _order(columns: Sequence[EffectColumn]) -> NDArray[np.intp]:
    """Places of turning columns, then of shifting ones."""
    return np.argsort([column.joint is None for column in columns], kind="stable").astype(np.intp)


def whitening(sigma: Array | None, n: int) -> Array:
    """What turns errors of each point into units of their standard uncertainty, (3, 3, n) [1/m]."""
    if sigma is None:
        return np.ascontiguousarray(np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n)))
    white = whitener(sigma)
    return np.asarray(np.eye(3)[:, :, None] * white) if white.ndim == 1 else white
