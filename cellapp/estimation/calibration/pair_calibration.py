"""Cooperative accuracy of two arms by every method, on the same held-out stops.

    nominal    published chains; bases registered to the tracker
    method_1   identified geometry alone
    method_2   geometry and a network trained in the tracker frame; its output is added in the base frame: wrong
    proposed   geometry and a network in the base frame (Bai et al. 2023)
    effects    geometry and the named effects

Each method identifies the inter-base transform from its own positions twice, for comparison: from distances, where both
flanges have a probe together with relative rotations; and from the common tracker frame (both bases registered to the
tracker on the same stops).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from cellapp.estimation.calibration.identification import TooFewReadings
from cellapp.estimation.calibration.least_squares import LeastSquares, inverse_psd
from cellapp.estimation.calibration.quantities import (
    measured_orientations,
    measurement_conditions,
    position_errors,
    summarise,
)
from cellapp.estimation.calibration.records import PairEstimate, PairHeldOut, PairMethodResult
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.results import BEST_METHODS, ErrorSummary, Method
from cellapp.robot.kinematics.chain import Geometry, probe_rotations, smr_positions
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    invert,
    mean_rotation,
    register,
    rotation_from_vector,
    rotation_vectors,
    transform,
    zyx_angles,
)
from cellapp.robot.model import ArmModel, ResidualNetwork

# -- Inter-base transform from distances between the two SMRs alone (Bai et al., ROBOT 45(3) 2023, section 5) ---------
#
# With SMR positions P_L, P_R, each in the base frame of its arm, and measured distances D,
#
#     minimise  sum_i (D_i^2 - |P_R,i - (R P_L,i + b)|^2)^2   over R, b.
#
# Two probes also measure R itself at every stop, as R_i = R_BR,i (R_MR,i^T R_ML,i) R_BL,i^T: computed rotations in the
# bases about the measured one between the probes. Distances and rotation vectors of R_i R^T are then fitted together,
# each weighted by its scatter: of the distances about their own fit, and of R_i about their mean.

PAIR_NAMES = ("x", "y", "z", "theta", "beta", "alpha")
_TOLERANCE = 1e-9
"""Step size at which the iteration ends [m, rad]."""
_MOST_ITERATIONS = 100
_FEWEST_STOPS = 7
"""Least number of stops: six parameters and one degree of freedom for the scatter."""


@dataclass(frozen=True)
class PairIdentification:
    """The identified inter-base transform and its uncertainty.

    Attributes
    ----------
    T_R_L : array, shape (4, 4)
        Maps coordinates of the left base into the right one.
    values : array, shape (6,)
        x, y, z [m] and theta, beta, alpha [rad] of ``trans(x, y, z) rot_z(theta) rot_y(beta) rot_x(alpha)``.
    standard_errors : array, shape (6,)
        Of the translation [m] and of small rotations about z, y, x of the right base [rad], scaled by ``scale``.
    iterations : int
    scale : float
        Standard deviation of a distance [m].
    scale_rad : float or None
        Standard deviation of a component of a relative rotation [rad]; None without rotations.
    """

    T_R_L: Array
    values: Array
    standard_errors: Array
    iterations: int
    scale: float
    scale_rad: float | None = None


def distances(T_R_L: Array, p_L: Array, p_R: Array) -> Array:
    """Compute the distances (n,) [m] between the SMRs at ``p_L`` and ``p_R`` (n, 3), each in its own base frame."""
    return np.asarray(np.linalg.norm(p_R - (p_L @ T_R_L[:3, :3].T + T_R_L[:3, 3]), axis=1))


def identify_pair(
    start: Array, p_L: Array, p_R: Array, measured: Array, R_R_L: Array | None = None
) -> PairIdentification:
    """Identify the inter-base transform.

    Parameters
    ----------
    start : array, shape (4, 4)
        Initial ``T_R_L`` from both bases in the tracker frame, needed because distances alone also fit a mirror image.
    p_L, p_R : array, shape (n, 3)
        SMR positions, each in its own base frame [m].
    measured : array, shape (n,)
        Measured distances [m].
    R_R_L : array, shape (k, 3, 3), optional
        Rotations from the left base to the right one by two probes, see ``relative_rotations``.

    Raises
    ------
    TooFewReadings
        For fewer than seven stops.
    NotConverged
    """
    n = len(measured)
    if n < _FEWEST_STOPS:
        raise TooFewReadings(
            f"{n} common stops are too few for the inter-base transform; measure at least {_FEWEST_STOPS}"
        )

    def linearised(T: Array) -> tuple[Array, Array]:
        """Linearise the squared distances [m^2] in b and in a small rotation that is applied after R."""
        rotated = p_L @ T[:3, :3].T
        d = p_R - rotated - T[:3, 3]
        return measured**2 - np.einsum("na,na->n", d, d), -2.0 * np.hstack([d, np.cross(rotated, d)])

    found = LeastSquares(linearised, after_twist).best(
        "inter-base transform from distances", start, tolerance=_TOLERANCE, max_iterations=_MOST_ITERATIONS
    )
    T_R_L = found.point.state
    off = measured - distances(T_R_L, p_L, p_R)
    scale = float(np.sqrt(off @ off / max(1, n - 6)))
    # All distances have the same variance, but their squares do not: D^2 has the standard deviation 2 D scale.
    J, of_square, scale_rad = found.point.A, 2.0 * measured * scale, None
    gain = inverse_psd(J.T @ J) @ (J * of_square[:, None]).T
    errors = np.linalg.norm(gain, axis=1)
    if R_R_L is not None and scale > 0.0:
        rotations = rotation_vectors(R_R_L @ mean_rotation(R_R_L).T)
        scale_rad = max(float(np.sqrt(np.sum(rotations**2) / (rotations.size - 3))), _TOLERANCE)

        def of_both(T: Array) -> tuple[Array, Array]:
            off, J = linearised(T)
            rotations = rotation_vectors(R_R_L @ T[:3, :3].T).ravel() / scale_rad
            of_rotations = np.tile(np.hstack([np.zeros((3, 3)), np.eye(3)]), (len(R_R_L), 1)) / scale_rad
            return np.concatenate([off / of_square, rotations]), np.vstack([J / of_square[:, None], of_rotations])

        found = LeastSquares(of_both, after_twist).best(
            "inter-base transform from distances and relative rotations",
            T_R_L,
            tolerance=_TOLERANCE,
            max_iterations=_MOST_ITERATIONS,
        )
        T_R_L, J = found.point.state, found.point.A
        errors = np.sqrt(np.diag(inverse_psd(J.T @ J)))
    return PairIdentification(
        T_R_L=T_R_L,
        values=np.concatenate([T_R_L[:3, 3], zyx_angles(T_R_L[:3, :3])]),
        standard_errors=np.concatenate([errors[:3], errors[:2:-1]]),
        iterations=len(found.steps),
        scale=scale,
        scale_rad=scale_rad,
    )


def after_twist(T: Array, step: Array) -> Array:
    """Return T (4, 4) after a shift [m] and a small rotation [rad], applied after T's own, step (6,)."""
    return transform(rotation_from_vector(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])


