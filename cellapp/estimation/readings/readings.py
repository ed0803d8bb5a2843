"""Measured data: readings of one arm as arrays, and rows that no split may divide. No I/O here.

A held-out row that stands beside a learnt one tests only the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION
from cellapp.ground.counting import counted
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import Array, quaternions_of, twist_columns

FIRST_SAMPLE = 1_000_000_000
"""Configuration numbers from here on belong to samples of recordings: no plan has as many stops."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Readings:
    """The n readings of one arm with N joints.

    An optional quantity is None if no reading has it; if only some have it, the others hold NaN.

    Attributes
    ----------
    configuration : array, shape (n,), int64
        Number of the stop; rows of both arms with the same number were measured at the same stop.
    time_s : array, shape (n,)
        Seconds since the run began; NaN if unknown.
    sequence : array, shape (n,), or None
        Place in the order in which the arm's readings were measured, of an imported file.
    q : array, shape (n, N)
        Joint positions read from the controller [rad].
    q_spread : array, shape (n,), or None
        Largest range of a joint during the measurement [rad].
    approach : array, shape (n, N), int8
        Sign of each joint's last motion before the stop: -1, 0 (unknown), +1.
    p_M : array, shape (n, 3)
        Measured SMR centre in the tracker frame [m].
    payload_kg, temperature_c : array, shape (n,), or None
        Payload [kg]; arm or ambient temperature [degC].
    joint_temperature_c : array, shape (n, N), or None
        Joint temperatures [degC].
    step : array, shape (n, N), or None
        Each joint's last motion before the stop, with its sign [rad].
    dwell_s : array, shape (n,), or None
        Time from standstill to the measurement [s].
    covariance_M : array, shape (n, 3, 3), or None
        Covariance of ``p_M`` [m^2].
    sigma_m : array, shape (n,), or None
        Isotropic standard uncertainty of ``p_M`` [m].
    payload_center_F : array, shape (n, 3), or None
        Centre of mass of the payload in F [m].
    quaternion_M : array, shape (n, 4), or None
        Orientation of the probe's frame S in M, unit quaternion, scalar first; NaN in rows where it was not measured.
    sigma_rad : array, shape (n,), or None
        Standard uncertainty of the orientation about each axis [rad].
    rotation_covariance_M : array, shape (n, 3, 3), or None
        Covariance of a rotation about the axes of M [rad^2]; it takes precedence over ``sigma_rad``.
    smr : tuple of n (str or None), or None
        Names of the SMRs on the flange that were measured.
    station : tuple of n (str or None), or None
        Names of the tracker stations, in whose frames the measurements are.
    point : tuple of n str, or None
        Names of the sockets that a ball rested in, in place of ``p_M``, which is NaN; only earlier versions stored such
        readings, and nothing is estimated from them.
    other_q : array, shape (n, K), or None
        Joint positions of the other arm if that has no reading of its own at the stop, as in samples of recordings
        [rad]; NaN if unknown. Not a column: it comes from recordings.
    split : tuple of n (str or None), or None
        identify, train or validate.
    extras : dict
        Unknown columns of an imported file: name -> n texts, in the file's order.
    """

    configuration: NDArray[np.int64]
    time_s: Array
    q: Array
    approach: NDArray[np.int8]
    p_M: Array
    sequence: Array | None = None
    payload_kg: Array | None = None
    temperature_c: Array | None = None
    joint_temperature_c: Array | None = None
    step: Array | None = None
    dwell_s: Array | None = None
    covariance_M: Array | None = None
    sigma_m: Array | None = None
    payload_center_F: Array | None = None
    quaternion_M: Array | None = None
    sigma_rad: Array | None = None
    rotation_covariance_M: Array | None = None
    smr: tuple[str | None, ...] | None = None
    station: tuple[str | None, ...] | None = None
    point: tuple[str | None, ...] | None = None
    other_q: Array | None = None
    split: tuple[str | None, ...] | None = None
    q_spread: Array | None = None
    extras: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, joints = len(self.configuration), self.q.shape[-1] if self.q.ndim else 0
        for column in COLUMNS:
            value = getattr(self, column.name)
            if value is None:
                continue
            expected = column.array_shape(n, joints)
            shape = (len(value),) if column.dtype is str else value.shape
            if shape != expected:
                raise ValueError(f"expected {column.name} of shape {expected}, got {shape}")
        for name, texts in self.extras.items():
            if len(texts) != n:
                raise ValueError(f"expected {n} texts in the extra column '{name}', got {len(texts)}")

    @classmethod
    def one(cls, **values: Any) -> Readings:
        """Return one reading, at stop 0, from values of columns without the axis n; those not given are unknown.

        Raises
        ------
        ValueError
            If an array has the wrong shape.
        """
        joints = len(values["q"])
        for column in COLUMNS:
            value = values.get(column.name, 0 if column is CONFIGURATION else None)
            if value is None:
                values[column.name] = column.missing(1, joints)
            else:
                values[column.name] = (value,) if column.dtype is str else np.asarray(value, dtype=column.dtype)[None]
        return cls(**values)

    def at_stop(self, stop: int) -> Readings:
        """Return the readings at one stop."""
        return replace(self, configuration=np.full(len(self), stop, dtype=CONFIGURATION.dtype))

    def __len__(self) -> int:
        return len(self.configuration)

    def __repr__(self) -> str:
        return f"Readings({len(self)} of {self.joints} joints)"

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])

    def take(self, indices: Sequence[int] | NDArray[np.integer] | NDArray[np.bool_]) -> Readings:
        """Return the rows at ``indices`` (integers, or a mask of n booleans), in that order."""
        chosen = np.arange(len(self))[np.asarray(indices, dtype=None if len(indices) else np.intp)]

        def taken(column: Any) -> Any:
            return column[chosen] if isinstance(column, np.ndarray) else tuple(column[row] for row in chosen)

        extras = {name: taken(texts) for name, texts in self.extras.items()}
        columns = {name: taken(its) for name, its in vars(self).items() if isinstance(its, np.ndarray | tuple)}
        return replace(self, **columns, extras=extras)

    def in_split(self, *names: str) -> NDArray[np.intp]:
        """Return the indices of the rows of some splits, one split after the other; empty if none are assigned."""
        split = self.split or ()
        return np.array([index for name in names for index, word in enumerate(split) if word == name], dtype=np.intp)


