"""Formulas of ISO 9283:1998 for positions, their counterparts for two arms, and the test cube.

Attained positions are arrays (..., n, 3) [m]: n cycles on the last axis but one. Every function is vectorised over the
leading axes, so that the same formula serves measured and simulated cycles. The standard's characteristics of
orientation need three points on the flange; one SMR gives none of them.

Corners C1 to C4 go round the upper face, C5 to C8 are below them. Each of the standard's four planes holds one edge of
the upper face and the opposite one of the lower face. P1 is the centre; P2 to P5 are on the diagonals of the plane,
10 % of their length from the corners. All poses have the same orientation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from cellapp.estimation.iso9283.records import IsoValue
from cellapp.robot.kinematics.transforms import Array

FEWEST_CYCLES = 2
"""Least number of cycles: a standard deviation needs two values."""
_PROBABILITY = 0.97725
"""One-sided probability of an expanded uncertainty with the coverage factor 2."""


def coverage_of_mean(n: int) -> float:
    """Compute the ratio of a mean's expanded uncertainty to its n values' standard deviation: Student's t / sqrt(n)."""
    return float(stdtrit(n - 1, _PROBABILITY)) / math.sqrt(n)


def accuracy_vector(attained: Array, commanded: Array) -> Array:
    """Compute mean attained minus commanded position (..., 3): AP_x, AP_y, AP_z (7.2.1)."""
    return np.asarray(attained.mean(axis=-2) - commanded)


def pose_accuracy(attained: Array, commanded: Array) -> Array:
    """Compute AP (7.2.1), shape (...): distance of the mean attained position from the commanded one (..., 3)."""
    return np.asarray(np.linalg.norm(accuracy_vector(attained, commanded), axis=-1))


def pose_repeatability(attained: Array) -> Array:
    """Compute RP (7.2.2), shape (...): ``mean(l) + 3 S_l`` of the distances l of attained positions from their mean.

    Raise ``ValueError`` for fewer than two cycles.
    """
    centre = attained.mean(axis=-2, keepdims=True)
    lengths = np.linalg.norm(attained - centre, axis=-1)
    _require_cycles(lengths)
    return np.asarray(lengths.mean(axis=-1) + 3.0 * lengths.std(axis=-1, ddof=1))


def directional_variation(attained: Array) -> Array:
    """Compute vAP (7.2.3), shape (...): largest distance between mean positions of k directions (..., k, n, 3)."""
    means = attained.mean(axis=-2)
    return np.asarray(np.linalg.norm(means[..., :, None, :] - means[..., None, :, :], axis=-1).max(axis=(-2, -1)))


def distances(first: Array, second: Array) -> Array:
    """Compute the distance (..., n) between two attained positions of each cycle."""
    return np.asarray(np.linalg.norm(second - first, axis=-1))


def distance_accuracy(first: Array, second: Array, commanded: Array | float) -> Array:
    """Compute AD (7.3.2), shape (...): mean attained distance minus the commanded one."""
    return np.asarray(distances(first, second).mean(axis=-1) - commanded)


def distance_repeatability(first: Array, second: Array) -> Array:
    """Compute RD (7.3.3), shape (...): three standard deviations of the attained distance.

    Raise ``ValueError`` for fewer than two cycles.
    """
    found = distances(first, second)
    _require_cycles(found)
    return np.asarray(3.0 * found.std(axis=-1, ddof=1))


def drift(values: Array) -> Array:
    """Compute dAP or dRP (7.6), shape (...): largest change of AP or RP of k groups (..., k) from the first one."""
    return np.asarray(np.abs(values - values[..., :1]).max(axis=-1))


def path_accuracy(attained: Array, commanded: Array) -> Array:
    """Compute AT (8.2), shape (...): largest distance, over m points, of the mean path from ``commanded`` (m, 3), with
    ``attained`` (..., m, n, 3)."""
    return np.asarray(pose_accuracy(attained, commanded).max(axis=-1))


def path_repeatability(attained: Array) -> Array:
    """Compute RT (8.3), shape (...): largest ``mean(l) + 3 S_l`` over m points (..., m, n, 3)."""
    return np.asarray(pose_repeatability(attained).max(axis=-1))


