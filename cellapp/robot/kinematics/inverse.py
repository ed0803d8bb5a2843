"""Numerical inverse kinematics by damped least squares, for many poses at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.robot.kinematics.chain import Geometry, flange_poses, frame_poses
from cellapp.robot.kinematics.transforms import Array, rotation_vectors

_LARGEST_STEP = 0.5
"""Largest change of any joint in one iteration [rad]: beyond it the linearisation of the chain does not hold."""
_DAMPING = (1e-2, 1e-3, 1e-14)
"""Damping per squared error, its upper limit, and its lower limit, which keeps the normal matrix regular."""


_FREE_DAMPING = 1e-12
"""Damping [m^2] of a step to a position with free rotation: far below the squared lever arms."""
_REACHED = 1e-10
"""Largest position error [m] and rotation error [rad] that count as reached."""


@dataclass(frozen=True, eq=False)
class Inverted:
    """Joint positions for n poses.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions [rad].
    residual_m, residual_rad : array, shape (n,)
        Distance of the SMR centre from the wanted position, and angle (0 to pi) between the flange and the wanted
        rotation there; the angle is NaN if the rotation is free.
    within : float
        Largest residual [m, rad] of a pose that counts as reached.
    """

    q: Array
    residual_m: Array
    residual_rad: Array
    within: float = _REACHED

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Mask (n,) of poses that are reached."""
        return (self.residual_m < self.within) & ~(self.residual_rad >= self.within)

    def take(self, rows: NDArray[np.intp]) -> Inverted:
        """Return the solutions of some rows."""
        return Inverted(self.q[rows], self.residual_m[rows], self.residual_rad[rows], self.within)

    def put(self, rows: NDArray[np.intp], of: Inverted, kept: NDArray[np.bool_]) -> None:
        """Replace the solutions of ``rows`` by the ``kept`` ones of ``of``."""
        self.q[rows], self.residual_m[rows], self.residual_rad[rows] = (
            of.q[kept],
            of.residual_m[kept],
            of.residual_rad[kept],
        )


PoseErrors = Callable[[NDArray[np.intp], Array], tuple[Array, Array]]
"""Rows of targets and their joint positions (k, N) [rad] -> errors (k, 6) [m, rad], and the Jacobian (k, 6, N)."""


def solve_pose(
    geometry: Geometry, position_M: Array, rotation_M: Array, start: Array, *, max_iterations: int = 60
) -> Inverted:
    """Find joint positions that put the SMR at ``position_M`` and orient the flange as ``rotation_M``.

    If a pose cannot be reached (fewer than six joints, a singularity, out of range), the iterate with the smallest
    error is returned and marked as not reached.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        Wanted SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Wanted rotation of the flange in the tracker frame.
    start : array, shape (n, N)
        Initial joint positions [rad]; they select the branch of the solution.
    max_iterations : int
        Most iterates, with ``start``.

    Notes
    -----
    Damping grows with the squared error: Nakamura, Hanafusa, J. Dyn. Sys. Meas. Control 108 (1986) 163.
    """

    def errors(rows: NDArray[np.intp], q: Array) -> tuple[Array, Array]:
        return errors_and_jacobian(geometry, position_M[rows], rotation_M[rows], q)

    free = np.zeros(len(start), dtype=np.bool_)
    return newton(errors, start, free, rounds=max_iterations, same=0.1 * _REACHED, within=_REACHED)


def newton(
    errors_of: PoseErrors, start: Array, free: NDArray[np.bool_], *, rounds: int, same: float, within: float
) -> Inverted:
    """Find joint positions near ``start`` (n, N) [rad] without errors: the best of at most ``rounds`` Newton iterates.

    Where ``free`` (n,), any rotation will do, and the joints move as little as possible. The iteration of a target ends
    at errors below ``same``; errors below ``within`` count as reached [m, rad].
    """
    q, best, active = start.copy(), start.copy(), np.arange(len(start))
    error, least = np.full((len(start), 6), np.inf), np.full(len(start), np.inf)
    for left in reversed(range(rounds)):
        errors, J = errors_of(active, q[active])
        errors[free[active], 3:] = 0.0
        largest = np.abs(errors).max(axis=1)
        better = largest < least[active]
        rows = active[better]
        best[rows], error[rows], least[rows] = q[rows], errors[better], largest[better]
        going = ~(largest < same)
        active, errors, J = active[going], errors[going], J[going]
        if not (left and len(active)):
            break
        q[active] += _step(J, errors, free[active])
    rotated = np.where(free, np.nan, np.linalg.norm(error[:, 3:], axis=1))
    return Inverted(best, np.linalg.norm(error[:, :3], axis=1), rotated, within)