def relative_rotations(readings: Sequence[Readings], R_B_S: Sequence[Array]) -> Array:
    """Return the rotations (n, 3, 3) from the left base to the right one that both probes measure at n common stops.

    ``R_B_S`` (n, 3, 3) are the computed rotations of each arm's probe in its base frame. NaN where one was not seen.
    """
    R_M_S: list[Array] = []
    for one in readings:
        rows, rotations = measured_orientations(one)
        R_M_S.append(np.full((len(one), 3, 3), np.nan))
        R_M_S[-1][rows] = rotations
    return np.asarray(R_B_S[1] @ R_M_S[1].swapaxes(1, 2) @ R_M_S[0] @ R_B_S[0].swapaxes(1, 2))


@dataclass(frozen=True)
class PairCalibration:
    """Calibration of the pair by method, with the transforms (4, 4) that the profile selects."""

    methods: Mapping[Method, PairMethodResult]
    transforms: Mapping[Method, Array]

    @property
    def T_R_L(self) -> Array:
        """Transform of the best available method, shape (4, 4)."""
        return next(self.transforms[name] for name in BEST_METHODS if name in self.transforms)


def common_stops(first: Readings, second: Readings) -> tuple[Readings, Readings]:
    """Return the readings of two arms at their common stops, in the same order."""
    _, i, k = np.intersect1d(first.configuration, second.configuration, return_indices=True)
    return first.take(i), second.take(k)


