"""Effects of tracker and target, against a tracker with errors of range and angles, and an inclined SMR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS
from tests.robot.effects.cell import by_name, context_of, shifts, slope

CONTEXT = context_of(10)


def columns(slug, law, context=CONTEXT):
    return by_name(EFFECTS[slug].columns(context, law))


def read(p, *, longer=0.0, stretched=0.0, azimuth=0.0, elevation=0.0):
    """Reading of a point (3,) by a tracker with errors of range and angles."""
    rho = np.linalg.norm(p) * (1.0 + stretched) + longer
    az, el = np.arctan2(p[1], p[0]) + azimuth, np.arcsin(p[2] / np.linalg.norm(p)) + elevation
    return rho * np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])


def misread(**errors):
    """Derivative (n, 3) of the reading by errors that depend on azimuth and elevation."""

    def of(p):
        az, el = np.arctan2(p[1], p[0]), np.arcsin(p[2] / np.linalg.norm(p))
        return slope(lambda h: read(p, **{k: h * error(az, el) for k, error in errors.items()}))

    return np.array([of(p) for p in CONTEXT.p_M])


def test_a_scale_stretches_all_distances():
    column = columns("tracker_scale", EFFECTS["tracker_scale"].law())["scale"]
    assert column.unit == "m/m"
    np.testing.assert_allclose(shifts(column), misread(stretched=lambda az, el: 1.0), atol=1e-9)


def test_a_scale_may_follow_the_air():
    law = next(law for law in EFFECTS["tracker_scale"].laws(CONTEXT) if law.name == "air")
    column = columns("tracker_scale", law)["scale_air"]
    air_c = CONTEXT.conditions.air_c
    assert air_c is not None
    assert column.unit == "1/K"
    np.testing.assert_allclose(shifts(column), (air_c - air_c.mean())[:, None] * CONTEXT.p_M, atol=1e-12)


def test_a_distance_offset_lengthens_all_distances():
    column = columns("tracker_distance_offset", EFFECTS["tracker_distance_offset"].law())["distance_offset"]
    assert column.unit == "m"
    np.testing.assert_allclose(shifts(column), misread(longer=lambda az, el: 1.0), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("wave", "function"), [("cos", np.cos), ("sin", np.sin)])
def test_angles_err_with_their_own_orders(order, wave, function):
    found = columns("tracker_angle_error", EFFECTS["tracker_angle_error"].law("orders"))
    column = found[f"azimuth_{wave}{order}"]
    assert column.block == f"azimuth {order}"
    np.testing.assert_allclose(shifts(column), misread(azimuth=lambda az, el: function(order * az)), atol=1e-9)
    column = found[f"elevation_{wave}{order}"]
    assert column.block == f"elevation {order}"
    np.testing.assert_allclose(shifts(column), misread(elevation=lambda az, el: function(order * el)), atol=1e-9)
    assert len(found) == 8


def looking(towards):
    """A context whose SMR faces, at its first stop, along ``towards`` (3,) of the tracker frame."""
    return replace(CONTEXT, smr_normal=CONTEXT.frames[0][-1][0].T @ towards)


def test_a_target_that_faces_the_tracker_has_no_error():
    back = -CONTEXT.p_M[0] / np.linalg.norm(CONTEXT.p_M[0])
    for column in columns("target_incidence", EFFECTS["target_incidence"].law("lateral"), looking(back)).values():
        np.testing.assert_allclose(shifts(column)[0], 0.0, atol=1e-12)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 50.0, 89.0])
def test_an_inclined_target_has_radial_and_lateral_errors(degrees):
    beam = CONTEXT.p_M[0] / np.linalg.norm(CONTEXT.p_M[0])
    aside = np.cross(beam, [0.3, -0.5, 0.8])
    aside /= np.linalg.norm(aside)
    angle = np.deg2rad(degrees)
    found = columns(
        "target_incidence",
        EFFECTS["target_incidence"].law("lateral"),
        looking(-np.cos(angle) * beam + np.sin(angle) * aside),
    )
    np.testing.assert_allclose(shifts(found["incidence_radial"])[0], (1.0 - np.cos(angle)) * beam, atol=1e-12)
    np.testing.assert_allclose(shifts(found["incidence_lateral"])[0], np.sin(angle) * aside, atol=1e-12)


def test_the_simplest_law_of_incidence_is_radial():
    assert list(columns("target_incidence", EFFECTS["target_incidence"].law("radial"))) == ["incidence_radial"]
    assert [law.name for law in EFFECTS["target_incidence"].laws(CONTEXT)] == ["radial", "lateral"]