def errors_and_jacobian(geometry: Geometry, position_M: Array, rotation_M: Array, q: Array) -> tuple[Array, Array]:
    """Compute position error [m] and rotation vector [rad] to the wanted pose (n, 6), and the geometric Jacobian
    (n, 6, N)."""
    rotations, origins = frame_poses(geometry, q)
    flange = rotations[-1]
    P = origins[-1] + flange @ geometry.tool
    to_wanted = rotation_vectors(flange.transpose(0, 2, 1) @ rotation_M)  # in the flange frame
    errors = np.concatenate([position_M - P, np.einsum("nab,nb->na", flange, to_wanted)], axis=1)
    axes = rotations[:-1, :, :, 2]
    J = np.concatenate([np.cross(axes, P - origins[:-1]), axes], axis=2).transpose(1, 2, 0)
    return errors, J


def _step(J: Array, errors: Array, free: NDArray[np.bool_]) -> Array:
    """Return the step (n, N) [rad]: damped least squares to poses, least motion to positions with free rotation."""
    step = np.empty((len(J), J.shape[2]))
    if not free.all():
        step[~free] = damped_step(J[~free], errors[~free])
    if free.any():
        J_p = J[free, :3]
        A = J_p @ J_p.transpose(0, 2, 1) + _FREE_DAMPING * np.eye(3)
        step[free] = np.einsum("nij,ni->nj", J_p, np.linalg.solve(A, errors[free, :3, None])[:, :, 0])
    return step


def damped_step(J: Array, errors: Array) -> Array:
    """Compute a damped least-squares step (n, N) [rad] of limited size from errors (n, 6) and ``J`` (n, 6, N)."""
    share, most, least = _DAMPING
    damping = np.minimum(most, share * np.einsum("na,na->n", errors, errors)) + least
    A = J.transpose(0, 2, 1) @ J + damping[:, None, None] * np.eye(J.shape[2])
    step = np.linalg.solve(A, J.transpose(0, 2, 1) @ errors[:, :, None])[:, :, 0]
    largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
    return np.asarray(step * np.minimum(1.0, _LARGEST_STEP / largest)[:, None])


# -- Find all inverse solutions of six-joint chains whose structure admits a closed form ------------------------------
#
# Two structures are covered, with any values of the other offsets, twist angles and tool. Both have parallel or
# anti-parallel axes 2 and 3; h is the direction of axis 2, phi_i = q_i + theta_i:
#
# - axes 2, 3 and 4 parallel, a5 = a6 = 0 (Universal Robots): every point beyond joint 4 that lies on axis 5 keeps its
#   distance along h, which gives phi_1; the angle of axis 6 to h gives phi_5, h in the flange frame gives phi_6, and
#   the
#   rest is a planar arm of two links;
# - axes 4, 5 and 6 meet in one point (elbow arms with a spherical wrist): the distance of that point along h gives
#   phi_1,
#   a planar arm of two links gives phi_2 and phi_3, the remaining rotation gives phi_4 to phi_6.
#
# Each has up to eight solutions. Sources: Hawkins, Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms
# (2013); Pieper, The kinematics of manipulators under computer control (1968).


Structure = Literal["parallel axes 2-3-4", "spherical wrist"]
_NEAR_RAD, _NEAR_M = 0.02, 0.01
"""Tolerances [rad, m] within which a chain is solved by a structure and then refined: they include the maker's own
calibration of an arm."""
_EXACT = 1e-12
_POLISH_ROUNDS = 12
"""Iterations that refine solutions of a chain that is only near a structure: few, as they start a centimetre away."""
_LEAST_SINE = 0.05
"""Sine of a twist angle below which axes count as parallel."""
_ROUNDING = 1e-9
"""Tolerance by which sines and cosines may exceed 1: the arm is then stretched and the solution double."""