def joined(parts: Sequence[Readings]) -> Readings:
    """Concatenate readings of one arm, without unknown columns of imported files.

    Raises
    ------
    ValueError
        If they have different numbers of joints.
    """
    values: dict[str, Any] = {}
    for column in COLUMNS:
        own = [getattr(part, column.name) for part in parts]
        if column.dtype is not str:
            values[column.name] = _stacked(own, [column.array_shape(len(part), part.joints) for part in parts])
        elif any(words is not None for words in own):
            values[column.name] = tuple(
                word
                for part, words in zip(parts, own, strict=True)
                for word in ((None,) * len(part) if words is None else words)
            )
    beside = [part.other_q for part in parts]
    others = max((0 if q is None else q.shape[1] for q in beside), default=0)
    return Readings(**values, other_q=_stacked(beside, [(len(part), others) for part in parts]))


_FEWEST, _OTHER_JOINTS = 6, 0.01
"""Least number of rows; difference of a joint [rad, deg] that moves the point. It may lie on the axis of the last."""


def _stacked(arrays: Sequence[NDArray[Any] | None], shapes: Sequence[tuple[int, ...]]) -> NDArray[Any] | None:
    """Concatenate arrays, with NaN in place of missing ones; None if all are missing."""
    if all(array is None for array in arrays):
        return None
    return np.concatenate(
        [np.full(shape, np.nan) if array is None else array for array, shape in zip(arrays, shapes, strict=True)]
    )


