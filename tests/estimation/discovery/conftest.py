"""One plan of the simulated cell for all tests of this folder that name its effects."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from tests.twin import PROFILES


@pytest.fixture(scope="session")
def plan() -> dict[str, np.ndarray]:
    """The stops of ``profiles/twin.yaml``; planning is tested elsewhere. No test may write to them."""
    return plan_stops(load_profile(PROFILES / "twin.yaml"))
