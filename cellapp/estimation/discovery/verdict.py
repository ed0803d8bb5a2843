"""Verdict on one arm: explained, nothing missing, unknown effect or ambiguous, with one sentence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    BeforeAfter,
    RemainingStructure,
    StructureKind,
    StructureTest,
    Unnamed,
)
from cellapp.estimation.discovery.search.state import FLOOR_CHANCE, FitScatter
from cellapp.ground.results import Verdict
from cellapp.robot.effects import EFFECTS, enumeration, place_in_words
from cellapp.robot.effects.context import varies
from cellapp.robot.effects.time_functions import times_known
from cellapp.robot.kinematics.transforms import Array

# Tests whether the residuals of a model still have structure: whether neighbouring readings have similar residuals.
#
# With residuals y_i, the sum of products y_i y_k over pairs of neighbours is large if y depends on the quantity in
# which they are neighbours (Moran, Biometrika 37 (1950) 17). It is compared with its distribution under random signs
# of whole residual vectors (Fisher's randomisation test). Noise is symmetric, and each vector keeps its length and its
# place; so a scatter that varies over the workspace is not taken for structure. Under random signs the mean is zero
# and the variance is the sum of squared products. The skewness is simulated. The tail is that of the Pearson type III
# distribution with these moments, which needs few simulations (Winkler et al., NeuroImage 141 (2016) 502). A fit makes
# neighbouring residuals slightly less alike, so the one-sided test is conservative.

CHANCE = 0.01
"""Probability that pure noise is reported as structure, over all tests."""
_SIGNS = 200
"""Number of samples of random signs: they determine the skewness to 0.17, enough for the tail."""
_SIGN_SEED = 0x516
"""Combined with the profile's seed, so that the signs are independent of all other samples."""
_NEIGHBOURS = 6
"""Neighbours of each reading: fewer lose power against smooth structure, more lose power against short periods."""
_MOST_PAIRS = 20_000
"""Largest number of pairs in one test, sampled at random. It bounds time and memory for many readings."""
_LONGEST = 3.0
"""Residual vectors are shortened to this multiple of their median length: an outlier says nothing about structure."""
_LEAST_SKEWNESS = 1.6e-5
"""Skewness below which the gamma distribution is normal to double precision and its shape would lose digits."""
_LEAST_READINGS = 20
"""Least number of readings to test: the tail of a sum of fewer products is not known."""