def stated_uncertainty(readings: Readings) -> Array | None:
    """Return the uncertainty that the readings state for their points, if all of them do.

    Return covariances (n, 3, 3) [m^2] if every reading has one, else standard uncertainties (n,) [m], else None.
    """
    for stated in (readings.covariance_M, readings.sigma_m):
        if stated is not None and not np.isnan(stated).any():
            return stated
    return None


def covariances_of(sigma: Array) -> Array:
    """Return covariances (n, 3, 3) [m^2]: ``sigma`` itself, or of standard uncertainties (n,) [m]."""
    return sigma if sigma.ndim == 3 else sigma[:, None, None] ** 2 * np.eye(3)


def coordinate_uncertainty(readings: Readings) -> Array | None:
    """Return the standard uncertainty (n,) [m] of a coordinate by ``stated_uncertainty``; rms of a covariance's three.

    None where that is None.
    """
    stated = stated_uncertainty(readings)
    if stated is None or stated.ndim == 1:
        return stated
    return np.asarray(np.sqrt(np.trace(stated, axis1=1, axis2=2) / 3.0))


# -- Several SMRs on a flange, measured one after another at a stop: of three or more one position and one rotation ---
#
# At a stop p_k = p + R s_k, with the places s of the SMRs in a rigid figure. It is found from all stops: laid onto
# each and averaged in turn, without stops that it does not fit (generalised Procrustes analysis; Gower, Psychometrika
# 40 (1975) 33). Position p of the first SMR and rotation R then follow by weighted least squares, with full
# covariances: a rotation is several times less certain about the beam than across it. The correlation of p and R is
# neglected.

SAME_STOP_RAD = 1e-3
"""Largest difference of joint positions within one stop: encoders read 0.04 mrad more or less."""
_ROUNDS = 200
"""Most rounds of registration and averaging; few are enough, as the first figure is within the noise already."""
_SETTLED_M = 1e-8
"""Motion of an SMR in the last round [m]."""
_FLAT = 1e-3
"""Ratio of the figure's width to its length below which the SMRs are on one line."""
_EXCHANGED = 0.05
"""Misfit, as a share of the figure, from which SMRs are exchanged; below it one of them was disturbed."""
_OUTLYING, _LEAST_M = 8.0, 1e-6
"""Multiple of the median misfit, which counts at least as 1 µm, above which the figure does not fit a stop."""
_USUAL_NOISE_M = 1e-5
"""Noise of a coordinate where neither the readings state one nor the figure shows it."""


def lost_points(q: Array, p_M: Array) -> dict[int, str]:
    """Return row -> what it holds, of rows without a point: trackers write zeros, or an earlier point, for a lost beam.

    Fewer than ``_FEWEST`` rows do not show it, and units do not matter: ``q`` (n, N), ``p_M`` (n, 3).
    """
    lost, first = dict[int, str](), dict[tuple[float, ...], int]()
    for row, point in enumerate(map(tuple, p_M.tolist() if len(q) >= _FEWEST else [])):
        before = first.setdefault(point, row)
        if not any(point):
            lost[row] = "0, 0, 0"
        elif np.abs(q[row, :-1] - q[before, :-1]).max(initial=0.0) > _OTHER_JOINTS:
            lost[row] = f"{', '.join(f'{one:.10g}' for one in point)} again, at other joints than row {before + 1}"
    return lost


def smr_names(readings: Readings) -> tuple[str, ...]:
    """Return the names of the SMRs that were measured, in the order of the rows; empty for one without a name."""
    return tuple(dict.fromkeys(word or "" for word in readings.smr or ()))


