"""First-order lags of joints along a path."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array


def lagging(q: Array, keep: Array) -> Array:
    """Return positions (n, N) on an even time grid behind first-order lags, each at rest before the first position;
    ``keep`` (N,) is the share of the distance that remains after one step."""
    from scipy.signal import lfilter  # it loads scipy.stats: only for cells that record motion

    lags = zip(q.T, keep.tolist(), strict=True)
    return np.column_stack([lfilter([1.0 - left], [1.0, -left], own, zi=left * own[:1])[0] for own, left in lags])
