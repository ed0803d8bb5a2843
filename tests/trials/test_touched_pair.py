"""The trial of pairs that are tied by touching, with few touches."""

from __future__ import annotations

import numpy as np
import pytest

from tests.trials import touched_pair
from tests.trials.touched_pair import Tied, lines, tied


@pytest.mark.parametrize("on_flange", [0, 14], ids=["common sockets", "a socket that the other arm carries"])
def test_a_pair_is_tied_and_judged(on_flange: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(touched_pair, "TOUCHES", 8)
    found = tied(1, 3, on_flange)
    assert np.abs(found.off_mm).max() < 0.5
    assert found.at_sockets_mm < found.nominal_mm
    assert (found.stated_mm > 0.0).all()


def test_the_table_counts_what_is_within_the_stated_uncertainty() -> None:
    one = Tied(np.array([0.1, 0.0, 0.3]), np.full(3, 0.1), 0.02, 1.0, 0.01)
    assert list(lines([one]))[1] == "0.183 | 0.100 | 0.667 | 0.0200 | 1.000 | 0.0100"