def one_pose_a_stop(readings: Readings) -> tuple[Readings, str, list[tuple[int, str, str]]]:
    """Make of the SMRs at each stop one reading: the first one's position, and the rotation of a frame S of all.

    S has its origin at the first SMR; x points to the second, y to the side of the one furthest from that line. A stop
    with fewer than three SMRs has no rotation; without the first one it is left out.

    Parameters
    ----------
    readings : Readings
        Rows of three SMRs or more, of one arm.

    Returns
    -------
    readings : Readings
        One row a stop, in the order of the stops.
    sentence : str
        What was made.
    faults : list of row, column and text
        Contradictions; the readings are not to be used if there are any.
    """
    names = smr_names(readings)
    stops, group = np.unique(readings.configuration, return_inverse=True)
    row = np.full((len(stops), len(names)), -1, dtype=np.intp)
    row[group, [names.index(word or "") for word in readings.smr or ()]] = np.arange(len(readings))
    seen = row >= 0
    first = np.where(seen, row, len(readings)).min(axis=1)
    faults = list(_not_one_stop(readings, first[group]))
    p_M = np.where(seen[:, :, None], readings.p_M[row], np.nan)
    angular = seen.sum(axis=1) >= 3
    points_S = _figure(p_M[angular])
    if points_S is None:
        words = f"no stop has all of {', '.join(names)}, or they stand on one line: no rotation follows"
        return readings, "", [*faults, (0, "smr", words)]
    misfit = np.full(len(stops), np.nan)
    misfit[angular] = _misfit(points_S, p_M[angular])
    outlying, exchanged = _outlying(misfit), _EXCHANGED * float(np.abs(points_S).max())
    faults += [
        (
            int(first[stop]),
            "smr",
            f"the SMRs are off their places at other stops by {misfit[stop] * 1e3:.2f} mm: exchanged?",
        )
        for stop in np.flatnonzero(outlying & (misfit > exchanged)).tolist()
    ]
    one = _means(readings, row, np.where(seen[:, 0], row[:, 0], first))
    one, sigma_rad = _with_poses(one, readings, points_S, row, p_M, angular)
    kept = (angular | seen[:, 0]) & ~outlying
    sentence = f"one position (that of SMR {names[0]}) and one rotation of SMRs {', '.join(names)}"
    sentence += f" at {np.count_nonzero(angular)} of {len(stops)} stops, to {1e3 * sigma_rad:.3f} mrad about the axis"
    sentence += f" known least; {counted(int(np.count_nonzero(~kept)), 'stop')} left out"
    if outlying.any():
        off = ", ".join(f"{stops[stop]} ({misfit[stop] * 1e3:.3f} mm)" for stop in np.flatnonzero(outlying).tolist())
        sentence += f", of these for SMRs off their places at other stops, as if one was disturbed: {off}"
    return one.take(np.flatnonzero(kept)), sentence, faults


def _not_one_stop(rows: Readings, first: NDArray[np.intp]) -> Iterator[tuple[int, str, str]]:
    """Yield rows whose joints or split differ from those of the ``first`` (n,) row of their stop, one of each kind."""
    apart = np.abs(rows.q - rows.q[first])
    for row in np.flatnonzero(apart.max(axis=1) > SAME_STOP_RAD)[:1].tolist():
        joint = int(np.argmax(apart[row]))
        text = f"{apart[row, joint]:.4f} rad from another row of the stop; the arm must rest until all are measured"
        yield row, f"q{joint + 1}", text
    if rows.split is not None:
        for row in [row for row, word in enumerate(rows.split) if word != rows.split[first[row]]][:1]:
            yield row, "split", f"{rows.split[row]}, but {rows.split[first[row]]} in another row of the same stop"


def _figure(p_M: Array) -> Array | None:
    """Return the figure (K, 3) of SMRs at stops (S, K, 3), NaN where not measured; None if it gives no rotation.

    Raise ``NotConverged`` if it does not settle.
    """
    complete = p_M[np.isfinite(p_M).all(axis=(1, 2))]
    if not len(complete):
        return None
    apart = np.linalg.norm(complete[:, :, None] - complete[:, None], axis=3)
    usual = np.abs(apart - np.median(apart, axis=0)).max(axis=(1, 2))
    points = complete[np.argmin(usual)] - complete[np.argmin(usual), 0]
    for _ in range(_ROUNDS):
        rotation, origin = _laid_on(points, p_M)
        in_S = np.einsum("sba,skb->ska", rotation, p_M - origin[:, None])
        before, points = points, np.nanmean(in_S[~_outlying(_rms(in_S - points))], axis=0)
        if np.abs(points - before).max() < _SETTLED_M:
            break
    else:
        raise NotConverged.of("fit of the SMRs on a flange", f"{_ROUNDS} rounds were not enough")
    points = points - points[0]
    length = float(np.linalg.norm(points[1]))
    x = points[1] / length
    aside = points - (points @ x)[:, None] * x
    widths = np.linalg.norm(aside, axis=1)
    if widths.max() < _FLAT * length:
        return None
    y = aside[np.argmax(widths)] / widths.max()
    return np.asarray(points @ np.stack([x, y, np.cross(x, y)], axis=1))


