"""Check that points determine a work frame; arrays only."""

from __future__ import annotations

import numpy as np

from cellapp.robot.kinematics.transforms import Array, apply, register

_LARGEST_M = 0.005
"""Largest disagreement of distances [m]: fixtures fit drawings better; more means swapped points or wrong units."""
_NARROWEST = 0.01
"""Smallest width of the points across their line, relative to their length. With a smaller one, noise rotates the frame
by more than a hundred times the angle that it rotates an equilateral one."""


def three_points(origin: Array, x: Array, xy: Array) -> Array:
    """Return the coordinates (3, 3) [m] of three measured points in the frame that they determine.

    ``origin`` is its origin, ``x`` is on its positive x axis, ``xy`` in its x-y plane with a positive y.
    """
    along, across = x - origin, xy - origin
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0.0 else along
    part = float(across @ axis)
    width = float(np.linalg.norm(across - part * axis))
    return np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], [part, width, 0.0]])


def frame_fault(nominal: Array, measured: Array) -> str:
    """Return why points (n, 3) [m] do not determine a frame, or differ between both sets; empty if all is well."""
    for points, which in ((nominal, "nominal"), (measured, "measured")):
        length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[:2]
        if width <= _NARROWEST * length:
            return (
                f"the {which} points lie on one line, so that the frame can turn about it; give a point at least"
                f" {_NARROWEST:.0%} of their distance off that line"
            )
    return _disagreement(nominal, measured) or _reflection(nominal, measured)


# -- inside -----------------------------------------------------------------------------------------------------------


def _disagreement(nominal: Array, measured: Array) -> str:
    """Report the point whose distances from the others differ most, if they differ by too much."""
    between_nominal, between_measured = _distances(nominal), _distances(measured)
    off = np.abs(between_measured - between_nominal)
    if off.max() <= _LARGEST_M:
        return ""
    worst = int(np.argmax(off.sum(axis=1)))
    other = int(np.argmax(off[worst]))
    return (
        f"point {worst + 1} is {between_nominal[worst, other] * 1e3:.3f} mm from point {other + 1} by its nominal"
        f" coordinates and {between_measured[worst, other] * 1e3:.3f} mm as measured, {off[worst, other] * 1e3:.3f} mm"
        f" apart; expected at most {_LARGEST_M * 1e3:g} mm: check the order of the points and their units"
    )


def _reflection(nominal: Array, measured: Array) -> str:
    """Report mirrored points: their distances agree, but no rigid motion maps one set to the other."""
    left = np.linalg.norm(measured - apply(register(measured, nominal), nominal), axis=1)
    worst = int(np.argmax(left))
    if left[worst] <= _LARGEST_M:
        return ""
    return (
        f"the measured points are the mirror image of the nominal ones: point {worst + 1} stays"
        f" {left[worst] * 1e3:.3f} mm off; give both in right-handed coordinates"
    )


def _distances(points: Array) -> Array:
    """Return the distances (n, n) [m] between points (n, 3) [m]."""
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))