@dataclass(frozen=True)
class _Chain:
    """The parameters of a structured chain: offsets [m], angles [rad], and cosines and sines of its twist angles."""

    theta: Array
    d: Array
    a: Array
    c: Array
    s: Array


def structure_of(geometry: Geometry) -> tuple[Structure, float] | None:
    """Return the structure that a chain has or nearly has, and its deviation from it [rad or m]; None if it has none.

    Nearly means within 20 mrad and 10 mm: solutions of such a chain must be refined.
    """
    if geometry.joints != 6:
        return None
    d, a, alpha, beta = geometry.rows[:, 1:].T
    s = np.sin(alpha)
    reach = float(np.abs(a).sum() + np.abs(d).sum())
    if reach == 0.0 or min(abs(s[0]), abs(s[3]), abs(s[4])) < _LEAST_SINE:
        return None
    bent, rotated = float(np.abs(beta).max()), abs(float(s[1]))
    found: list[tuple[Structure, float, float]] = [
        ("parallel axes 2-3-4", max(bent, rotated, abs(float(s[2]))), float(np.abs(a[4:]).max())),
        ("spherical wrist", max(bent, rotated), float(max(abs(a[3]), abs(a[4]), abs(d[4])))),
    ]
    for name, angle, length in found:
        second = abs(a[2]) if name == "parallel axes 2-3-4" else math.hypot(a[2], d[3] * s[2])
        if angle <= _NEAR_RAD and length <= _NEAR_M and min(abs(a[1]), second) > 2.0 * _NEAR_M:
            return name, max(angle, length)
    return None


def closed_form_solutions(
    geometry: Geometry, position_M: Array, rotation_M: Array, near: Array | None = None
) -> Array | None:
    """Find all joint positions that reach n poses, (n, 8, 6) [rad], each in (-pi, pi]; NaN if there is no solution.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Rotation of the flange in the tracker frame.
    near : array, shape (6,) or (n, 6), optional
        Position of a joint that a singular wrist leaves free [rad]; zero by default.

    Returns
    -------
    array, or None if the chain has neither structure.
    """
    found = structure_of(geometry)
    if found is None:
        return None
    name, off = found
    T = geometry.T_M_B()
    R = T[:3, :3].T @ rotation_M
    o6 = (position_M - T[:3, 3]) @ T[:3, :3] - R @ geometry.tool  # of the flange, in the base frame
    chain = _structured(geometry, name)
    free = np.broadcast_to(chain.theta + (0.0 if near is None else near), (len(position_M), 6))
    solve = _parallel_axes if name == "parallel axes 2-3-4" else _spherical_wrist
    with np.errstate(invalid="ignore"):  # NaN marks branches without a solution
        phi = solve(chain, R, o6, free)
        q = np.pi - np.mod(np.pi - (phi - chain.theta), 2.0 * np.pi)
    q[~np.isfinite(q).all(axis=2)] = np.nan
    return q if off <= _EXACT else _made_exact(geometry, position_M, rotation_M, q)


# -- inside -----------------------------------------------------------------------------------------------------------


def _structured(geometry: Geometry, name: Structure) -> _Chain:
    """Return the chain with parameters that are nearly zero or pi set to exactly that."""
    theta, d, a, alpha, _ = geometry.rows.T.copy()
    parallel = [1, 2] if name == "parallel axes 2-3-4" else [1]
    alpha[parallel] = np.pi * np.round(alpha[parallel] / np.pi)
    if name == "parallel axes 2-3-4":
        a[4:] = 0.0
    else:
        a[3:5], d[4] = 0.0, 0.0
    c, s = np.cos(alpha), np.sin(alpha)
    c[parallel], s[parallel] = np.round(c[parallel]), 0.0
    return _Chain(theta, d, a, c, s)