def plane_crossings(points: Array, commanded: Array, tangents: Array, within_m: float) -> Array:
    """Compute where an attained path crosses the planes normal to the commanded one, (m, c); NaN where it does not.

    Parameters
    ----------
    points : array, shape (k, c)
        Attained path in order: position [m], straight between the points, and other values that change along it, such
        as time.
    commanded, tangents : arrays, shape (m, 3)
        Points on the commanded path [m], and its unit tangents there: normals of the planes.
    within_m : float
        Largest distance of a crossing from its point [m]; farther ones belong to another part of the path, as on a
        closed curve.
    """
    found = np.full((len(commanded), points.shape[1]), np.nan)
    heights = np.einsum("kma,ma->km", points[:, None, :3] - commanded, tangents)
    for m in range(len(commanded)):
        k = np.flatnonzero((heights[:-1, m] <= 0.0) & (heights[1:, m] > 0.0))
        share = heights[k, m] / (heights[k, m] - heights[k + 1, m])
        crossing = points[k] + share[:, None] * (points[k + 1] - points[k])
        off = np.linalg.norm(crossing[:, :3] - commanded[m], axis=1)
        if len(k) and off.min() <= within_m:
            found[m] = crossing[np.argmin(off)]
    return found


def speeds(times: Array, s: Array) -> Array:
    """Compute speeds (n, m - 1) [m/s] between points at arc lengths ``s`` (m,) [m] passed at ``times`` (n, m) [s]."""
    return np.asarray(np.diff(s) / np.diff(times, axis=-1))


def velocity_accuracy(found: Array, commanded: float) -> float:
    """Compute AV (8.6.2) [1]: mean of the speeds (n, k) [m/s] minus the commanded speed, as a share of it.

    The standard's text was not at hand; the formulas of velocities are those commonly given.
    """
    return float(found.mean(axis=-1).mean() / commanded - 1.0)


def velocity_repeatability(found: Array, commanded: float) -> float:
    """Compute RV (8.6.3) [1]: three standard deviations of the cycles' mean speeds, as a share of ``commanded``.

    The speeds ``found`` are (n, k) [m/s]. Raise ``ValueError`` for fewer than two cycles.
    """
    means = found.mean(axis=-1)
    _require_cycles(means)
    return float(3.0 * means.std(ddof=1) / commanded)


def velocity_fluctuation(found: Array) -> float:
    """Compute FV (8.6.4) [m/s]: the largest difference of two speeds (n, k) [m/s] within a cycle, over all cycles."""
    return float(np.ptp(found, axis=-1).max())


def _require_cycles(values: Array) -> None:
    if values.shape[-1] < FEWEST_CYCLES:
        raise ValueError(f"a repeatability needs at least {FEWEST_CYCLES} cycles, not {values.shape[-1]}")


# -- Characteristics with their expanded uncertainties, by Monte Carlo simulation (JCGM 101:2008) ---------------------
#
# Cycles are sampled from the mean and the covariance of the measured ones. Each sample is widened for the uncertainty
# of a scatter from n cycles (t distribution of n - 1 degrees of freedom, JCGM 101:2008, 6.4.9), and the formula of the
# characteristic is applied to it. Errors of the tracker and of the base frame are sampled once for all cycles of a
# position: the tracker's stated covariance does not say which part of it scatters from cycle to cycle, so all of it
# counts as common. A repeatability may also contain it: its uncertainty includes the change from removing that
# scatter. The expanded uncertainty is the half-width about the median that holds 95.45 % of the samples: for a normal
# distribution this is the coverage factor 2.

_COVERAGE = 0.9545
_SAMPLES = 1000
"""Number of samples: they give a standard deviation to 2 %."""
_PATH_SAMPLES = 200
"""Number of samples for a path, which has hundreds of times as many coordinates; its uncertainty is known to 5 %."""


@dataclass(frozen=True, eq=False)
class Cycles:
    """One position that was attained n times.

    Attributes
    ----------
    attained : array, shape (n, 3)
        Measured positions [m].
    commanded : array, shape (3,)
        Commanded position [m].
    tracker : array, shape (3, 3)
        Covariance of one measured position as the tracker states it [m^2].
    frame : array, shape (3, 3)
        Covariance of the commanded position if base and SMR were found by measuring [m^2]; else zero.
    """

    attained: Array
    commanded: Array
    tracker: Array
    frame: Array

    @property
    def n(self) -> int:
        """Number of cycles."""
        return len(self.attained)

    @property
    def scatter(self) -> Array:
        """Covariance (3, 3) of the attained positions [m^2]."""
        return np.atleast_2d(np.cov(self.attained, rowvar=False))

    def samples(self, rng: np.random.Generator) -> Array:
        """Sample simulated cycles (D, n, 3) [m], without errors that all cycles share."""
        noise = rng.multivariate_normal(np.zeros(3), self.scatter, size=(_SAMPLES, self.n), method="eigh")
        return np.asarray(self.attained.mean(axis=0) + _widened(rng, self.n, (_SAMPLES, 1, 1)) * noise)

    def common(self, rng: np.random.Generator) -> Array:
        """Sample simulated errors (D, 1, 3) [m] that all cycles share."""
        sampled = rng.multivariate_normal(np.zeros(3), self.tracker + self.frame, size=_SAMPLES, method="eigh")
        return np.asarray(sampled[:, None])


