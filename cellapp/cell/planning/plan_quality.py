"""What the stops of a plan tell, against random plans: standard errors, predictions over the workspace, observability.

Random plans have configurations as the planner with ``method: random`` draws them: uniform over those that are visible
and clear. Approach, step and time are drawn for both kinds of plan, so that only the choice of stops differs.
Predictions are judged at configurations of the workspace that were not used to choose stops and that the tracker need
not see.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.candidates import CandidatePool, random_configurations, workspace_configurations
from cellapp.cell.planning.design_records import ArmDesign, ErrorName, ObservabilityIndices, PlanQuality
from cellapp.cell.planning.information import InformationModel, drawn_conditions, information_model
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.estimation.calibration.parameters import determined_set
from cellapp.estimation.design.block_design import information_of, largest_gaps, without_turns
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.transforms import Array

ERROR_NAMES: tuple[ErrorName, ...] = get_args(ErrorName)

_POINTS = 600
"""Number of configurations at which predictions are judged: the mean is then known to 2 %."""
_LARGER = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Sizes of the random plans, relative to the judged plan; the equivalent size is interpolated among them."""
_MOST_RANDOM = 12_000
"""Upper limit of the configurations in all random plans: bounds time and memory for plans of thousands of stops."""
_DRAWS = 6
"""Number of random plans of each size that are averaged: the worst point differs by 10 % from plan to plan."""
_PARTS = (25, 50, 100, 200, 400, 800, 1600, 3200)
"""Numbers of stops after which the expected errors are stated."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Standard errors (k,) in units of the model's sizes; mean and largest uncertainty of predictions [m]."""

    parameters: Array
    mean: float
    worst: float


@dataclass(frozen=True, eq=False)
class Judge:
    """Model, workspace points and random plans by which plans of one arm are judged.

    Attributes
    ----------
    model : InformationModel
        Columns of geometry and of the effects that the profile lists.
    points : array, shape (s, 3, p)
        Derivatives of predictions [m].
    random : array, shape (m, 3, p)
        Whitened rows of random configurations.
    others : mapping
        Configurations of the other arms.
    rng
        Draws random plans and conditions.
    """

    model: InformationModel
    points: Array
    random: Array
    others: Mapping[str, Array]
    rng: np.random.Generator

    @classmethod
    def of(
        cls,
        profile: Profile,
        name: str,
        others: Mapping[str, Array],
        stops: int,
        rng: np.random.Generator,
        cancel: CancelToken,
    ) -> Judge:
        """Set up for plans of ``stops`` stops of an arm; ``others`` are configurations of the other arms."""
        cell = cell_bodies(profile)
        number = min(math.ceil(_LARGER[-1] * stops), max(_MOST_RANDOM, stops))
        drawn = []
        for q in islice(random_configurations(cell, profile, name, rng), number):
            cancel.check()
            drawn.append(q)
        q = np.array(drawn)
        conditions = drawn_conditions(profile, name, q, others, rng)
        model = information_model(profile, name, q, conditions, potential=False)
        targets = workspace_configurations(profile, cell, name, _POINTS, rng)
        return cls(
            model,
            model.prediction_rows(targets, drawn_conditions(profile, name, targets, others, rng)),
            model.rows(q, conditions),
            others,
            rng,
        )

    @cached_property
    def _point_rows(self) -> NDArray[np.float32]:
        """Rows (3 s, p) of the points in single precision: uncertainties are stated to three digits."""
        return self.points.reshape(-1, self.points.shape[2]).astype(np.float32)

    def sizes(self, stops: int) -> list[int]:
        """Return the sizes of random plans among which the equivalent of ``stops`` stops is found."""
        return sorted({min(round(ratio * stops), len(self.random)) for ratio in _LARGER})

    def rows(self, q: Array) -> Array:
        """Compute whitened rows (n, 3, p) of stops ``q`` (n, N) [rad] under drawn conditions."""
        return self.model.rows(q, drawn_conditions(self.model.profile, self.model.name, q, self.others, self.rng))

    def errors(self, information: Array) -> Errors:
        """Compute the errors from the information matrix (p, p) of readings."""
        covariance = inverse_psd(np.eye(len(information)) + information)
        squares = np.einsum("rp,rp->r", self._point_rows @ covariance.astype(np.float32), self._point_rows)
        points = np.sqrt(squares.reshape(-1, 3).sum(axis=1))
        return Errors(np.sqrt(np.diag(covariance)), float(points.mean()), float(points.max()))

    def random_plans(self, sizes: Sequence[int]) -> dict[int, tuple[Errors, Array]]:
        """Compute mean errors and mean information matrix (p, p) of random plans, for each of the ``sizes``."""
        p = self.random.shape[2]
        found = {size: list[Errors]() for size in sizes}
        total = {size: np.zeros((p, p)) for size in sizes}
        for _ in range(_DRAWS):
            order = self.rng.permutation(len(self.random))
            information, before = np.zeros((p, p)), 0
            for size in sorted(sizes):
                information = information + information_of(self.random[order[before:size]])
                before = size
                found[size].append(self.errors(information))
                total[size] += information / _DRAWS
        return {size: (_mean(errors), total[size]) for size, errors in found.items()}

    def determined(self, information: Array) -> tuple[int, ...]:
        """Return the indices of the geometric parameters that readings with this information matrix determine.

        The others are redundant: with them the least singular value of the Jacobian would be zero.
        """
        parameters = self.model.parameters
        g = len(parameters.columns)
        size = self.model.size[:g]
        chosen = determined_set(parameters, information[:g, :g] / (size * size[:, None]), size)
        return tuple(parameters.columns.index(column) for column in chosen.columns)