def pair_stops(profile: Profile, left: Readings) -> tuple[np.ndarray, np.ndarray]:
    """Sample the rows of the common stops that identify and that validate the pair, by the profile's seed.

    The validation rows come from the arms' validate split, so that no reading is used for both.
    """
    held_out = left.in_split("validate")
    learn = np.setdiff1d(np.arange(len(left)), held_out)
    rng = np.random.default_rng([profile.seed, 0xBA5E])
    learn = np.sort(rng.permutation(learn)[: profile.splits.pair_identify])
    return learn, np.sort(rng.permutation(held_out)[: profile.splits.pair_validate])


def calibrate_pair(
    profile: Profile,
    readings: Mapping[str, Readings],
    arms: Mapping[str, ArmModel],
    in_tracker: Mapping[str, ResidualNetwork | None] = MappingProxyType({}),
) -> tuple[PairCalibration | None, list[str]]:
    """Calibrate the pair by every method that the arms' models allow; return it, None if skipped, and notes.

    ``in_tracker`` are networks trained in the tracker frame.
    """
    if len(readings) != 2:
        return None, [f"pair: skipped, the profile has {len(readings)} arms"] * (len(readings) > 2)
    left, right = common_stops(*readings.values())
    learn, held_out = pair_stops(profile, left)
    if len(learn) < 7 or len(held_out) < 1:
        return None, [
            f"pair: skipped, {len(left)} common stops leave {len(learn)} to identify and {len(held_out)} to"
            " validate; 7 and 1 are needed"
        ]
    notes = []
    if len(learn) < profile.splits.pair_identify or len(held_out) < profile.splits.pair_validate:
        notes.append(
            f"pair: {counted(len(learn), 'stop')} to identify and {len(held_out)} to validate are fewer than the"
            " profile requires"
        )
    both = (left, right)
    probed = [name for name, its in zip(readings, both, strict=True) if len(measured_orientations(its)[0])]
    if len(probed) == 1:
        notes.append(
            f"pair: orientations were measured of arm '{probed[0]}' alone: the pair is calibrated and judged by"
            " distances alone, in mm; put a probe on both flanges for mrad"
        )
    measured = np.linalg.norm(left.p_M - right.p_M, axis=1)
    models = [arms[name] for name in readings]
    start = np.asarray(invert(models[1].geometry.T_M_B()) @ models[0].geometry.T_M_B())
    methods, transforms = dict[Method, PairMethodResult](), dict[Method, Array]()
    for name, poses in _poses(both, models, [in_tracker.get(name) for name in readings]).items():
        positions = [p_B for p_B, _ in poses]
        R_R_L = relative_rotations(both, [R_B_S for _, R_B_S in poses])
        seen = np.isfinite(R_R_L[:, 0, 0])
        known = learn[seen[learn]]
        found = identify_pair(
            start,
            positions[0][learn],
            positions[1][learn],
            measured[learn],
            R_R_L[known] if len(known) >= _FEWEST_STOPS else None,
        )
        T_M = [register(r.p_M[learn], p[learn]) for r, p in zip(both, positions, strict=True)]
        by = {"distances": found.T_R_L, "tracker": np.asarray(invert(T_M[1]) @ T_M[0])}
        p_L, p_R = positions[0][held_out], positions[1][held_out]
        errors = {key: measured[held_out] - distances(T, p_L, p_R) for key, T in by.items()}
        rotations = R_R_L[held_out[seen[held_out]]]
        rotated = {
            key: summarise(np.linalg.norm(rotation_vectors(rotations @ T[:3, :3].T), axis=1))
            for key, T in by.items()
            if len(rotations) and found.scale_rad is not None
        }
        bases = [(model.nominal if name == "nominal" else model.geometry).T_M_B() for model in models]
        stops = PairHeldOut(
            configuration=tuple(left.configuration[held_out].tolist()),
            cooperative_mm=_mm(np.abs(errors[profile.pair.transform])),
            position_mm={
                arm: _mm(position_errors(r.p_M[held_out], apply(T_M_B, p[held_out])))
                for arm, r, T_M_B, p in zip(readings, both, bases, positions, strict=True)
            },
        )
        counts = {"identify": len(learn), "validate": len(held_out)}
        methods[name] = _result(found, by["tracker"], profile.pair.transform, errors, rotated, stops, counts)
        transforms[name] = by[profile.pair.transform]
    return PairCalibration(methods, transforms), notes


