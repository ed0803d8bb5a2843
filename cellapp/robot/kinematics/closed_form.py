"""Find all inverse solutions of six-joint chains whose structure admits a closed form.

Two structures are covered, with any values of the other offsets, twist angles and tool. Both have parallel or
anti-parallel axes 2 and 3; h is the direction of axis 2, phi_i = q_i + theta_i:

- axes 2, 3 and 4 parallel, a5 = a6 = 0 (Universal Robots): every point beyond joint 4 that lies on axis 5 keeps its
  distance along h, which gives phi_1; the angle of axis 6 to h gives phi_5, h in the flange frame gives phi_6, and the
  rest is a planar arm of two links;
- axes 4, 5 and 6 meet in one point (elbow arms with a spherical wrist): the distance of that point along h gives phi_1,
  a planar arm of two links gives phi_2 and phi_3, the remaining rotation gives phi_4 to phi_6.

Each has up to eight solutions. Sources: Hawkins, Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms
(2013); Pieper, The kinematics of manipulators under computer control (1968).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.kinematics.transforms import Array

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
    bent, turned = float(np.abs(beta).max()), abs(float(s[1]))
    found: list[tuple[Structure, float, float]] = [
        ("parallel axes 2-3-4", max(bent, turned, abs(float(s[2]))), float(np.abs(a[4:]).max())),
        ("spherical wrist", max(bent, turned), float(max(abs(a[3]), abs(a[4]), abs(d[4])))),
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
    R, o6 = _flange_in_base(geometry, position_M, rotation_M)
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


def _flange_in_base(geometry: Geometry, position_M: Array, rotation_M: Array) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and origins (n, 3) [m] of the flange in the base frame."""
    T = geometry.T_M_B()
    R = T[:3, :3].T @ rotation_M
    return R, (position_M - T[:3, 3]) @ T[:3, :3] - R @ geometry.tool


def _parallel_axes(chain: _Chain, R: Array, o6: Array, free: Array) -> Array:
    """Solve phi (n, 8, 6) of chains with parallel axes 2, 3 and 4; branches in order shoulder, wrist, elbow."""
    d, c, s = chain.d, chain.c, chain.s
    sense = c[1] * c[2]  # of axis 4 against axis 2
    z5 = R @ np.array([0.0, s[5], c[5]])
    o5 = o6 - d[5] * z5
    phi1 = _shoulder(chain, o5, d[1] + c[1] * d[2] + sense * (d[3] + d[4] * c[3]))[:, :, None]
    h = _axis_2(chain, phi1)
    cos5 = (c[3] * c[4] - sense * np.einsum("nija,na->nij", h, z5)) / (s[3] * s[4])
    phi5 = _arccos(cos5) * np.array([1.0, -1.0])
    # h in the frame before joint 6, and after it
    y, z = sense * np.cos(phi5) * s[3], sense * c[3]
    before = np.stack([sense * np.sin(phi5) * s[3], c[4] * y + s[4] * z], axis=-1)
    in_flange = np.einsum("nba,nijb->nija", R, h)
    after = np.stack([in_flange[..., 0], c[5] * in_flange[..., 1] - s[5] * in_flange[..., 2]], axis=-1)
    phi6 = _between(after, before, free[:, 5, None, None])
    R_04 = R[:, None, None] @ _turn(phi6, c[5], s[5]).swapaxes(-1, -2) @ _turn(phi5, c[4], s[4]).swapaxes(-1, -2)
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
    R_03 = R_1[:, :, None] @ _turn(phi2, c[1], s[1]) @ _turn(phi3, c[2], s[2])
    left = R_03.swapaxes(-1, -2) @ (R @ _rotation_x(c[5], -s[5]))[:, None, None]
    phi5 = _arccos((c[3] * c[4] - left[..., 2, 2]) / (s[3] * s[4]))[..., None] * np.array([1.0, -1.0])
    axis = np.stack([s[4] * np.sin(phi5), -c[3] * s[4] * np.cos(phi5) - s[3] * c[4]], axis=-1)
    phi4 = _between(axis, left[..., None, :2, 2], free[:, 3, None, None, None])
    of_6 = (_turn(phi4, c[3], s[3]) @ _turn(phi5, c[4], s[4])).swapaxes(-1, -2) @ left[..., None, :, :]
    phi6 = np.arctan2(of_6[..., 1, 0], of_6[..., 0, 0])
    parts = (phi1[:, :, None, None], phi2[..., None], phi3[..., None], phi4, phi5, phi6)
    return np.stack(np.broadcast_arrays(*parts), axis=-1).reshape(len(o6), 8, 6)


def _shoulder(chain: _Chain, point: Array, along: float) -> Array:
    """Solve both phi_1 (n, 2) with ``point`` (n, 3) at distance ``along`` [m] from frame 1 in direction of axis 2."""
    x, y, z = point.T
    k = (along - chain.c[0] * (z - chain.d[0])) / chain.s[0]
    up = 0.5 * np.pi - _arccos(k / np.maximum(np.hypot(x, y), 1e-300))[:, None]
    return np.asarray(np.arctan2(y, x)[:, None] + np.concatenate([up, np.pi - up], axis=1))


def _axis_2(chain: _Chain, phi1: Array) -> Array:
    """Direction h of axis 2 in the base frame, (..., 3)."""
    c, s = chain.c[0], chain.s[0]
    return np.stack([s * np.sin(phi1), -s * np.cos(phi1), np.full(phi1.shape, c)], axis=-1)


def _frame_1(chain: _Chain, phi1: Array) -> tuple[Array, Array]:
    """Rotations (..., 3, 3) and origins (..., 3) [m] of frame 1 in the base frame."""
    d, a = chain.d[0], chain.a[0]
    origin = np.stack([a * np.cos(phi1), a * np.sin(phi1), np.full(phi1.shape, d)], axis=-1)
    return _turn(phi1, chain.c[0], chain.s[0]), origin


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


def _turn(phi: Array, c: float, s: float) -> Array:
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
