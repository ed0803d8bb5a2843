"""Formulas of ISO 9283 on numbers worked by hand, and what they must not depend on."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from cellapp.estimation.iso9283 import characteristics as iso
from cellapp.estimation.iso9283.characteristics import (
    CORNERS,
    CYCLE,
    PLANES,
    POSES,
    Cycles,
    accuracy_value,
    distance_values,
    lattice_cube,
    repeatability_value,
)
from cellapp.estimation.iso9283.coverage import NOT_ASKED, NOT_OFFERED, ONE_SMR, coverage, not_done
from cellapp.estimation.iso9283.records import (
    ArmIso9283,
    CommandedTests,
    IsoConditions,
    IsoLine,
    IsoValue,
    PoseCharacteristics,
)


def test_repeatability_is_the_mean_distance_and_three_deviations_of_it() -> None:
    # distances from the mean (0, 0, 0): 1, 1, 2, 2; their mean 1.5, S = sqrt(4 * 0.25 / 3) = 0.57735
    attained = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
    assert iso.pose_repeatability(attained) == pytest.approx(1.5 + 3.0 / math.sqrt(3.0))


def test_repeatability_of_one_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 cycles, not 1"):
        iso.pose_repeatability(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="at least 2 cycles"):
        iso.distance_repeatability(np.zeros((1, 3)), np.ones((1, 3)))


def test_variation_of_directions_is_the_largest_distance_of_their_means() -> None:
    each = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [[3.0, 0.0, 1.0]] * 2, [[0.0, 4.0, 0.0], [0.0, 4.0, 2.0]]])
    assert iso.directional_variation(each) == pytest.approx(5.0)


def test_distances_have_a_signed_accuracy_and_three_deviations() -> None:
    first = np.zeros((3, 3))
    second = np.array([[0.0, 0.0, 9.0], [8.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    assert iso.distance_accuracy(first, second, 9.5) == pytest.approx(-0.5)
    assert iso.distance_repeatability(first, second) == pytest.approx(3.0)


def test_drift_is_the_largest_change_against_the_first_group() -> None:
    assert iso.drift(np.array([0.2, 0.25, 0.05, 0.2])) == pytest.approx(0.15)


def test_a_path_is_as_bad_as_its_worst_place() -> None:
    commanded = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    attained = np.array([[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], [[1.0, 0.5, 0.0], [1.0, 0.5, 0.0]]])
    assert iso.path_accuracy(attained, commanded) == pytest.approx(0.5)
    assert iso.path_repeatability(attained) == pytest.approx(1.0)


def test_a_track_crosses_the_planes_of_its_own_stretch() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    track = np.stack([1.01 * np.cos(angle), 1.01 * np.sin(angle), np.zeros_like(angle)], axis=1)
    at = np.array([0.5, 2.0, 4.0])
    commanded = np.stack([np.cos(at), np.sin(at), np.zeros(3)], axis=1)
    tangents = np.stack([-np.sin(at), np.cos(at), np.zeros(3)], axis=1)
    crossed = iso.plane_crossings(track, commanded, tangents, 0.1)
    np.testing.assert_allclose(crossed, 1.01 * commanded, atol=2e-5)  # chords of half a degree
    assert np.isnan(iso.plane_crossings(track[:100], commanded, tangents, 0.1)[1:]).all()


def test_velocity_of_two_cycles_worked_by_hand() -> None:
    """Places 10 mm apart; 0.04, 0.05 s in the first cycle (250, 200 mm/s), 0.05, 0.05 s in the second."""
    times = np.array([[0.0, 0.04, 0.09], [1.0, 1.05, 1.10]])
    found = iso.speeds(times, np.array([0.0, 0.01, 0.02]))
    np.testing.assert_allclose(found, [[0.25, 0.2], [0.2, 0.2]])
    assert iso.velocity_accuracy(found, 0.25) == pytest.approx((0.225 + 0.2) / 2.0 / 0.25 - 1.0)
    assert iso.velocity_repeatability(found, 0.25) == pytest.approx(3.0 * 0.025 / math.sqrt(2.0) / 0.25)
    assert iso.velocity_fluctuation(found) == pytest.approx(0.05)


# -- The norm's cube: planes, poses, and the largest cube of a lattice -------------------------------------------------


def test_planes_are_the_four_that_hold_an_upper_edge_and_the_opposite_lower_one() -> None:
    assert sorted(CYCLE) == sorted(POSES)
    assert len({frozenset(plane) for plane in PLANES}) == len(PLANES)
    for plane in PLANES:
        first, second, third, fourth = (np.array(CORNERS[name]) for name in plane)
        np.testing.assert_array_equal(first, -third)
        np.testing.assert_array_equal(second, -fourth)
        assert first[2] == second[2] == 1


@given(arrays(np.bool_, (4, 5, 4)))
def test_the_lattice_cube_is_the_largest(held: NDArray[np.bool_]) -> None:
    found = lattice_cube(held)

    def fits(edge: int, corner: tuple[int, ...]) -> bool:
        part = held[tuple(slice(c, c + edge + 1) for c in corner)]
        return part.shape == (edge + 1,) * 3 and bool(part.all())

    places = list(itertools.product(*(range(n) for n in held.shape)))
    assert (found is None) == (not held.any())
    if found is not None:
        edge, corner = found
        assert fits(edge, corner)
        assert not any(fits(edge + 1, place) for place in places)


# -- What the norm asks for, done and not done, with the reason --------------------------------------------------------

CONDITIONS = IsoConditions(cycles=30, speed_share=0.5, dwell_s=1.0, averaging_s=1.0, commands=("nominal",))


def value(n: int) -> IsoValue:
    return IsoValue(value_mm=0.1, expanded_mm=0.02, n=n)


def posed(n: int, **more: object) -> ArmIso9283:
    pose = PoseCharacteristics(pose="P1", error_mm=(0.1, 0.0, 0.0), accuracy=value(n), repeatability=value(n))
    tests = {"nominal": CommandedTests(pose=(pose,))}
    return ArmIso9283.model_validate({"payload_kg": 0.3, "tests": tests, **more})


def line(lines: tuple[IsoLine, ...], words: str) -> IsoLine:
    (found,) = (one for one in lines if one.characteristic.startswith(words))
    return found


def test_every_characteristic_of_the_norm_has_a_line_and_a_reason() -> None:
    lines = coverage(["pose"], {"left": posed(30)}, CONDITIONS)
    assert [one.clause for one in lines if one.words == NOT_OFFERED] == [
        "7.4",
        "7.5",
        "7.7",
        "8.4",
        "8.5",
        "9",
        "10",
        "11",
    ]
    assert all(one.words for one in lines)
    assert line(lines, "pose accuracy") == IsoLine(
        clause="7.2",
        characteristic="pose accuracy AP, repeatability RP",
        arms=("left",),
        status="done",
        words="30 cycles, nominal commands",
    )
    assert line(lines, "distance accuracy").words == NOT_ASKED
    assert line(lines, "AP, RP of the orientation").words == ONE_SMR
    assert "AP, RP of the orientation" in not_done(lines)[ONE_SMR]
    assert "distance accuracy AD, repeatability RD" in not_done(lines)[NOT_ASKED]


def test_what_stopped_the_job_is_the_reason() -> None:
    arm = ArmIso9283(payload_kg=0.3)
    found = line(coverage(["pose"], {"left": arm}, CONDITIONS, "stopped: arm left: protective stop"), "pose accuracy")
    assert (found.status, found.words) == ("not done", "stopped: arm left: protective stop")


# -- Expanded uncertainties of the characteristics hold what they state ------------------------------------------------

SIGMA = 20e-6
"""Of a coordinate [m]."""
TRACKER = np.diag([4e-6, 15e-6, 15e-6]) ** 2
NOTHING = np.zeros((3, 3))
OFF = np.array([80e-6, -50e-6, 20e-6])


def cycles(rng: np.random.Generator, n: int, off: NDArray[np.float64] = OFF, sigma: float = SIGMA) -> Cycles:
    """Cycles at ``off`` from the commanded position, with one error of the tracker that all of them share."""
    shared = rng.multivariate_normal(np.zeros(3), TRACKER)
    return Cycles(off + shared + sigma * rng.standard_normal((n, 3)), np.zeros(3), TRACKER, NOTHING)


def covered(values: list[IsoValue], true_m: float) -> float:
    """Share of the values whose uncertainty holds the true one."""
    off = [abs(one.value_mm - true_m * 1e3) <= (one.expanded_mm or 0.0) for one in values]
    return float(np.mean(off))


@pytest.mark.parametrize("n", [5, 30])
def test_accuracy_holds_the_truth_in_95_of_100_tests(n: int) -> None:
    rng = np.random.default_rng(n)
    values = [accuracy_value(cycles(rng, n), rng) for _ in range(60)]
    assert covered(values, float(np.linalg.norm(OFF))) >= 0.88


def test_repeatability_and_distance_hold_the_truth() -> None:
    rng = np.random.default_rng(7)
    many = np.linalg.norm(SIGMA * rng.standard_normal((100_000, 3)), axis=1)
    repeatabilities = [repeatability_value(cycles(rng, 30), rng)[0] for _ in range(40)]
    assert covered(repeatabilities, float(many.mean() + 3.0 * many.std())) >= 0.88
    away = np.array([0.0, 0.5, 0.0])
    pairs = [(cycles(rng, 30, np.zeros(3)), cycles(rng, 30, away)) for _ in range(40)]
    pairs = [(one, Cycles(two.attained, away, TRACKER, NOTHING)) for one, two in pairs]
    found = [distance_values(one, two, rng) for one, two in pairs]
    assert covered([one[0] for one in found], 0.0) >= 0.88
    assert covered([one[1] for one in found], 3.0 * np.sqrt(2.0) * SIGMA) >= 0.88


def test_an_uncertain_base_makes_accuracy_uncertain_and_repeatability_not() -> None:
    rng = np.random.default_rng(3)
    known = cycles(rng, 30)
    unknown = Cycles(known.attained, known.commanded, TRACKER, 0.3e-3**2 * np.eye(3))
    first, second = (accuracy_value(one, np.random.default_rng(1)) for one in (known, unknown))
    assert (first.expanded_mm or 0.0) < 0.05
    assert 0.3 < (second.expanded_mm or 0.0) < 1.0
    assert repeatability_value(known, np.random.default_rng(1)) == repeatability_value(
        unknown, np.random.default_rng(1)
    )
