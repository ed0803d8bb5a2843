"""Hidden effects of the tracker and its target: scale, zero, circles, axes, glass."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES

P = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 3)) * [2.0, 2.0, 1.0] + [0.0, 3.0, 0.2]
NO_CIRCLE = [0.0, 0.0, 0.0, 0.0]


SITUATION: Any = SimpleNamespace()
"""These effects do not depend on the situation."""


def _apparent(name, values, p_M=P, normal_M=None):
    effect = FACTORIES[name](Parameters("left", name, values, 6))
    normal_M = -p_M / np.linalg.norm(p_M, axis=1, keepdims=True) if normal_M is None else normal_M
    return effect.apparent_position(p_M, normal_M, SITUATION)


def _angles(p_M):
    return np.stack([np.arctan2(p_M[:, 1], p_M[:, 0]), np.arctan2(p_M[:, 2], np.hypot(p_M[:, 0], p_M[:, 1]))])


def _distance(p_M):
    return np.linalg.norm(p_M, axis=1)


def test_wrong_air_makes_all_distances_longer_by_the_same_share():
    assert _distance(_apparent("tracker_scale", {"ppm": 5.0})) == pytest.approx(_distance(P) * (1 + 5e-6), rel=1e-14)
    assert _angles(_apparent("tracker_scale", {"ppm": -5.0})) == pytest.approx(_angles(P), abs=1e-14)


def test_a_wrong_zero_makes_all_distances_longer_by_the_same_length():
    seen = _apparent("tracker_distance_offset", {"offset": -2e-5})
    assert _distance(seen) - _distance(P) == pytest.approx(np.full(30, -2e-5), abs=1e-14)
    assert _angles(seen) == pytest.approx(_angles(P), abs=1e-14)


def test_a_perfect_instrument_has_no_error():
    values = {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": 0.0}
    assert np.abs(_apparent("tracker_angle_error", values) - P).max() < 1e-14


@pytest.mark.parametrize("axis", [0, 1])
def test_an_eccentric_circle_is_read_once_a_turn_and_a_slanted_one_twice(axis):
    key = ("azimuth", "elevation")[axis]
    clean = {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": 0.0}
    angle = _angles(P)[axis]
    for circle, expected in (
        ([1e-5, 0.3, 0.0, 0.0], 1e-5 * np.sin(angle + 0.3)),
        ([0.0, 0.0, 8e-3, 0.7], 8e-3**2 / 4 * np.sin(2 * (angle + 0.7))),
    ):
        seen = _apparent("tracker_angle_error", clean | {key: circle})
        assert _angles(seen)[axis] - angle == pytest.approx(expected, abs=2e-9)
        assert _angles(seen)[1 - axis] == pytest.approx(_angles(P)[1 - axis], abs=1e-14)
        assert _distance(seen) == pytest.approx(_distance(P), rel=1e-14)


def test_circle_readings_of_an_eccentric_disc_satisfy_its_triangle():
    """The head's direction from the centre of the disc equals the reading, for any eccentricity."""
    e, phase = 0.2, 0.4
    azimuth = _angles(P)[0]
    seen = _angles(
        _apparent("tracker_angle_error", {"azimuth": [e, phase, 0, 0], "elevation": NO_CIRCLE, "transit": 0.0})
    )[0]
    centre = e * np.stack([np.cos(azimuth + phase), np.sin(azimuth + phase)])
    head = np.array([[1.0], [0.0]]) - centre
    assert np.exp(1j * (seen - azimuth)) == pytest.approx(np.exp(-1j * np.arctan2(head[1], head[0])))