def _parallel_axes(chain: _Chain, R: Array, o6: Array, free: Array) -> Array:
    """Solve phi (n, 8, 6) of chains with parallel axes 2, 3 and 4; branches in order shoulder, wrist, elbow."""
    d, c, s = chain.d, chain.c, chain.s
    sense = c[1] * c[2]  # of axis 4 against axis 2
    z5 = R @ np.array([0.0, s[5], c[5]])
    o5 = o6 - d[5] * z5
    phi1 = _shoulder(chain, o5, d[1] + c[1] * d[2] + sense * (d[3] + d[4] * c[3]))[:, :, None]
    h = np.stack([s[0] * np.sin(phi1), -s[0] * np.cos(phi1), np.full(phi1.shape, c[0])], axis=-1)  # axis 2
    cos5 = (c[3] * c[4] - sense * np.einsum("nija,na->nij", h, z5)) / (s[3] * s[4])
    phi5 = _arccos(cos5) * np.array([1.0, -1.0])
    # h in the frame before joint 6, and after it
    y, z = sense * np.cos(phi5) * s[3], sense * c[3]
    before = np.stack([sense * np.sin(phi5) * s[3], c[4] * y + s[4] * z], axis=-1)
    in_flange = np.einsum("nba,nijb->nija", R, h)
    after = np.stack([in_flange[..., 0], c[5] * in_flange[..., 1] - s[5] * in_flange[..., 2]], axis=-1)
    phi6 = _between(after, before, free[:, 5, None, None])
    R_04 = R[:, None, None] @ _rot_zx(phi6, c[5], s[5]).swapaxes(-1, -2) @ _rot_zx(phi5, c[4], s[4]).swapaxes(-1, -2)
    o4 = o5[:, None, None] - d[4] * R_04[..., :, 2]
    return _planar(chain, phi1, R_04, o4, phi5, phi6)


def _planar(chain: _Chain, phi1: Array, R_04: Array, o4: Array, phi5: Array, phi6: Array) -> Array:
    """Solve the planar arm of joints 2 to 4 for frame 4; return all angles (n, 8, 6)."""
    a, c = chain.a, chain.c
    R_1, o1 = _frame_1(chain, phi1)
    v = np.einsum("nijba,nijb->nija", R_1, o4 - o1)
    x4 = np.einsum("nijba,nijb->nija", R_1, R_04[..., :, 0])
    psi = np.arctan2(x4[..., 1], x4[..., 0])
    u = v[..., 0] + 1j * v[..., 1] - a[3] * np.exp(1j * psi)
    phi2, bend = _two_links(u, float(a[1]), float(a[2]))
    phi4 = c[1] * c[2] * (psi[..., None] - phi2 - bend)
    parts = (phi1[..., None], phi2, c[1] * bend, phi4, phi5[..., None], phi6[..., None])
    return np.stack(np.broadcast_arrays(*parts), axis=-1).reshape(len(o4), 8, 6)


def _spherical_wrist(chain: _Chain, R: Array, o6: Array, free: Array) -> Array:
    """Solve phi (n, 8, 6) of chains whose axes 4, 5 and 6 meet; branches in order shoulder, elbow, wrist."""
    d, a, c, s = chain.d, chain.a, chain.c, chain.s
    z5 = R @ np.array([0.0, s[5], c[5]])
    centre = o6 - d[5] * z5 - a[5] * R[:, :, 0]
    phi1 = _shoulder(chain, centre, d[1] + c[1] * (d[2] + d[3] * c[2]))
    R_1, o1 = _frame_1(chain, phi1)
    v = np.einsum("niba,nib->nia", R_1, centre[:, None] - o1)
    forearm = complex(a[2], -c[1] * d[3] * s[2])  # as seen from frame 1, before joint 3 turns it
    phi2, bend = _two_links(v[..., 0] + 1j * v[..., 1], float(a[1]), abs(forearm))
    phi3 = c[1] * (bend - np.angle(forearm))
    R_03 = R_1[:, :, None] @ _rot_zx(phi2, c[1], s[1]) @ _rot_zx(phi3, c[2], s[2])
    wrist = R_03.swapaxes(-1, -2) @ (R @ _rotation_x(c[5], -s[5]))[:, None, None]
    phi5 = _arccos((c[3] * c[4] - wrist[..., 2, 2]) / (s[3] * s[4]))[..., None] * np.array([1.0, -1.0])
    axis = np.stack([s[4] * np.sin(phi5), -c[3] * s[4] * np.cos(phi5) - s[3] * c[4]], axis=-1)
    phi4 = _between(axis, wrist[..., None, :2, 2], free[:, 3, None, None, None])
    of_6 = (_rot_zx(phi4, c[3], s[3]) @ _rot_zx(phi5, c[4], s[4])).swapaxes(-1, -2) @ wrist[..., None, :, :]
    phi6 = np.arctan2(of_6[..., 1, 0], of_6[..., 0, 0])
    parts = (phi1[:, :, None, None], phi2[..., None], phi3[..., None], phi4, phi5, phi6)
    return np.stack(np.broadcast_arrays(*parts), axis=-1).reshape(len(o6), 8, 6)


