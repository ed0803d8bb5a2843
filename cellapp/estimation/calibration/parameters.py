"""Sets of parameters: which are estimated, with which priors, and which of them the data determine.

The estimate uses all parameters that can have an effect, each with its prior, so that predictions lose nothing. Few
data sets determine all of them: some act exactly like others, some too weakly to rise above noise and prior. A table
states the *determined* set with standard errors; the other parameters are merged into it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import solve_psd
from cellapp.robot.kinematics.chain import (
    TOOL_NAMES,
    Geometry,
    JointAngles,
    all_names,
    jacobian,
    parallel_rows,
    parameter_names,
    parameter_unit,
)
from cellapp.robot.kinematics.transforms import Array

SetName = Literal["auto", "paper", "full"]

EXPECTED_SCATTER_M = 1e-4
"""Standard deviation of a coordinate before any reading: residuals that gravity and backlash leave in UR arms."""
_PAPER_DROPS = {"theta1", "d1", "d2", "d4", "alpha5", "theta6", "d6", "a6", "alpha6"}
"""Parameters of a UR arm that Bai et al. (2023) do not identify."""
_WEAK_PRIOR = {"m": 3e-3, "rad": 5e-3}
"""Prior standard deviation of the arm's own parameters about the published ones if the profile states none: three to
ten times what calibrations of industrial arms find (0.3 to 1 mm, 0.5 to 2 mrad). It bounds what the data do not
determine, and leaves no trace in what they do."""
_TYPICAL = {"m": 0.5e-3, "rad": 1e-3}
"""Standard deviation that calibrations of industrial arms typically find."""
_TYPICAL_COUNT = 2.0
"""Number of parameters of typical size that are added to the arm's own in the estimate of their spread, so that it has
a value even if the data determine few of them."""
_UNKNOWN = {"m": 0.1, "rad": 0.1}
"""Stand-in for a prior of base and tool, which have none, when judging whether the data determine them: a first guess
by eye is that good."""
_LEAST_INFORMATION = 3.0
"""Information of the data, in units of the prior's, from which a parameter counts as determined: its standard deviation
is then at most half of the prior's."""
_RIDGE = 1e-3
"""Ridge added to that information, so that exactly dependent columns can be factored."""
_ROUNDING = 1e-12
"""Share of a column's information that rounding leaves after the elimination of some 30 others."""
_EXACT = 10.0
"""Number of ridges below which a column is exactly dependent on others: eliminating it changes no other column."""
_HELD = 1e30
"""Precision of a parameter that is held at its nominal value."""
_SMALL_SHARE = 1e-3
"""Share of a merged parameter below which it is not listed."""


