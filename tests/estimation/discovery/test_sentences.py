"""Structure tests in words."""

from __future__ import annotations

import pytest

from cellapp.estimation.discovery.verdict import remaining_structure

pytestmark = pytest.mark.fast


def test_structure_counts_where_it_survives_the_number_of_tests() -> None:
    found = remaining_structure({"joints": 0.2, "order": 0.004, "time": 1e-6}, chance=0.01)
    assert found.sentence == "what is left still depends on time (p below 0.001)"
    assert [(test.against, test.p_value) for test in found.tests] == [("joints", 0.2), ("order", 0.004), ("time", 1e-6)]
    both = remaining_structure({"order": 0.004, "approach": 0.005}, chance=0.01)
    assert both.sentence == "what is left still depends on the order of the readings (p = 0.004) and the side of" + (
        " approach (p = 0.005)"
    )


def test_no_structure_names_what_was_tested() -> None:
    found = remaining_structure({"joints": 0.2, "position": 0.3}, chance=0.01)
    assert found.sentence == (
        "what is left shows no structure against the joint angles and the position in the workspace (smallest p = 0.2)"
    )
    assert remaining_structure({}, chance=0.01).tests == ()