def accuracy_value(cycles: Cycles, rng: np.random.Generator) -> IsoValue:
    """Compute AP of one pose."""
    sampled = pose_accuracy(cycles.samples(rng) + cycles.common(rng), cycles.commanded)
    return _value(float(pose_accuracy(cycles.attained, cycles.commanded)), _expanded(sampled), cycles.n)


def repeatability_value(cycles: Cycles, rng: np.random.Generator) -> tuple[IsoValue, float]:
    """Compute RP of one pose, and the RP [m] that the tracker's stated uncertainty alone would show."""
    value = float(pose_repeatability(cycles.attained))
    sampling = _expanded(pose_repeatability(cycles.samples(rng)))
    alone = rng.multivariate_normal(np.zeros(3), cycles.tracker, size=(_SAMPLES, cycles.n), method="eigh")
    tracker = float(pose_repeatability(alone).mean())
    return _value(value, _with_tracker(value, sampling, tracker), cycles.n), tracker


def directional_value(directions: Sequence[Cycles], rng: np.random.Generator) -> IsoValue:
    """Compute vAP of one pose from its directions of approach; the tracker's error is the same for all of them."""
    sampled = np.stack([one.samples(rng).mean(axis=1, keepdims=True) for one in directions], axis=1)
    means = np.stack([one.attained.mean(axis=0, keepdims=True) for one in directions])
    return _value(float(directional_variation(means)), _expanded(directional_variation(sampled)), _fewest(directions))


def distance_values(first: Cycles, second: Cycles, rng: np.random.Generator) -> tuple[IsoValue, IsoValue]:
    """Compute AD and RD of two positions that were attained in the same cycles."""
    wanted = float(np.linalg.norm(second.commanded - first.commanded))
    sampled = [one.samples(rng) for one in (first, second)]
    shared = [one.common(rng) for one in (first, second)]
    found = distances(first.attained, second.attained)
    accuracy = float(distance_accuracy(first.attained, second.attained, wanted))
    off = _expanded(distance_accuracy(sampled[0] + shared[0], sampled[1] + shared[1], wanted))
    repeatability = float(distance_repeatability(first.attained, second.attained))
    along = second.attained.mean(axis=0) - first.attained.mean(axis=0)
    along = along / max(float(np.linalg.norm(along)), 1e-12)
    tracker = 3.0 * float(np.sqrt(along @ (first.tracker + second.tracker) @ along))
    again = found.std(ddof=1) * _widened(rng, len(found), (_SAMPLES, 1)) * rng.standard_normal((_SAMPLES, len(found)))
    sampling = _expanded(3.0 * again.std(axis=1, ddof=1))
    return (
        _value(accuracy, off, first.n),
        _value(repeatability, _with_tracker(repeatability, sampling, tracker), first.n),
    )


def drift_values(groups: Sequence[Cycles], rng: np.random.Generator) -> tuple[IsoValue, IsoValue]:
    """Compute dAP and dRP of groups of cycles in order of time; the tracker's error is the same in all of them."""
    sampled = [one.samples(rng) for one in groups]
    shared = groups[0].common(rng)
    accuracy = partial(pose_accuracy, commanded=groups[0].commanded)
    values = []
    for formula, offset in ((accuracy, shared), (pose_repeatability, np.zeros((1, 1, 3)))):
        measured = drift(np.array([formula(one.attained) for one in groups]))
        simulated = drift(np.stack([formula(one + offset) for one in sampled], axis=-1))
        values.append(_value(float(measured), _expanded(simulated), _fewest(groups)))
    return values[0], values[1]


def path_values(
    attained: Array, commanded: Array, tracker: Array, frame: Array, rng: np.random.Generator
) -> tuple[IsoValue, IsoValue]:
    """Compute AT and RT of a path that n cycles attained at m points.

    Parameters
    ----------
    attained : array, shape (m, n, 3)
        Measured positions [m].
    commanded : array, shape (m, 3)
        Commanded positions [m].
    tracker, frame : arrays, shape (3, 3)
        Covariances as in ``Cycles``, the same at all points; the errors are the same at all points too.
    """
    m, n = attained.shape[:2]
    mean = attained.mean(axis=1, keepdims=True)
    deviations = attained - mean
    root = np.sqrt(np.einsum("mna,mna->ma", deviations, deviations) / (n - 1))
    widened = _widened(rng, n, (_PATH_SAMPLES, 1, 1, 1))
    paths = mean + widened * root[:, None] * rng.standard_normal((_PATH_SAMPLES, m, n, 3))
    shared = rng.multivariate_normal(np.zeros(3), tracker + frame, size=(_PATH_SAMPLES, 1, 1), method="eigh")
    accuracy, repeatability = float(path_accuracy(attained, commanded)), float(path_repeatability(attained))
    alone = rng.multivariate_normal(np.zeros(3), tracker, size=(_PATH_SAMPLES, n), method="eigh")
    sampling = _expanded(path_repeatability(paths))
    inflated = _with_tracker(repeatability, sampling, float(pose_repeatability(alone).mean()))
    return _value(accuracy, _expanded(path_accuracy(paths + shared, commanded)), n), _value(repeatability, inflated, n)


