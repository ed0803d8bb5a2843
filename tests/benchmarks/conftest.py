"""Benchmarks compare on one BLAS thread: small problems gain nothing from more, and ratios stay ratios."""

from __future__ import annotations

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True)
def one_blas_thread():
    with threadpool_limits(limits=1):
        yield