def _mean(errors: Sequence[Errors]) -> Errors:
    return Errors(
        np.mean([one.parameters for one in errors], axis=0),
        float(np.mean([one.mean for one in errors])),
        float(np.mean([one.worst for one in errors])),
    )


def observability(information: Array, geometry: Sequence[int], stops: int) -> ObservabilityIndices:
    """Compute the indices from the information matrix (p, p) of ``stops`` stops.

    Only the parameters ``geometry`` count, each in units of its expected size.
    """
    chosen = np.array(geometry, dtype=np.intp)
    squares = np.linalg.eigvalsh(information[chosen[:, None], chosen])[::-1]
    s = np.sqrt(np.maximum(squares, np.finfo(np.float64).tiny))
    return ObservabilityIndices(
        o1=math.exp(float(np.mean(np.log(s)))) / math.sqrt(stops),
        o2=float(s[-1] / s[0]),
        o3=float(s[-1]),
        o4=float(s[-1] ** 2 / s[0]),
        o5=float(1.0 / np.sum(1.0 / s)),
    )


def _quality(stops: int, errors: Errors, random: Errors, indices: ObservabilityIndices) -> PlanQuality:
    """Compare the errors with those of equally many random stops (``random``)."""
    return PlanQuality(
        stops=stops,
        parameters=float(np.mean(errors.parameters / random.parameters)),
        mean_mm=1e3 * errors.mean,
        worst_mm=1e3 * errors.worst,
        indices=indices,
    )


def arm_design(
    profile: Profile,
    pool: CandidatePool,
    name: str,
    stops: Mapping[str, Array],
    rng: np.random.Generator,
    cancel: CancelToken | None = None,
) -> ArmDesign:
    """Evaluate the stops of one arm against random ones.

    Parameters
    ----------
    profile : Profile
    pool : CandidatePool
        From which the stops were chosen.
    name : str
        The arm.
    stops : mapping
        Arm -> joint positions (n, N) [rad] in the order of the plan, of all arms.
    rng : numpy.random.Generator
    cancel : CancelToken, optional

    Raises
    ------
    InputError
        If the profile lists an effect that no plan of this cell can show, or does not describe the cell.
    Cancelled
    """
    q = stops[name]
    n = len(q)
    others = {other: theirs for other, theirs in stops.items() if other != name}
    with one_blas_thread():
        judge = Judge.of(profile, name, others, n, rng, cancel or CancelToken())
        rows = judge.rows(q)
        parts = [*(part for part in _PARTS if part < n), n]
        random = judge.random_plans(sorted({*parts, *judge.sizes(n)}))
        geometry = judge.determined(random[n][1])
        by_stops = []
        for part in parts:
            information = information_of(rows[:part])
            indices = observability(information, geometry, part)
            by_stops.append(_quality(part, judge.errors(information), random[part][0], indices))
        designed = judge.errors(information_of(rows))
    equal, of_random = random[n]
    return ArmDesign(
        candidates=len(pool.q),
        drawn=pool.drawn,
        rejected=pool.rejected,
        designed=by_stops[-1],
        random=_quality(n, equal, equal, observability(of_random, geometry, n)),
        equal_to_random=equal_to_random(designed, {size: random[size][0] for size in judge.sizes(n)}, n),
        by_stops=tuple(by_stops),
        largest_gap=tuple(largest_gaps(without_turns(q, pool.q)).tolist()),
    )


def equal_to_random(errors: Errors, random: Mapping[int, Errors], stops: int) -> dict[ErrorName, float]:
    """Find the number of random stops with the same errors, interpolated among ``random`` plans; at most the largest.

    ``parameters`` is the mean of the standard errors, each relative to that of ``stops`` random stops.
    """
    unit = random[stops].parameters

    def three(one: Errors) -> Array:
        return np.asarray(np.log([float(np.mean(one.parameters / unit)), one.mean, one.worst]))

    sizes = sorted(random)
    curve = np.array([three(random[size]) for size in sizes])
    curve = np.minimum.accumulate(curve, axis=0)  # the mean of a few draws may rise again
    equal = [
        float(np.exp(np.interp(-wanted, -curve[:, k], np.log(sizes))))
        for k, wanted in enumerate(three(errors).tolist())
    ]
    return dict(zip(ERROR_NAMES, equal, strict=True))
