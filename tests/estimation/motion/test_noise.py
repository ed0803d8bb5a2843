"""What residuals are worth stays finite where a fit leaves nothing of them."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.motion.observe import bands_of, noise_model

pytestmark = pytest.mark.fast


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4])
def test_a_recording_whose_residuals_vanish_is_not_worth_without_bound(size: float) -> None:
    rng = np.random.default_rng(4)
    X = rng.normal(size=(60, 3, 12))
    fitted = rng.normal(size=12)
    r = X @ fitted + size * rng.normal(size=(60, 3))
    bands = bands_of(X, np.arange(12), r, in_time=True)
    A, b = bands.gram.sum(axis=0), bands.product.sum(axis=0)
    found = noise_model([bands], [1.0], np.linalg.solve(A, b), np.zeros(12), A)
    (level,) = found.level
    assert max(size**2 * 0.2, 1e-6) <= level <= max(size**2 * 5.0, 1e-6)
    assert np.isfinite(found.covariance).all()
    assert (np.diag(found.covariance) >= 0.0).all()
