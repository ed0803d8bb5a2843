"""Stations tied by reference nests: the truth is found, with the uncertainty that is stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.estimation.calibration.station_location import NestPoint, TooFewNests, tie_stations
from cellapp.robot.kinematics.transforms import apply, invert, transform

SIGMA = 2e-5
TRUE = {
    "north": np.eye(4),
    "south": transform(Rotation.from_euler("z", 2.0).as_matrix(), [3.0, 1.0, 0.1]),
    "west": transform(Rotation.from_euler("zx", [-1.0, 0.02]).as_matrix(), [-2.0, 2.0, 0.0]),
}


def points(seed: int, seen: dict[str, range], sigma: float = SIGMA) -> list[NestPoint]:
    rng = np.random.default_rng(seed)
    nests = np.random.default_rng(0).uniform(-2.5, 2.5, (8, 3))
    return [
        NestPoint(name, f"F{k}", apply(invert(TRUE[name]), nests[k : k + 1])[0] + sigma * rng.standard_normal(3), SIGMA)
        for name, numbers in seen.items()
        for k in numbers
    ]


def test_exact_points_give_the_true_poses() -> None:
    seen = {"north": range(5), "south": range(2, 7), "west": range(4, 8)}
    ties = tie_stations("north", points(0, seen, sigma=0.0))
    assert list(ties) == ["south", "west"]
    for name, tie in ties.items():
        np.testing.assert_allclose(tie.T, TRUE[name], atol=1e-9)
        assert tie.residual_m.max() < 1e-9
    assert ties["west"].nests == ("F4", "F5", "F6")


def test_the_uncertainty_at_a_point_is_the_stated_one() -> None:
    far = np.array([[1.0, 0.5, 0.2]])
    off, stated = [], []
    for seed in range(200):
        tie = tie_stations("north", points(seed, {"north": range(6), "south": range(6)}))["south"]
        moved = apply(tie.T @ invert(TRUE["south"]), far) - far
        off.append(moved[0])
        stated.append(float(tie.uncertainty(far)[0]))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean(stated), rel=0.15)


@pytest.mark.parametrize("seen", [{"north": range(2), "south": range(4)}, {"north": range(3), "south": range(4, 8)}])
def test_a_station_that_is_not_tied_is_named(seen: dict[str, range]) -> None:
    with pytest.raises(TooFewNests, match="station south shares fewer than 3 nests"):
        tie_stations("north", points(0, seen))