def _laid_on(points_S: Array, p_M: Array) -> tuple[Array, Array]:
    """Register a figure (K, 3) to points (S, K, 3), NaN where not measured; return rotations (S, 3, 3), origins (S, 3).

    Source: Kabsch, Acta Cryst. A32 (1976) 922, for all stops at once; without reflections.
    """
    seen = np.isfinite(p_M[:, :, :1])
    count = np.maximum(seen.sum(axis=1), 1)
    p = np.where(seen, p_M, 0.0)
    mean_M, mean_S = p.sum(axis=1) / count, (seen * points_S).sum(axis=1) / count
    cross = np.einsum("ska,skb->sab", p - seen * mean_M[:, None], seen * (points_S - mean_S[:, None]))
    u, _, vt = np.linalg.svd(cross)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    return rotation, mean_M - np.einsum("sab,sb->sa", rotation, mean_S)


def _misfit(points_S: Array, p_M: Array) -> Array:
    """Return the rms distance (S,) of measured points (S, K, 3) from the figure."""
    rotation, origin = _laid_on(points_S, p_M)
    return _rms(p_M - origin[:, None] - np.einsum("sab,kb->ska", rotation, points_S))


def _rms(vectors: Array) -> Array:
    """Return the rms length (S,) of those vectors (S, K, 3) that are not NaN."""
    return np.asarray(np.sqrt(np.nanmean(np.sum(vectors**2, axis=2), axis=1)))


def _outlying(misfit: Array) -> NDArray[np.bool_]:
    """Return a mask (S,) of the stops that the figure does not fit; False for NaN."""
    return np.asarray(misfit > _OUTLYING * max(float(np.nanmedian(misfit)), _LEAST_M))


def _means(readings: Readings, row: NDArray[np.intp], first: Sequence[int] | NDArray[np.intp]) -> Readings:
    """Return the rows ``first`` (S,); joint positions, times and dwell are means over the rows (S, K) of each stop."""
    seen, means = row >= 0, dict[str, Any]()
    for name in ("q", "time_s", "dwell_s", "sequence"):
        if (values := getattr(readings, name)) is not None:
            more = (1,) * (values.ndim - 1)
            total = np.where(seen.reshape(*seen.shape, *more), values[row], 0.0).sum(axis=1)
            means[name] = total / seen.sum(axis=1).reshape(-1, *more)
    return replace(readings.take(first), smr=None, **means)