def _shoulder(chain: _Chain, point: Array, along: float) -> Array:
    """Solve both phi_1 (n, 2) with ``point`` (n, 3) at distance ``along`` [m] from frame 1 in direction of axis 2."""
    x, y, z = point.T
    k = (along - chain.c[0] * (z - chain.d[0])) / chain.s[0]
    up = 0.5 * np.pi - _arccos(k / np.maximum(np.hypot(x, y), 1e-300))[:, None]
    return np.asarray(np.arctan2(y, x)[:, None] + np.concatenate([up, np.pi - up], axis=1))


def _frame_1(chain: _Chain, phi1: Array) -> tuple[Array, Array]:
    """Rotations (..., 3, 3) and origins (..., 3) [m] of frame 1 in the base frame."""
    d, a = chain.d[0], chain.a[0]
    origin = np.stack([a * np.cos(phi1), a * np.sin(phi1), np.full(phi1.shape, d)], axis=-1)
    return _rot_zx(phi1, chain.c[0], chain.s[0]), origin


def _two_links(tip: Array, first: float, second: float) -> tuple[Array, Array]:
    """Solve a planar two-link arm for tips x + iy [m]: direction of link 1, angle of link 2 to it, (..., 2) [rad]."""
    cosine = (np.abs(tip) ** 2 - first**2 - second**2) / (2.0 * first * second)
    bend = _arccos(cosine)[..., None] * np.array([1.0, -1.0])
    direction = np.angle(tip)[..., None] - np.angle(first + second * np.exp(1j * bend))
    return direction, bend


def _arccos(cosine: Array) -> Array:
    """Compute the arc cosine [rad]; clip rounding beyond 1, NaN for more."""
    within = np.abs(cosine) <= 1.0 + _ROUNDING
    return np.asarray(np.where(within, np.arccos(np.clip(cosine, -1.0, 1.0)), np.nan))


def _between(from_xy: Array, to_xy: Array, free: Array) -> Array:
    """Compute the angle from one plane vector (..., 2) to another; ``free`` if they vanish and any angle will do."""
    angle = np.arctan2(to_xy[..., 1], to_xy[..., 0]) - np.arctan2(from_xy[..., 1], from_xy[..., 0])
    return np.asarray(np.where(np.hypot(from_xy[..., 0], from_xy[..., 1]) < _ROUNDING, free, angle))


def _rot_zx(phi: Array, c: float, s: float) -> Array:
    """``rot_z(phi) rot_x(alpha)`` (..., 3, 3) from the cosine and sine of alpha."""
    cp, sp, zero = np.cos(phi), np.sin(phi), np.zeros(np.shape(phi))
    rows = ((cp, -sp * c, sp * s), (sp, cp * c, -cp * s), (zero, zero + s, zero + c))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _rotation_x(c: float, s: float) -> Array:
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _made_exact(geometry: Geometry, position_M: Array, rotation_M: Array, q: Array) -> Array:
    """Refine solutions (n, 8, 6) of the structure to those of the chain itself; NaN if there is none."""
    rows, branch = np.nonzero(np.isfinite(q[:, :, 0]))
    solved = solve_pose(geometry, position_M[rows], rotation_M[rows], q[rows, branch], max_iterations=_POLISH_ROUNDS)
    exact = np.full(q.shape, np.nan)
    exact[rows, branch] = np.where(solved.reached[:, None], solved.q, np.nan)
    return exact


# -- Find inverse solutions of any chain from starts in a table of sampled configurations -----------------------------
#
# Newton's iteration converges to the solution whose basin contains its start. Samples with a pose near the wanted one
# lie in the basins of the different branches, so a few dozen starts find nearly all branches; for a redundant arm,
# whose solutions are a continuum, they give a spread of solutions.


