"""Two arms tied by sockets that one of them carries: truth, intervals, what is not seen, and wrong names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.calibration.pair_on_flange import (
    FlangeFit,
    FlangeRows,
    doubtful_touches,
    fit_on_flange,
    tie_on_flange,
)
from cellapp.robot.kinematics.transforms import apply, invert, rotation_zyx, transform

pytestmark = pytest.mark.fast
TRUE = transform(rotation_zyx(0.4, -0.1, 0.2), [1.2, -0.3, 0.1])
START = transform(rotation_zyx(0.5, 0.0, 0.1), [1.1, -0.2, 0.0])
SOCKETS_F = np.array([[0.03, -0.06, 0.05], [-0.05, 0.02, 0.08]])
SCATTER_M = 2e-5


def touches(
    seed: int,
    count: int = 40,
    scatter_m: float = SCATTER_M,
    turn_rad: float = 2.0,
    carriers: tuple[bool, ...] = (True,),
) -> FlangeRows:
    """Touches of both sockets in turn; ``carriers`` says which arms have them."""
    rng = np.random.default_rng(seed)
    rotation = np.array([rotation_zyx(*rng.uniform(-turn_rad, turn_rad, 3)) for _ in range(count)])
    origin, socket = rng.uniform(-0.6, 0.6, (count, 3)), np.arange(count) % len(SOCKETS_F)
    on_right = np.resize(np.array(carriers), count)
    exact = with_exact_balls(FlangeRows(socket, on_right, origin, rotation, origin))
    return replace(exact, ball=exact.ball + scatter_m * rng.standard_normal((count, 3)))


def with_exact_balls(rows: FlangeRows) -> FlangeRows:
    """The touches with the balls where the sockets are."""
    carried = rows.origin + np.einsum("nab,nb->na", rows.rotation, SOCKETS_F[rows.socket])
    ball = np.where(rows.on_right[:, None], apply(np.asarray(invert(TRUE)), carried), apply(TRUE, carried))
    return replace(rows, ball=ball)


@pytest.mark.parametrize("carriers", [(True,), (False,), (True, True, False)], ids=["right", "left", "both"])
def test_exact_touches_give_the_tie_and_the_sockets(carriers: tuple[bool, ...]) -> None:
    rows = touches(1, scatter_m=0.0, carriers=carriers)
    if len(carriers) > 1:  # a socket on each flange
        rows = with_exact_balls(replace(rows, socket=np.where(rows.on_right, 0, 1)))
    fit = fit_on_flange(rows, START)
    assert fit is not None
    np.testing.assert_allclose(fit.sockets_F, SOCKETS_F, atol=1e-9)
    found = tie_on_flange(rows, fit)
    np.testing.assert_allclose(found.identification.T_R_L, TRUE, atol=1e-9)
    assert found.held_out
    assert found.errors_m.max() < 1e-9


def test_standard_errors_are_what_the_tie_is_off_by() -> None:
    off = []
    for seed in range(30):
        rows = touches(100 + seed)
        fit = fit_on_flange(rows, START)
        assert fit is not None
        found = tie_on_flange(rows, fit)
        off.append((found.identification.T_R_L[:3, 3] - TRUE[:3, 3]) / found.identification.standard_errors[:3])
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.25


def test_what_both_arms_are_uncertain_by_widens_the_tie() -> None:
    rows = touches(3)
    common = np.tile(1e-4 * np.eye(3), (len(rows.socket), 1))
    fit = fit_on_flange(rows, START)
    assert fit is not None
    plain, widened = (tie_on_flange(rows, fit, moved) for moved in (None, common))
    assert (widened.identification.standard_errors[:3] > 3.0 * plain.identification.standard_errors[:3]).all()


def test_too_few_touches_or_flanges_that_never_turn_leave_the_tie_open() -> None:
    assert fit_on_flange(touches(4, count=4), START) is None
    assert fit_on_flange(touches(4, turn_rad=0.0), START) is None


def test_a_fit_to_four_touches_is_tied_though_a_fold_is_empty() -> None:
    rows = touches(6, count=4, scatter_m=0.0)
    rows = with_exact_balls(replace(rows, socket=np.zeros(4, dtype=np.intp)))
    fit = fit_on_flange(rows, START)
    assert fit is not None
    found = tie_on_flange(rows, fit)
    assert not found.held_out
    np.testing.assert_allclose(found.identification.T_R_L, TRUE, atol=1e-9)


def test_touches_with_another_name_lie_far_off() -> None:
    rows = touches(5)
    wrong = rows.socket.copy()
    wrong[[7, 20]] = 1 - wrong[[7, 20]]
    off_m = doubtful_touches(replace(rows, socket=wrong), START)
    assert off_m is not None
    assert set(np.flatnonzero(off_m > 0.03).tolist()) == {7, 20}


@pytest.mark.parametrize("seed", range(5))
def test_from_a_start_that_is_far_off_the_tie_is_no_worse_than_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    far = transform(rotation_zyx(*rng.normal(0.0, 1.0, 3)) @ TRUE[:3, :3], TRUE[:3, 3] + rng.normal(0.0, 0.3, 3))
    rows = touches(seed)
    found = fit_on_flange(rows, far)
    assert found is not None
    r, start = (rows.linearised(one)[0] for one in (found, FlangeFit(far, np.zeros((2, 3)))))
    assert r @ r <= start @ start