@dataclass(frozen=True)
class ParameterSet:
    """A choice of parameters, and those that are merged into them.

    Attributes
    ----------
    name : str
        ``auto``, ``paper``, ``full`` or a name given by the caller.
    joints : int
        Number of joints N.
    columns : tuple of int, length k
        Indices of the parameters in ``all_names``; rotations before translations.
    dropped : tuple of int, length l
        Indices of candidates that the data cannot tell from a linear combination of the columns.
    scaled_information : array, shape (k + l, k + l), optional
        Information matrix of the data about columns and dropped columns, in that order, each scaled by its ``unit``.
    unit : array, shape (k + l,), optional
    tied : tuple of pairs of int
        Indices of a parameter that is corrected by the same amount as one of the columns, and of that one.
    """

    name: str
    joints: int
    columns: tuple[int, ...]
    dropped: tuple[int, ...] = ()
    scaled_information: Array | None = None
    unit: Array | None = None
    tied: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, name: str, geometry: Geometry, columns: tuple[int, ...]) -> ParameterSet:
        """Return the ``columns`` without those that are tied to others; ``ValueError`` if a tied one is not there."""
        place = geometry.names.index
        tied = tuple((place(other), place(first)) for other, first in geometry.tied_to.items())
        if missing := {column for pair in tied for column in pair}.difference(columns):
            lost = geometry.names[min(missing)]
            raise ValueError(f"{lost} is in the arm's 'tied', but not estimated; take it out, or take another set")
        followers = {follower for follower, _ in tied}
        return cls(name, geometry.joints, tuple(c for c in columns if c not in followers), tied=tied)

    def jacobian(self, geometry: Geometry, angles: JointAngles, more: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Compute as ``jacobian`` of ``more`` parameters, then of the columns, each with those tied to it."""
        followers = tuple(follower for follower, _ in self.tied)
        P, J = jacobian(geometry, angles, (*more, *self.columns, *followers))
        end = J.shape[1] - len(followers)
        for place, (_, first) in enumerate(self.tied, start=end):
            J[:, len(more) + self.columns.index(first)] += J[:, place]
        return P, J[:, :end]

    def moved(self, geometry: Geometry, values: Array) -> Geometry:
        """Return the geometry with ``values`` (k,) of the columns; tied parameters change by the same amount."""
        vector = geometry.vector()
        for follower, first in self.tied:
            vector[follower] += values[self.columns.index(first)] - vector[first]
        vector[list(self.columns)] = values
        return geometry.with_vector(vector)

    def limits(self, nominal: Geometry, size: int) -> Array | None:
        """Return least and largest values (2, size) of the columns by the bounds of all that move with them, and of
        what stands behind the columns, which has none; None if nothing has bounds."""
        vector, names = nominal.vector(), nominal.names
        limits = np.array([[-math.inf], [math.inf]]) * np.ones(size)
        for name, pair in nominal.bounds.items():
            own = names.index(name)
            first = dict(self.tied).get(own, own)
            if first in self.columns:
                place = self.columns.index(first)
                low, high = np.array(pair) - vector[own] + vector[first]
                limits[:, place] = max(limits[0, place], low), min(limits[1, place], high)
        return limits if np.isfinite(limits).any() else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return _names_of(self.columns, self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return _units_of(self.columns, self.joints)

    @property
    def rotations(self) -> int:
        """Number of rotations among the columns; they come first."""
        return self.units.count("rad")

    @cached_property
    def shares(self) -> Array:
        """Coefficients (k, l): one unit of dropped parameter l acts like these amounts of the kept parameters."""
        k = len(self.columns)
        if self.scaled_information is None or self.unit is None:
            return np.zeros((k, 0))
        shares = solve_psd(self.scaled_information[:k, :k], self.scaled_information[:k, k:])
        return np.asarray(shares * self.unit[:k, None] / self.unit[k:])

    @cached_property
    def merged(self) -> dict[str, dict[str, float]]:
        """Dropped parameter -> {kept parameter: coefficient}; empty if the dropped one has no effect on these data."""
        names = all_names(self.joints)
        return {
            names[column]: {
                kept: round(float(share), 9)
                for kept, share in zip(self.names, self.shares[:, place], strict=True)
                if abs(share) > _SMALL_SHARE
            }
            for place, column in enumerate(self.dropped)
        }

    def from_estimated(self, estimated: ParameterSet) -> tuple[Array, NDArray[np.intp]]:
        """Return the matrix (k, K) from deviations of all ``estimated`` parameters to those of this set, and the
        indices (k,) of this set's parameters among them."""
        place = {column: i for i, column in enumerate(estimated.columns)}
        kept = np.array([place[column] for column in self.columns], dtype=np.intp)
        matrix = np.eye(len(place))[kept]
        if self is not estimated:
            matrix[:, [place[column] for column in self.dropped]] = self.shares
        return matrix, kept


@lru_cache(maxsize=64)
def _names_of(columns: tuple[int, ...], joints: int) -> tuple[str, ...]:
    names = all_names(joints)
    return tuple(names[c] for c in columns)


@lru_cache(maxsize=64)
def _units_of(columns: tuple[int, ...], joints: int) -> tuple[str, ...]:
    return tuple(parameter_unit(name) for name in _names_of(columns, joints))


@lru_cache(maxsize=32)
def _candidates(names: tuple[str, ...], joints: int, parallel: tuple[int, ...]) -> tuple[int, ...]:
    betas = {f"beta{i + 1}" for i in parallel}
    return _rotations_first(
        tuple(
            column
            for column, name in enumerate(names)
            if name != f"alpha{joints}" and (name == "beta0" or not name.startswith("beta") or name in betas)
        ),
        joints,
    )


@lru_cache(maxsize=32)
def _preference(columns: tuple[int, ...], joints: int) -> NDArray[np.int64]:
    """Return indices into ``columns`` in order of preference for a table: base, tool, then D-H rows from joint 1 on."""
    tool = 6 + 5 * joints
    return np.array(sorted(range(len(columns)), key=lambda place: (6 <= columns[place] < tool, columns[place])))


def candidate_columns(geometry: Geometry) -> tuple[int, ...]:
    """Return the parameters that can have an effect: base, tool and D-H rows, with beta for parallel axes, without
    alpha_N, and a probe's rotation, which takes the place of alpha_N."""
    return _candidates(geometry.names, geometry.joints, parallel_rows(geometry))


def full_set(geometry: Geometry) -> ParameterSet:
    """Return the redundant set of all candidates (34 for six joints with two parallel pairs), the paper's start."""
    return ParameterSet.of("full", geometry, candidate_columns(geometry))


def paper_set(geometry: Geometry) -> ParameterSet:
    """Return the 26 parameters of a UR arm in Bai et al. (2023); alpha5 is dropped too, though it is not redundant.

    Raises
    ------
    ValueError
        If the arm is not a UR: six joints, axes 2, 3 and 4 parallel.
    """
    if geometry.joints != 6 or parallel_rows(geometry) != (1, 2):
        raise ValueError("the paper's parameter set is for six joints with axes 2, 3 and 4 parallel; use 'auto'")
    names = parameter_names(6)
    columns = tuple(c for c in candidate_columns(geometry) if names[c] not in _PAPER_DROPS)
    return ParameterSet.of("paper", geometry, columns)


@lru_cache(maxsize=32)
def weak_priors(joints: int) -> Mapping[str, float]:
    """Return prior standard deviations [m, rad] of the arm's own parameters about nominal; base and tool have none."""
    return MappingProxyType({name: _WEAK_PRIOR[parameter_unit(name)] for name in parameter_names(joints)[6:-3]})


def typical_spreads(joints: int) -> dict[str, float]:
    """Return the standard deviations [m, rad] of the arm's own parameters that industrial arms typically have."""
    return {name: _TYPICAL[parameter_unit(name)] for name in parameter_names(joints)[6:-3]}


def estimated_parameters(
    wanted: SetName, geometry: Geometry, prior_sigma: Mapping[str, float]
) -> tuple[ParameterSet, Mapping[str, float]]:
    """Return the parameters that a named set estimates, and the standard deviations of their priors [m, rad].

    ``auto`` holds all candidates; each of the arm's own has the given prior, else a weak one. The sets ``paper``
    and ``full`` have the given priors only.

    Raises
    ------
    ValueError
        If the set is not for this arm.
    """
    if wanted == "paper":
        return paper_set(geometry), prior_sigma
    if wanted == "full":
        return full_set(geometry), prior_sigma
    return replace(full_set(geometry), name="auto"), {**weak_priors(geometry.joints), **prior_sigma}


def sds_of(precision: Array) -> Array:
    """Return the standard deviations of priors by their precisions, infinite without one."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(precision))


def sigma_by_name(names: Sequence[str], precision: Array) -> dict[str, float]:
    """Return the standard deviations of the priors by parameter, without those that have none."""
    stated = zip(names, precision.tolist(), strict=False)
    return {name: value**-0.5 for name, value in stated if value > 0.0}


def determined_set(estimated: ParameterSet, information: Array, prior_sd: Array) -> ParameterSet:
    """Choose the ``estimated`` parameters that the data determine, judged against noise and priors.

    Go through the parameters in order of preference, with those kept so far free. Keep a parameter if the data halve
    the standard deviation of its prior. Merge the others into the kept ones.

    Parameters
    ----------
    estimated : ParameterSet
        k columns.
    information : array, shape (k, k)
        ``J^T W J``, W the inverse of the readings' covariance.
    prior_sd : array, shape (k,)
        Standard deviations of the priors in the parameters' units, infinite without one.
    """
    weak = np.array([_UNKNOWN[unit] for unit in estimated.units])
    unit = np.where(np.isfinite(prior_sd), prior_sd, weak) / math.sqrt(_LEAST_INFORMATION)
    scaled = information * unit * unit[:, None]
    order = _preference(estimated.columns, estimated.joints)
    held = np.zeros(len(order), dtype=bool)
    held[order] = _undetermined(scaled[order[:, None], order])
    kept, dropped = np.flatnonzero(~held).tolist(), np.flatnonzero(held).tolist()
    both = np.array([*kept, *dropped], dtype=np.intp)
    return ParameterSet(
        estimated.name,
        estimated.joints,
        columns=tuple(estimated.columns[place] for place in kept),
        dropped=tuple(estimated.columns[place] for place in dropped),
        scaled_information=scaled[both[:, None], both],
        unit=unit[both],
        tied=tuple(pair for pair in estimated.tied if pair[1] in {estimated.columns[place] for place in kept}),
    )


def _undetermined(information: Array) -> NDArray[np.bool_]:
    """Return a mask (k,) of the columns with information below 1 while the kept columns before them are free.

    The square of a Cholesky pivot is the information about a parameter while those before it are free. A column that is
    not kept is held at its nominal value; then the matrix is factored again, unless the column is exactly dependent.
    """
    held = np.zeros(len(information), dtype=bool)
    diagonal, work = np.diag(information), information.copy()
    ridge = _RIDGE + _ROUNDING * diagonal
    # Without noise, a dependent column is left with the ridges of those that it depends on.
    enough = 1.0 + _RIDGE + _EXACT * _ROUNDING * diagonal
    while True:
        np.fill_diagonal(work, diagonal + np.where(held, _HELD, ridge))
        factor, _ = scipy.linalg.lapack.dpotrf(work, lower=1)
        own = np.diag(factor) ** 2
        low = np.flatnonzero(own <= enough)
        inexact = np.flatnonzero(own[low] > _EXACT * ridge[low])
        if not len(inexact):
            held[low] = True
            return held
        held[low[: inexact[0] + 1]] = True


def auto_set(geometry: Geometry, q: Array) -> ParameterSet:
    """Choose the parameters that readings at ``q`` (n, N) [rad] with the expected scatter determine."""
    estimated, priors = estimated_parameters("auto", geometry, {})
    _, J = estimated.jacobian(geometry, JointAngles.of(q))
    return determined_set(estimated, gram_matrix(J) / EXPECTED_SCATTER_M**2, prior_sds(estimated, priors))


def unknown_offset(geometry: Geometry, q: Array, R_M_S: Array | None = None) -> dict[str, float]:
    """Return prior standard deviations [m] of the SMR's offset if points at ``q`` (n, N) [rad] tell nothing of it.

    Orientations ``R_M_S`` do.
    """
    determined = R_M_S is not None or {*TOOL_NAMES} & {*auto_set(geometry, q).names}
    return {} if determined else dict.fromkeys(TOOL_NAMES, _UNKNOWN["m"])


@dataclass(frozen=True)
class PriorSpread:
    """Common prior standard deviation, not stated in the profile, of the parameters with indices ``places``.

    It is estimated with them, about a ``typical`` one (MacKay, Neural Comput. 4 (1992) 415).
    """

    places: NDArray[np.intp]
    typical: float

    def square(self, deviations: Array, by_priors: float) -> float:
        """Estimate the variance from ``deviations`` (k,) from nominal; the priors determine ``by_priors`` of the k."""
        determined = len(deviations) - by_priors
        return (float(deviations @ deviations) + _TYPICAL_COUNT * self.typical**2) / (determined + _TYPICAL_COUNT)


def prior_spreads(parameters: ParameterSet, free: Collection[str]) -> tuple[PriorSpread, ...]:
    """Group the lengths and the angles among the parameters ``free``, whose priors the profile does not state."""
    groups = []
    for unit, typical in _TYPICAL.items():
        pairs = enumerate(zip(parameters.names, parameters.units, strict=True))
        places = [place for place, (name, its_unit) in pairs if name in free and its_unit == unit]
        if places:
            groups.append(PriorSpread(np.array(places, dtype=np.intp), typical))
    return tuple(groups)


def prior_sds(parameters: ParameterSet, sigma: Mapping[str, float]) -> Array:
    """Return the standard deviations (k,) of the priors of a set's parameters, infinite without a prior."""
    return np.array([sigma.get(name, math.inf) for name in parameters.names])


def gram_matrix(J: Array) -> Array:
    """Compute ``J^T J`` (k, k) of a Jacobian (3, k, n), summed over components and configurations."""
    rows = J.swapaxes(0, 1).reshape(J.shape[1], -1)
    return np.asarray(rows @ rows.T)


def _rotations_first(columns: tuple[int, ...], joints: int) -> tuple[int, ...]:
    """Sort rotations before translations, each in the order of the chain: the fastest order for the Jacobian."""
    names = all_names(joints)
    return tuple(sorted(columns, key=lambda c: (parameter_unit(names[c]) == "m", c)))