_SAMPLES = 20_000
"""Configurations in the table: their poses lie some 0.3 rad and 0.2 of the reach apart, from where Newton converges."""
_STARTS = 32
"""Number of starts for each pose: a six-joint arm has at most 16 solutions."""
_POSITION_STARTS, _LIKED_STARTS = 5, 12
"""Numbers of starts for each position with free rotation, from the samples and from ``liked``: different branches."""
_NEAREST = 64
"""Number of samples nearest to a position; the starts are those of them nearest to the preferred configuration."""
_ROUNDS = 40
"""Most iterations of one start; a start that needs more is not near a solution."""
_AT_ONCE = 1000
"""Number of poses in a batch: with their starts some tens of MB."""
_SAME = 1e-5
"""Solutions that agree to 10 µrad in every joint count as one; two branches meet only at a singularity."""
_PULL, _PULL_ROUNDS, _CLOSE_ROUNDS = 0.5, 12, 25
"""Share of the way to the preferred configuration that one iteration moves in the null space of the position, number of
such iterations, and number of later ones that only reduce the position error."""
_SAMPLED_DAMPING, _MOST_DAMPING, _DAMPING_SHARE = 1e-9, 1e-2, 1e-2
"""Damping of a position step: its limits [m^2], the lower far below the squared levers of an arm, and its size per
squared error, as in ``solve_pose``."""
_REACHED_M = 1e-9
"""Position error of a solution."""


def sampled_solutions(
    geometry: Geometry, position_M: Array, rotation_M: Array, limits: Array, near: Array, seed: int
) -> Array:
    """Find joint positions (n, K, N) [rad] that reach n poses, each joint within half a turn of ``near`` (N,).

    Positions (n, 3) [m] of the SMR and rotations (n, 3, 3) of the flange are in the tracker frame. Samples are taken
    from ``seed`` within ``limits`` (N, 2) [rad]. The result is padded with NaN.
    """
    samples = sampled_configurations(limits, near, seed)
    rotations, _ = flange_poses(geometry, samples)
    at, reach = _positions(geometry, samples)
    tree = scipy.spatial.cKDTree(np.hstack([at / reach, rotations.reshape(-1, 9)]))
    found = []
    for begin in range(0, len(position_M), _AT_ONCE):
        P, R = position_M[begin : begin + _AT_ONCE], rotation_M[begin : begin + _AT_ONCE]
        _, starts = tree.query(np.hstack([P / reach, R.reshape(-1, 9)]), k=_STARTS)
        q = np.concatenate([np.broadcast_to(near, (len(P), 1, len(near))), samples[starts]], axis=1)
        which = np.repeat(np.arange(len(P)), q.shape[1])
        solved = solve_pose(geometry, P[which], R[which], q.reshape(len(which), -1), max_iterations=_ROUNDS)
        reached = np.where(solved.reached[:, None], _around(solved.q, near), np.nan)
        found.append(_distinct(reached.reshape(q.shape)))
    return _stacked(found, len(near))


def position_solutions(
    geometry: Geometry, position_M: Array, samples: Array, near: Array, liked: Array | None = None
) -> Array:
    """Find joint positions (n, K, N) [rad] that put the SMR at n positions (n, 3) [m] with any rotation; NaN pads.

    Starts are ``near`` and those ``samples`` (m, N) with the SMR near the position that are nearest to ``near``; they
    are pulled towards ``near`` within the null space, to a local minimum of the distance from it. Other starts,
    ``near`` and those of ``liked`` (m', N) with the SMR nearest to the position, go to it by the least motion.
    """
    found = []
    for begin in range(0, len(position_M), _AT_ONCE):
        P = position_M[begin : begin + _AT_ONCE]
        own = np.broadcast_to(near, (len(P), 1, len(near)))
        pulled = np.concatenate([own, _starts_near(geometry, P, samples, near, _NEAREST)[:, :_POSITION_STARTS]], axis=1)
        still = own
        if liked is not None and len(liked):
            still = np.concatenate([own, _starts_near(geometry, P, liked, near, _LIKED_STARTS)], axis=1)
        each = []
        for starts, rounds in ((pulled, _PULL_ROUNDS), (still, 0)):
            which = np.repeat(np.arange(len(P)), starts.shape[1])
            q, off = _to_position(geometry, P[which], starts.reshape(len(which), -1), near, rounds)
            each.append(np.where(off[:, None] < _REACHED_M, _around(q, near), np.nan).reshape(starts.shape))
        found.append(_distinct(np.concatenate(each, axis=1)))
    return _stacked(found, len(near))