def _with_poses(
    one: Readings, rows: Readings, points_S: Array, row: NDArray[np.intp], p_M: Array, angular: NDArray[np.bool_]
) -> tuple[Readings, float]:
    """Set position, rotation and covariances in the readings (S,) in the mask ``angular`` (S,); also return the rms
    standard deviation [rad] of the rotations about the axes known least."""
    covariances, of_points = _covariances(rows), dict[str, Any]()
    if covariances is None:
        counts = np.isfinite(p_M[angular, :, 0]).sum(axis=1)
        square = float(np.sum(_misfit(points_S, p_M[angular]) ** 2 * counts))
        free = 3 * int(counts.sum()) - 6 * len(counts) - 3 * len(points_S) + 6
        noise_m = max(np.sqrt(square / free), _LEAST_M) if free > 0 else _USUAL_NOISE_M
        covariances = np.tile(noise_m**2 * np.eye(3), (len(rows), 1, 1))
    elif (own := _covariances(one)) is not None:
        of_points = {"sigma_m": None, "covariance_M": own}
    information = np.where((row >= 0)[:, :, None, None], np.linalg.inv(covariances)[row], 0.0)[angular]
    rotation, origin = _laid_on(points_S, p_M[angular])
    arms = np.einsum("sab,kb->ska", rotation, points_S)
    J, off = twist_columns(arms), np.nan_to_num(p_M[angular] - origin[:, None] - arms)
    unit = np.array([1.0, 1.0, 1.0, *(1.0 / np.abs(points_S).max(),) * 3])
    weighed = np.einsum("skab,skbi->skai", information, J)
    covariance = np.linalg.inv(np.einsum("skai,skaj->sij", J, weighed) * unit * unit[:, None]) * unit * unit[:, None]
    step = np.einsum("sij,skaj,ska->si", covariance, weighed, off)
    rotation = scipy.spatial.transform.Rotation.from_rotvec(step[:, 3:]).as_matrix() @ rotation
    places, quaternion, of_rotation = one.p_M.copy(), np.full((len(one), 4), np.nan), np.full((len(one), 3, 3), np.nan)
    places[angular], quaternion[angular] = origin + step[:, :3], quaternions_of(rotation)
    of_rotation[angular] = covariance[:, 3:, 3:]
    if of_points:
        of_points["covariance_M"][angular] = covariance[:, :3, :3]
    least = np.linalg.eigvalsh(covariance[:, 3:, 3:])[:, -1]
    posed = replace(one, p_M=places, quaternion_M=quaternion, rotation_covariance_M=of_rotation, **of_points)
    return posed, float(np.sqrt(least.mean()))


def _covariances(readings: Readings) -> Array | None:
    """Return a copy of the stated covariances (n, 3, 3) [m^2] of all readings; None if one has none."""
    stated = stated_uncertainty(readings)
    return None if stated is None else covariances_of(stated).copy()


# -- Rows that no split may divide ------------------------------------------------------------------------------------


SAME_RAD = 1e-3
"""Largest difference of joint positions within one configuration: encoders read 0.04 mrad more or less."""
NEIGHBOUR_RAD = 0.05
"""Largest difference of joint positions of neighbours: 3 degrees, far within the period of most errors of an arm. Rows
of a plan, or sampled at random, lie some 0.4 rad apart."""
_WIDE = 4.0
"""Radius of a neighbourhood, in distances of neighbours: most of its rows then have no neighbour outside it."""
_FEWEST_ALIKE = 10
"""Least number of neighbourhoods; they are smaller if the rows would give fewer."""
_NEAR = f"{np.degrees(NEIGHBOUR_RAD):.0f} degrees"
_MANY = 0.1
"""Share of held-out rows with a learnt neighbour from which a note says so."""

Groups = NDArray[np.intp]
"""Number of the group of each row (n,), counted in the order of the groups' first rows."""


def repeats(q: Array, within: float = SAME_RAD) -> Groups:
    """Group rows of joint positions (n, N) [rad] that agree with the first row of their group."""
    tree, group, count = scipy.spatial.KDTree(q), np.full(len(q), -1, dtype=np.intp), 0
    alone = tree.query(q, k=[2], p=np.inf)[0][:, 0] > within
    for row in range(len(q)):
        if group[row] < 0:
            if not alone[row]:
                near = np.array(tree.query_ball_point(q[row], within, p=np.inf), dtype=np.intp)
                group[near[group[near] < 0]] = count
            group[row] = count
            count += 1
    return group


def undivided(q: Array) -> Groups:
    """Group rows (n, N) [rad] for splits and folds: by configuration, or by neighbourhood if most have a neighbour."""
    group = repeats(q)
    single = q[np.unique(group, return_index=True)[1]]
    if not len(single) or np.mean(has_neighbour(single, single, itself=True)) <= 0.5:
        return group
    radius = _WIDE * NEIGHBOUR_RAD
    while (wide := repeats(q, radius)).max() + 1 < _FEWEST_ALIKE and radius > NEIGHBOUR_RAD:
        radius /= 2.0
    return wide