def test_a_slanted_transit_axis_points_where_its_readings_turn_it():
    slant = 0.05
    seen = _apparent("tracker_angle_error", {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": slant})
    azimuth, elevation = _angles(seen)
    # turn the beam up about the level axis, slant that axis about the beam's level direction, turn to the azimuth
    beam = np.stack([np.cos(elevation), np.zeros(30), np.sin(elevation)])
    c, s = np.cos(slant), np.sin(slant)
    beam = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ beam
    x, y = np.cos(azimuth) * beam[0] - np.sin(azimuth) * beam[1], np.sin(azimuth) * beam[0] + np.cos(azimuth) * beam[1]
    assert np.abs(np.stack([x, y, beam[2]], axis=1) * _distance(P)[:, None] - P).max() < 1e-14


def test_a_slanted_transit_axis_shows_with_the_elevation():
    seen = _apparent("tracker_angle_error", {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": 1e-5})
    azimuth, elevation = _angles(P)
    assert _angles(seen)[0] - azimuth == pytest.approx(1e-5 * np.tan(elevation), abs=1e-9)


GLASS = {"thickness": 3e-4, "index": 1.51, "dihedral": 0.0}


def _turned(angle, about):
    """Normals that look to the tracker and are then turned away by ``angle`` (n,) towards ``about`` (n, 3)."""
    back = -P / _distance(P)[:, None]
    side = np.cross(back, about)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.cos(angle)[:, None] * back + np.sin(angle)[:, None] * side


def test_looked_at_squarely_glass_and_angles_show_nothing():
    assert np.abs(_apparent("target_incidence", GLASS | {"dihedral": 1e-5}) - P).max() < 1e-14


def test_the_path_through_the_glass_follows_snells_law():
    angle = np.linspace(0.0, 1.0, 30)
    seen = _apparent("target_incidence", GLASS, normal_M=_turned(angle, np.array([0.0, 0.0, 1.0])))
    inside = np.arcsin(np.sin(angle) / 1.51)
    # path in the glass, its part along the beam's way in air taken off (optical), against the square one
    path = 3e-4 * (1.51 / np.cos(inside) - np.cos(angle - inside) / np.cos(inside))
    assert _distance(seen) - _distance(P) == pytest.approx(path - 3e-4 * 0.51, abs=1e-12)
    assert (np.diff(_distance(seen) - _distance(P)) > 0.0).all()
    assert _angles(seen) == pytest.approx(_angles(P), abs=1e-14)
    other_side = _apparent("target_incidence", GLASS, normal_M=_turned(angle, np.array([0.0, 1.0, 0.3])))
    assert _distance(other_side) == pytest.approx(_distance(seen), abs=1e-14)


def test_a_dihedral_error_deflects_the_beam_in_proportion_to_distance():
    angle = np.linspace(0.0, 0.6, 30)
    normal = _turned(angle, np.array([0.0, 0.0, 1.0]))
    moved = _apparent("target_incidence", GLASS | {"thickness": 0.0, "dihedral": 2e-6}, normal_M=normal) - P
    assert np.linalg.norm(moved, axis=1) == pytest.approx(2e-6 * _distance(P) * np.sin(angle), abs=1e-14)
    assert np.abs((moved * P).sum(axis=1)).max() < 1e-14


def test_in_the_cell_the_tracker_sees_the_arm_through_them(make_arm, make_plant):
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    effects = {"tracker_scale": {"ppm": 10.0}, "tracker_distance_offset": {"offset": 3e-5}}
    plant, ideal = make_plant(make_arm(effects=effects)), make_plant()
    p_M = ideal.smr_positions("left", q)
    moved = plant.smr_positions("left", q) - p_M
    along = p_M / _distance(p_M)[:, None]
    assert np.abs(moved - along * (1e-5 * _distance(p_M) + 3e-5)[:, None]).max() < 1e-9
    live = plant.targets()[0].p_M - ideal.targets()[0].p_M
    assert np.linalg.norm(live) == pytest.approx(1e-5 * np.linalg.norm(ideal.targets()[0].p_M) + 3e-5, rel=1e-4)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"tracker_scale": {"ppm": "5"}}, "ppm must be a number in SI units, not '5'"),
        (
            {"tracker_distance_offset": {"offset_m": 1e-5}},
            "unknown parameter 'offset_m'; its parameters are offset",
        ),
        (
            {"tracker_angle_error": {"azimuth": [1e-5], "elevation": NO_CIRCLE, "transit": 0.0}},
            "azimuth must be a list of 4 numbers",
        ),
        (
            {"tracker_angle_error": {"azimuth": NO_CIRCLE, "elevation": [-1e-5, 0, 0, 0], "transit": 0.0}},
            "elevation must have eccentric and slant, its first and third, from 0 to less than 1",
        ),
        (
            {"tracker_angle_error": {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": 1.0}},
            "transit must be a small angle, less than 0.1 rad, not 1",
        ),
        ({"target_incidence": GLASS | {"index": 0.9}}, "index must be at least 1, not 0.9"),
        ({"target_incidence": GLASS | {"thickness": -1e-3}}, "thickness must be at least 0"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(make_arm, make_plant, effects, message):
    with pytest.raises(ValueError, match=f"arm left, effect {next(iter(effects))}: .*{message}"):
        make_plant(make_arm(effects=effects))