def _with_tracker(value: float, sampling: float, tracker: float) -> float:
    """Compute the expanded uncertainty [m] of a repeatability that may contain the scatter ``tracker`` [m]."""
    without = np.sqrt(max(value**2 - tracker**2, 0.0))
    return float(np.hypot(sampling, value - without))


def _widened(rng: np.random.Generator, n: int, shape: tuple[int, ...]) -> Array:
    """Sample factors from the standard deviation of n cycles to possible values of the true one."""
    return np.asarray(np.sqrt((n - 1) / rng.chisquare(n - 1, shape)))


def _expanded(sampled: Array) -> float:
    return float(np.quantile(np.abs(sampled - np.median(sampled)), _COVERAGE))


def _value(value: float, expanded: float, n: int) -> IsoValue:
    return IsoValue(value_mm=value * 1e3, expanded_mm=expanded * 1e3, n=n)


def _fewest(cycles: Sequence[Cycles]) -> int:
    return min(one.n for one in cycles)


# -- Test cube --------------------------------------------------------------------------------------------------------


DIRECTIONS = ("x", "y", "z")
"""Directions of approach, along the axes of the arm's base (7.2.3)."""
DIRECTIONAL_POSES = ("P1", "P2", "P4")

_FACE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
CORNERS = {f"C{number}": (x, y, z) for number, (z, (x, y)) in enumerate(product((1, -1), _FACE), start=1)}
"""Signs of each corner relative to the centre along x, y and z of the arm's base."""
PLANES: tuple[tuple[str, str, str, str], ...] = (
    ("C1", "C2", "C7", "C8"),
    ("C2", "C3", "C8", "C5"),
    ("C3", "C4", "C5", "C6"),
    ("C4", "C1", "C6", "C7"),
)
"""Planes a to d of the standard, in its order."""
POSES = ("P1", "P2", "P3", "P4", "P5")
CYCLE = ("P5", "P4", "P3", "P2", "P1")
"""Order of visits in a cycle that begins at P1 (7.2): every pose is always reached from the same previous pose."""
_INSET = 0.1
"""Distance of P2 to P5 from the ends of the diagonals, as share of their length; the standard allows 0.08 to 0.12."""
LARGE_CIRCLE, SMALL_CIRCLE = 0.8, 0.08
"""Diameters of the test circles as shares of the cube's edge (6.8): the small one is a tenth of the large one."""
_CIRCLE_POINTS = 4
"""Number of points on the circle, which is two arcs through them."""


def pose_positions(centre: Array, edge: float, plane: tuple[str, str, str, str]) -> dict[str, Array]:
    """Return positions (3,) [m] of P1 to P5 for a cube about ``centre`` (3,) [m]; P2 to P5 are near the corners."""
    reach = 0.5 * edge * (1.0 - 2.0 * _INSET)
    corners = [centre + reach * np.array(CORNERS[name]) for name in plane]
    return dict(zip(POSES, [np.asarray(centre), *corners], strict=True))


def circle_positions(poses: Mapping[str, Array], edge: float, share: float = LARGE_CIRCLE) -> Array:
    """Return points (5, 3) [m] a quarter turn apart on a circle about P1 in the plane of the poses, the first twice.

    ``share`` is the diameter as a share of the cube's edge. The first point lies towards the middle of P2 and P3.
    """
    centre = poses["P1"]
    first = 0.5 * (poses["P2"] + poses["P3"]) - centre
    second = 0.5 * (poses["P3"] + poses["P4"]) - centre
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    angle = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS + 1)[:, None]
    return np.asarray(centre + 0.5 * share * edge * (np.cos(angle) * first + np.sin(angle) * second))


def lattice_cube(points: NDArray[np.bool_]) -> tuple[int, tuple[int, int, int]] | None:
    """Find the largest all-True cube in a mask (a, b, c); return the steps along its edge and its first corner.

    None if no point is True. Of cubes of the same size, take the one whose first corner comes first.
    """
    if not points.any():
        return None
    edge, held = 0, points
    while True:
        larger = held
        for axis in range(3):
            low = [slice(None)] * 3
            high = [slice(None)] * 3
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            larger = larger[tuple(low)] & larger[tuple(high)]
        if not larger.any():
            first = np.argwhere(held)[0]
            return edge, (int(first[0]), int(first[1]), int(first[2]))
        edge, held = edge + 1, larger