def has_neighbour(q: Array, learnt: Array, *, itself: bool = False) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows with a neighbour among ``learnt`` rows (m, N); ``itself``: these are the same."""
    count = 2 if itself else 1
    if len(learnt) < count:
        return np.zeros(len(q), dtype=np.bool_)
    distance, _ = scipy.spatial.KDTree(learnt).query(q, k=[count], p=np.inf)
    return np.asarray(distance[:, 0] <= NEIGHBOUR_RAD)


def folds_of(group: Groups, folds: int, generator: np.random.Generator) -> NDArray[np.int64]:
    """Sample a fold for each row (n,), the same for the rows of a group."""
    return np.asarray((generator.permutation(int(group.max()) + 1) % folds)[group], dtype=np.int64)


def first_stops(readings: Mapping[str, Readings]) -> tuple[dict[int, int], tuple[str, ...]]:
    """Return stop -> first stop of its group, by the joint positions of all arms; and a note on neighbourhoods."""
    numbers = np.unique(np.concatenate([its.configuration for its in readings.values()]))
    ends = np.cumsum([its.joints for its in readings.values()])
    q = np.zeros((len(numbers), ends[-1]))
    for end, its in zip(ends, readings.values(), strict=True):
        q[np.searchsorted(numbers, its.configuration), end - its.joints : end] = its.q
    group, count = undivided(q), int(repeats(q).max()) + 1
    first = numbers[np.unique(group, return_index=True)[1]][group]
    sampled = int(group.max()) + 1
    note = (
        f"most of the {counted(count, 'configuration')} have a neighbour within {_NEAR} in every joint, as along a line"
        f" or on a grid: rows were held out by whole neighbourhoods, of which there are {sampled}"
    )
    return dict(zip(numbers.tolist(), first.tolist(), strict=True)), (note,) if sampled < count else ()


def one_a_stop(readings: Readings) -> Readings:
    """Return the readings with one row for rows that repeat the one before them while the arm rests.

    It has their mean point and the other values of the first: a model that is wrong there is so once, not many times.
    """
    known = readings.time_s if readings.sequence is None else readings.sequence
    its = readings.take(np.argsort(known if np.isfinite(known).all() else readings.configuration, kind="stable"))
    group, others = repeats(its.q), its.approach[1:]
    moved = (others != 0) & (others != its.approach[:-1])
    if its.step is not None:
        moved = np.where(np.isfinite(its.step[1:]), np.abs(its.step[1:]) > SAME_RAD, moved)
    rests = (group[1:] == group[:-1]) & ~moved.any(axis=1)
    for words in (its.smr, its.station):
        rests &= words is None or np.array([one == other for one, other in pairwise(words)], dtype=np.bool_)
    if its.payload_kg is not None:
        rests &= ~(np.abs(np.diff(its.payload_kg)) > 0.0)
    if not rests.any():
        return readings
    first = np.concatenate([[True], ~rests])
    stop = np.cumsum(first) - 1
    mean = np.stack([np.bincount(stop, column) for column in its.p_M.T], axis=1) / np.bincount(stop)[:, None]
    return replace(its.take(first), p_M=mean)


def neighbours_words(readings: Readings) -> str:
    """Say how many held-out rows have a learnt neighbour, or repeat a learnt row; empty for few."""
    held_out = readings.q[readings.in_split("validate")]
    learnt = readings.q[readings.in_split("identify", "train")]
    count = int(np.count_nonzero(has_neighbour(held_out, learnt)))
    if not count or count < _MANY * len(held_out):
        return ""
    return (
        f"{count} of {counted(len(held_out), 'held-out row')} stand within {_NEAR}, in every joint, of a row that was"
        " learnt from: held-out errors there say little about other poses; measure held-out rows away from the others"
    )