def missed_distances(geometry: Geometry, position_M: Array, start: Array) -> Array:
    """Return the SMR's remaining distance (n,) [m] from positions (n, 3), any rotation, from one start (N,) [rad]."""
    return _to_position(geometry, position_M, np.tile(start, (len(position_M), 1)), start, 0)[1]


def sampled_configurations(limits: Array, near: Array, seed: int) -> Array:
    """Sample configurations (m, N) [rad] within limits (N, 2), and within half a turn of ``near`` if limits allow."""
    middle = np.clip(near, limits[:, 0] + np.pi, limits[:, 1] - np.pi)
    low, high = np.maximum(limits[:, 0], middle - np.pi), np.minimum(limits[:, 1], middle + np.pi)
    return np.random.default_rng([seed, 0x7A6]).uniform(low, high, size=(_SAMPLES, len(low)))


# -- inside -----------------------------------------------------------------------------------------------------------


def _starts_near(geometry: Geometry, position_M: Array, table: Array, near: Array, among: int) -> Array:
    """Select the ``among`` table entries with the SMR nearest to each of n positions, sorted by closeness to ``near``.

    ``near`` (N,) [rad] is the preferred configuration.
    """
    at, _ = _positions(geometry, table)
    _, rows = scipy.spatial.cKDTree(at).query(position_M, k=min(among, len(table)))
    rows = rows.reshape(len(position_M), -1)
    order = np.argsort(np.abs(table[rows] - near).max(axis=2), axis=1, kind="stable")
    return np.asarray(table[np.take_along_axis(rows, order, axis=1)])


def _positions(geometry: Geometry, samples: Array) -> tuple[Array, float]:
    """Compute SMR positions (m, 3) [m] and the size of the volume that they fill [m]."""
    rotations, origins = flange_poses(geometry, samples)
    at = origins + rotations @ geometry.tool
    return at, max(float(np.linalg.norm(at.std(axis=0))), 1e-9)


def _to_position(
    geometry: Geometry, position_M: Array, start: Array, near: Array, pull_rounds: int
) -> tuple[Array, Array]:
    """Move starts to positions by least motions, the first ``pull_rounds`` iterations with a pull to ``near``.

    Return joint positions (n, N) [rad] and the SMR's distances (n,) [m] from the positions.
    """
    q, active = start.copy(), np.arange(len(start))
    for k in range(pull_rounds + _CLOSE_ROUNDS):
        here = q[active]
        rotations, origins = frame_poses(geometry, here)
        P = origins[-1] + rotations[-1] @ geometry.tool
        axes = rotations[:-1, :, :, 2]
        J = np.cross(axes, P - origins[:-1]).transpose(1, 2, 0)
        error = position_M[active] - P
        pull = np.zeros_like(here)
        if k < pull_rounds:
            pull = _PULL * (near - here)
            error = error - np.einsum("nij,nj->ni", J, pull)  # so that the pull stays within the null space
        damping = np.clip(_DAMPING_SHARE * np.einsum("ni,ni->n", error, error), _SAMPLED_DAMPING, _MOST_DAMPING)
        A = J @ J.transpose(0, 2, 1) + damping[:, None, None] * np.eye(3)
        step = pull + np.einsum("nij,ni->nj", J, np.linalg.solve(A, error[:, :, None])[:, :, 0])
        largest = np.maximum(np.abs(step).max(axis=1), 1e-12)
        q[active] += step * np.minimum(1.0, _LARGEST_STEP / largest)[:, None]
        active = active[(k < pull_rounds) | (np.abs(error).max(axis=1) >= 0.1 * _REACHED_M)]
        if not len(active):
            break
    rotations, origins = flange_poses(geometry, q)
    return q, np.linalg.norm(position_M - origins - rotations @ geometry.tool, axis=1)


