"""The trial of touches with few checks."""

from __future__ import annotations

from tests.estimation.monitoring.check.conftest import one_ur5
from tests.trials.touches import changed, rates, unchanged


def test_few_checks_of_touches_are_counted() -> None:
    cell = one_ur5()
    assert unchanged(cell, 4, 0)["arm changed"] == 0
    assert changed(cell, 3, 3, 0, shift_rad=5e-4)["named"] >= 2
    lines = list(rates(cell, 1, 1, 0))
    assert [line.split(":")[0] for line in lines] == [
        "unchanged",
        *(f"zero of joint {joint} by 0.15 mrad" for joint in (2, 3, 4)),
    ]