Pairs = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Indices of the first and second reading of each pair."""


def residual_structure(data: ArmData, fit: JointFit) -> RemainingStructure:
    """Test a fit's residuals against all that the readings state; return the outcome in words.

    Each kind has several tests; its p-value is the smallest times their number (Bonferroni), at most 1.
    """
    if len(data) < _LEAST_READINGS:
        return remaining_structure({})
    found: dict[StructureKind, list[float]] = {}
    every = np.ones(len(data), dtype=np.bool_)
    for rows in (every,) if data.angular is None else (~data.angular, data.angular):
        if np.count_nonzero(rows) < _LEAST_READINGS:
            continue
        tests = _Tests.of(data, fit, rows)
        kinds: dict[StructureKind, Callable[[], list[float]]] = {
            "joints": tests.against_joints,
            "order": tests.against_order,
            "time": tests.against_time,
            "approach": tests.against_approach,
        }
        if rows is not data.angular:
            kinds |= {"position": tests.against_position, "tracker": tests.against_tracker}
        for kind, test in kinds.items():
            found.setdefault(kind, []).extend(test())
    p_values = {kind: min(min(own) * len(own), 1.0) for kind, own in found.items() if own}
    return remaining_structure(p_values)


def has_structure(found: RemainingStructure) -> bool:
    """Return whether any test shows structure, corrected for their number."""
    return any(test.p_value <= CHANCE / len(found.tests) for test in found.tests)


@dataclass(frozen=True, eq=False)
class _Tests:
    """Residuals of a fit and the quantities they are tested against.

    Attributes
    ----------
    data : ArmData
    residuals : array, shape (n, 3)
        Whitened, with outliers shortened.
    about_axes : array, shape (N, n)
        Components along the SMR motion by each joint, times the lever.
    generator : numpy Generator
    signs : array, shape (n, s)
        Random signs, the same for the readings of a configuration.
    """

    data: ArmData
    residuals: Array
    about_axes: Array
    generator: np.random.Generator
    signs: NDArray[np.float32]

    @classmethod
    def of(cls, data: ArmData, fit: JointFit, rows: NDArray[np.bool_]) -> _Tests:
        """Prepare the rows in a mask (n,), all of them positions or all orientations."""
        generator = np.random.default_rng([data.profile.seed, _SIGN_SEED])
        residuals, by_joint = fit.residual.reshape(3, len(data)).T, fit.by_joint
        if not rows.all():
            data, residuals, by_joint = data.take(np.flatnonzero(rows)), residuals[rows], by_joint[:, :, rows]
        lengths = np.linalg.norm(residuals, axis=1)
        longest = _LONGEST * float(np.median(lengths))
        residuals = residuals * np.minimum(1.0, longest / np.maximum(lengths, longest))[:, None]
        about_axes = np.einsum("cjn,nc->jn", by_joint, residuals)
        configurations = int(data.group.max()) + 1
        signs = generator.choice(np.array([-1.0, 1.0], dtype=np.float32), (configurations, _SIGNS))[data.group]
        return cls(data, residuals, about_axes, generator, signs)

    def against_joints(self) -> list[float]:
        """Test the motion about each joint against angles and pairs of angles, and vectors in joint space."""
        q = _standardised(self.data.readings.q)
        moved = np.flatnonzero(np.ptp(q, axis=0) > 0.0).tolist()
        if not moved:
            return []
        found = self._of_vectors(_nearest(q[:, moved]))
        for first, joint in enumerate(moved):
            found += self._of_components(_along(q[:, joint]), self.about_axes)
            for other in moved[:first]:
                found += self._of_components(_nearest(q[:, [joint, other]]), self.about_axes)
        return found

    def against_order(self) -> list[float]:
        """Test in the order of the stops, by number if unknown; no test if that is the order of time."""
        order, times = self.data.conditions.order, self._times
        if order is None:
            order = self.data.readings.configuration.astype(np.float64)
        if times is not None and bool(np.all(np.diff(times[np.argsort(order, kind="stable")]) >= 0.0)):
            return []
        return self._against_sequence(order)

    def against_time(self) -> list[float]:
        """Test readings that are neighbours in time."""
        return [] if self._times is None else self._against_sequence(self._times)

    def against_approach(self) -> list[float]:
        """Test the mean motion about each joint's axis in the direction of that joint's last motion.

        Under random signs the sum is nearly normal, as no summand dominates.
        """
        if not varies(self.data.conditions.approach):
            return []
        towards = _sums(self.data.context.approach.T * self.about_axes, self.data.group)
        size = np.sqrt(np.sum(towards**2, axis=1))
        moved = size > 0.0
        found: list[float] = (2.0 * scipy.special.ndtr(-np.abs(towards[moved].sum(axis=1)) / size[moved])).tolist()
        return found

    def against_position(self) -> list[float]:
        """Test residual vectors of neighbours in space."""
        return self._of_vectors(_nearest(self.data.readings.p_M))

    def against_tracker(self) -> list[float]:
        """Test components along and across the beam against distance, azimuth and elevation."""
        context = self.data.context
        distance, beam = context.beam
        azimuth, elevation, horizontal, upward = context.across
        components = np.stack([np.sum(self.residuals * one, axis=1) for one in (beam, horizontal, upward)])
        return [
            p
            for value in (distance, azimuth, elevation)
            if np.ptp(value) > 0.0
            for p in self._of_components(_along(value), components)
        ]

    @property
    def _times(self) -> Array | None:
        return self.data.conditions.time_s if times_known(self.data.context) else None

    def _against_sequence(self, values: Array) -> list[float]:
        pairs = _along(values)
        return [*self._of_components(pairs, self.about_axes), *self._of_vectors(pairs)]

    def _of_vectors(self, pairs: Pairs) -> list[float]:
        """Test the scalar products of whole residual vectors."""
        i, k = self._some(pairs)
        return self._p_values((i, k), np.einsum("pc,pc->p", self.residuals[i], self.residuals[k])[None])

    def _of_components(self, pairs: Pairs, components: Array) -> list[float]:
        """Test the products of each component (m, n)."""
        i, k = self._some(pairs)
        return self._p_values((i, k), components[:, i] * components[:, k])

    def _some(self, pairs: Pairs) -> Pairs:
        count = len(pairs[0])
        if count <= _MOST_PAIRS:
            return pairs
        chosen = self.generator.choice(count, _MOST_PAIRS, replace=False)
        return pairs[0][chosen], pairs[1][chosen]

    def _p_values(self, pairs: Pairs, products: Array) -> list[float]:
        """Return one-sided p-values of the sums of products (m, pairs).

        Readings of one configuration have like residuals: they are no pair, and their pairs with those of another one
        are one product.
        """
        of_first, of_second = (self.data.group[rows] for rows in pairs)
        code = np.minimum(of_first, of_second) * len(self.data) + np.maximum(of_first, of_second)
        apart = of_first != of_second
        _, first, number = np.unique(code[apart], return_index=True, return_inverse=True)
        pairs = pairs[0][apart][first], pairs[1][apart][first]
        products = _sums(products[:, apart], number)
        size = np.sqrt(np.sum(products**2, axis=1))
        scaled = products[size > 0.0] / size[size > 0.0, None]
        simulated = scaled.astype(np.float32) @ (self.signs[pairs[0]] * self.signs[pairs[1]])
        skewness = np.maximum(np.mean(simulated.astype(np.float64) ** 3, axis=1), 0.0)
        found: list[float] = pearson3_tail(scaled.sum(axis=1), skewness).tolist()
        return found


def _sums(values: Array, group: NDArray[np.intp]) -> Array:
    """Return the sums (m, groups) of values (m, n) over the members of each group."""
    return np.stack([np.bincount(group, one) for one in values])


def pearson3_tail(values: Array, skewness: Array) -> Array:
    """Return upper tail probabilities (m,) of a Pearson type III variable: mean 0, variance 1, ``skewness`` >= 0.

    It is a shifted and scaled gamma variable of shape 4 / skewness^2, and normal for zero skewness.
    """
    skewed = np.maximum(skewness, _LEAST_SKEWNESS)
    shape = (2.0 / skewed) ** 2
    of_gamma = scipy.special.gammaincc(shape, np.maximum(2.0 / skewed * values + shape, 0.0))
    return np.asarray(np.where(skewness < _LEAST_SKEWNESS, scipy.special.ndtr(-values), of_gamma))


def _along(values: Array) -> Pairs:
    """Return pairs of neighbours in the order of values (n,)."""
    order = np.argsort(values, kind="stable")
    lags = range(1, min(_NEIGHBOURS, len(order) - 1) + 1)
    return np.concatenate([order[:-lag] for lag in lags]), np.concatenate([order[lag:] for lag in lags])


def _nearest(points: Array) -> Pairs:
    """Return pairs of nearest neighbours among points (n, d), each pair once."""
    _, near = scipy.spatial.KDTree(points).query(points, k=_NEIGHBOURS + 1)
    first = np.repeat(np.arange(len(points)), _NEIGHBOURS)
    second = np.asarray(near[:, 1:], dtype=np.intp).ravel()
    code = np.unique(np.minimum(first, second) * len(points) + np.maximum(first, second))
    low, high = np.divmod(code, len(points))
    different = low != high  # among identical points a reading may be its own neighbour
    return low[different], high[different]


def _standardised(points: Array) -> Array:
    """Scale points (n, d) to unit standard deviation along each axis."""
    spread = points.std(axis=0)
    return np.asarray(points / np.where(spread > 0.0, spread, 1.0))


# -- Outcomes of structure tests of the residuals, in words -----------------------------------------------------------


_KIND_WORDS: Mapping[StructureKind, str] = {
    "joints": "the joint angles",
    "order": "the order of the readings",
    "time": "time",
    "approach": "the side of approach",
    "position": "the position in the workspace",
    "tracker": "the tracker's distance and angles",
}


def remaining_structure(p_values: Mapping[StructureKind, float]) -> RemainingStructure:
    """Return the tests of the residuals and their outcome in words.

    Structure is reported if a p-value is at most ``CHANCE`` divided by the number of tests (Bonferroni). The
    probability that pure noise is reported as structure is then at most ``CHANCE``.
    """
    tests = tuple(StructureTest(against=kind, p_value=p) for kind, p in p_values.items())
    if not tests:
        return RemainingStructure(tests=(), sentence="the residuals were not tested for structure")
    found = [test for test in tests if test.p_value <= CHANCE / len(tests)]
    if found:
        words = enumeration([f"{_KIND_WORDS[test.against]} ({_p_in_words(test.p_value)})" for test in found])
        return RemainingStructure(tests=tests, sentence=f"the residuals still depend on {words}")
    tested = enumeration([_KIND_WORDS[test.against] for test in tests])
    smallest = min(test.p_value for test in tests)
    return RemainingStructure(
        tests=tests, sentence=f"the residuals show no structure against {tested} (smallest {_p_in_words(smallest)})"
    )


def _p_in_words(p_value: float) -> str:
    return "p below 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


_FLOOR = 1.05
"""Ratio of held-out rms error to noise floor up to which the gap counts as closed: with the twin's plan of a hundred
held-out stops it scatters by 4 %."""
_MOST_UNCERTAIN = 1.25
"""Ratio to the floor up to which uncertain parameters explain a held-out error: about that of a geometry and one law
from a few tens of stops. What is more uncertain is not explained."""
_FAR = 5.0
"""Ratio of scatter to stated noise that exceeds the repeatability of an arm: 75 µm of a coordinate against the 15 µm of
a tracker. Readings that show no structure, or are too few to, then still lack an explanation."""
_SAMPLING_ERRORS = 2.5
"""Standard errors by which the held-out rms may exceed the floor, a probability of 0.6 %: for 3 n coordinates, each is
``1 / sqrt(6 n)`` of it."""


def verdict(
    accepted: Sequence[AcceptedEffect],
    floor_mm: float,
    errors: BeforeAfter,
    held_out: int,
    scatter: FitScatter | None,
    structure: RemainingStructure,
    unnamed: Unnamed | None = None,
) -> tuple[Verdict, str]:
    """Return the verdict and its sentence.

    ``errors`` are the rms of ``held_out`` readings; ``scatter`` and ``structure`` are those of the residuals. An error
    at the stated noise counts as explained, if names alone reach it. If none is stated, the residuals must show no
    structure.
    """
    after_mm = errors.after
    driven = [effect.description for effect in accepted if effect.description is not None]
    named = [effect for effect in accepted if effect.effect != UNKNOWN]
    names = " and ".join(EFFECTS[effect.effect].title for effect in named)
    ambiguous = [effect for effect in named if effect.indistinguishable]
    if driven:
        also = f"{names}, and " if names else ""
        described = "; ".join(description.sentence for description in driven)
        return "unknown effect", f"{also}something that the library does not have: {described}"
    closed = scatter is not None and _gap_closed(floor_mm, after_mm, held_out, scatter)
    remaining = _remaining(floor_mm, after_mm, scatter, structure, closed=closed)
    nameless = False
    if unnamed is not None and unnamed.in_force:
        remaining = f"{unnamed_words(unnamed)}; {remaining}"
        alone_mm = math.inf if unnamed.heldout_position_mm is None else unnamed.heldout_position_mm.before.rms
        nameless = not (accepted and scatter is not None and _gap_closed(floor_mm, alone_mm, held_out, scatter))
    rest = has_structure(structure) or _far_off(scatter) or (bool(accepted) and scatter is not None)
    risen = bool(accepted) and after_mm >= errors.before
    if risen:
        remaining = f"held-out errors did not fall; {remaining}"
    if nameless or risen or (not closed and rest):
        found = f"{names} found{' (or one confounded with it)' if ambiguous else ''}, but " if accepted else ""
        return "unknown effect", f"{found}the library does not explain all of the error; {remaining}"
    if not accepted:
        return "nothing missing", remaining if closed else f"no effect found; {remaining}"
    if ambiguous:
        return "ambiguous", f"{names}, or {_confounded(ambiguous)}: these data cannot distinguish them; {remaining}"
    return "explained", f"{names}; {remaining}"


def unnamed_words(unnamed: Unnamed) -> str:
    """State the unnamed term: ``unnamed: 0.041 mm rms, mostly joints 2 and 3``."""
    return f"unnamed: {unnamed.rms_mm:.3f} mm rms, mostly {place_in_words(unnamed.acts_on)}"


def _remaining(
    floor_mm: float, after_mm: float, scatter: FitScatter | None, structure: RemainingStructure, *, closed: bool
) -> str:
    """Describe the residual error in words."""
    held_out = f"{after_mm * 1e3:.0f} µm rms held out"
    if scatter is None:
        return f"{structure.sentence}; {held_out}, and the readings state no uncertainty"
    gap = f"{held_out} against a noise floor of {floor_mm * 1e3:.0f} µm"
    if closed:
        return gap
    if has_structure(structure):
        return f"{structure.sentence}; {gap}"
    stated = f"times as {scatter.against}"
    if _far_off(scatter):
        why = "but show no structure" if structure.tests else "and are too few to look for effects"
        return f"readings scatter {scatter.ratio:.0f} {stated} {why}; {gap}"
    without = "but without structure" if structure.tests else "and are too few to test for structure"
    return f"readings scatter {scatter.ratio:.2f} {stated} {without}: repeatability or noise; {gap}"


def _far_off(scatter: FitScatter | None) -> bool:
    """Return whether readings scatter more than an arm's repeatability."""
    return scatter is not None and scatter.ratio > _FAR


def sampling_allowance(held_out: int) -> float:
    """Return the factor by which the rms error of n held-out readings may exceed another one by sampling alone.

    The rms of 3 n coordinates has a relative standard error of ``1 / sqrt(6 n)``.
    """
    return 1.0 + _SAMPLING_ERRORS / math.sqrt(6.0 * max(held_out, 1))


def _gap_closed(floor_mm: float, after_mm: float, held_out: int, scatter: FitScatter) -> bool:
    """Return whether the held-out error is at the noise floor, and the residuals, too, may be the stated noise."""
    noise = scatter.p_value > FLOOR_CHANCE
    if not held_out:
        return noise
    at_floor = after_mm <= floor_mm * _MOST_UNCERTAIN * sampling_allowance(held_out)
    return after_mm <= floor_mm * _FLOOR or (at_floor and (noise or scatter.ratio < _FLOOR))


def _confounded(effects: Sequence[AcceptedEffect]) -> str:
    slugs = dict.fromkeys(slug for effect in effects for slug in effect.indistinguishable)
    return " or ".join(EFFECTS[slug].title for slug in slugs)