def _around(q: Array, near: Array) -> Array:
    """Shift joints by whole turns to within half a turn of ``near``."""
    return np.asarray(near + np.pi - np.mod(near + np.pi - q, 2.0 * np.pi))


def _distinct(q: Array) -> Array:
    """Remove repeated solutions from (n, K, N); the kept ones come first, padded with NaN."""
    kept = np.isfinite(q[:, :, 0])
    for k in range(1, q.shape[1]):
        apart = np.abs(np.mod(q[:, :k] - q[:, k : k + 1] + np.pi, 2.0 * np.pi) - np.pi).max(axis=2)
        kept[:, k] &= ~np.any((apart < _SAME) & kept[:, :k], axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(1, int(kept.sum(axis=1).max(initial=1)))]
    front = np.take_along_axis(kept, order, axis=1)
    return np.where(front[:, :, None], np.take_along_axis(q, order[:, :, None], axis=1), np.nan)


def _stacked(parts: list[Array], joints: int) -> Array:
    """Stack blocks (n, K, N) of different K along n, padded with NaN."""
    if not parts:
        return np.empty((0, 1, joints))
    most = max(one.shape[1] for one in parts)
    return np.concatenate(
        [np.pad(one, ((0, 0), (0, most - one.shape[1]), (0, 0)), constant_values=np.nan) for one in parts]
    )


# ---------------------------------------------------------------------------------------------------------------------
# Find all inverse solutions of a chain: in closed form if its structure allows, else from sampled configurations.


_TURN = 2.0 * np.pi


def all_branches(
    geometry: Geometry,
    position_M: Array,
    rotation_M: Array,
    limits: Array,
    near: Array,
    seed: int,
    liked: Array | None = None,
) -> Array:
    """Find joint positions (n, K, N) [rad] that reach n targets, regardless of limits; padded with NaN.

    Parameters
    ----------
    geometry : Geometry
    position_M : array, shape (n, 3)
        SMR centre in the tracker frame [m].
    rotation_M : array, shape (n, 3, 3)
        Rotation of the flange; NaN if it is free, which gives some solutions near ``near``.
    limits : array, shape (N, 2)
        Range of the samples for chains without a closed form [rad].
    near : array, shape (N,)
        Preferred configuration [rad].
    seed : int
        Seed of the samples.
    liked : array, shape (m, N), optional
        More preferred configurations for solutions with free rotation, besides ``near``.
    """
    free = np.isnan(rotation_M[:, 0, 0])
    parts: list[tuple[NDArray[np.bool_], Array]] = []
    if free.any():
        samples = sampled_configurations(limits, near, seed)
        parts.append((free, position_solutions(geometry, position_M[free], samples, near, liked)))
    if not free.all():
        P, R = position_M[~free], rotation_M[~free]
        closed = closed_form_solutions(geometry, P, R, near)
        found = sampled_solutions(geometry, P, R, limits, near, seed) if closed is None else closed
        parts.append((~free, found))
    q = np.full((len(free), max((one.shape[1] for _, one in parts), default=1), geometry.joints), np.nan)
    for rows, one in parts:
        q[rows, : one.shape[1]] = one
    return q


def shifted_into(q: Array, limits: Array, to: Array) -> tuple[Array, Array]:
    """Shift each joint of ``q`` (..., N) by whole turns to the position within ``limits`` (N, 2) nearest to ``to``.

    Returns
    -------
    q : array, shape (..., N)
        Joint positions [rad]; if no turn is within the limits, the one that exceeds them least.
    beyond : array, shape (..., N)
        Excess over the limits [rad]; zero within.
    """
    low, high = limits.T
    fewest, most = np.ceil((low - _ROUNDING - q) / _TURN), np.floor((high + _ROUNDING - q) / _TURN)
    inside = q + _TURN * np.clip(np.round((to - q) / _TURN), fewest, np.maximum(fewest, most))
    above, below = q + _TURN * fewest - high, low - q - _TURN * most
    outside = np.where(above <= below, q + _TURN * fewest, q + _TURN * most)
    fits = fewest <= most
    return np.where(fits, inside, outside), np.where(fits, 0.0, np.minimum(above, below))