def _result(
    found: PairIdentification,
    tracker: Array,
    chosen: str,
    errors: Mapping[str, Array],
    rotated: Mapping[str, ErrorSummary],
    held_out: PairHeldOut,
    counts: Mapping[str, int],
) -> PairMethodResult:
    """Return the result of one method, of which the profile has ``chosen`` a transform; ``errors`` in [m]."""
    by_tracker = [*tracker[:3, 3].tolist(), *zyx_angles(tracker[:3, :3])]
    estimates = zip(PAIR_NAMES, found.values.tolist(), found.standard_errors.tolist(), by_tracker, strict=True)
    summaries = {key: summarise(its) for key, its in errors.items()}
    return PairMethodResult(
        cooperative_mm=summaries[chosen],
        cooperative_mrad=rotated.get(chosen),
        transform=chosen,
        by_transform_mm=summaries,
        by_transform_mrad=rotated or None,
        identified={
            name: PairEstimate(
                value=value, standard_error=error, unit="m" if name in "xyz" else "rad", by_tracker=other
            )
            for name, value, error, other in estimates
        },
        iterations=found.iterations,
        splits=counts,
        held_out=held_out,
    )


def _mm(errors: Array) -> tuple[float, ...]:
    return tuple((errors * 1e3).tolist())


_ArmPoses = tuple[Array, Array]
"""SMR positions (n, 3) [m] and rotations of the probe, without one of the flange, (n, 3, 3) in the base frame."""


def _poses(
    both: tuple[Readings, Readings], arms: list[ArmModel], in_tracker: list[ResidualNetwork | None]
) -> dict[Method, list[_ArmPoses]]:
    """Compute the poses of both arms in their own base frames, by method."""
    conditions = [measurement_conditions(both[k], (arms[1 - k], both[1 - k])) for k in (0, 1)]

    def chain(geometry: Geometry, q: Array) -> _ArmPoses:
        in_base = geometry.with_T_M_B(np.eye(4))
        return smr_positions(in_base, q), probe_rotations(in_base, q)

    def full(k: int) -> _ArmPoses:
        T_B_M = np.asarray(invert(arms[k].geometry.T_M_B()))
        p_M = arms[k].predict(both[k].q, conditions=conditions[k])
        return apply(T_B_M, p_M), T_B_M[:3, :3] @ arms[k].orientation(both[k].q, conditions[k])

    def wrong_frame(k: int) -> _ArmPoses:
        network, (p_B, R_B_S) = in_tracker[k], chain(arms[k].geometry, both[k].q)
        return (p_B if network is None else np.asarray(p_B + network.correct(both[k].q))), R_B_S

    predictors: dict[Method, Callable[[int], _ArmPoses]]
    predictors = {"nominal": lambda k: chain(arms[k].nominal, both[k].q)}
    if any(arm.effects for arm in arms):
        predictors["effects"] = full
    else:
        predictors["method_1"] = lambda k: chain(arms[k].geometry, both[k].q)
        if any(arm.network is not None for arm in arms):
            predictors |= {"method_2": wrong_frame, "proposed": full}
    return {name: [predict(k) for k in (0, 1)] for name, predict in predictors.items()}
