"""Elastic joints of an arm without masses take one name."""

from __future__ import annotations

from tests.trials.unknown_masses import lines, named


def test_an_arm_without_masses_gets_one_name_for_its_elastic_joints() -> None:
    found = named(1, "none")
    assert found.names == ("joint_compliance smooth",)
    assert found.after_mm < 0.5 * found.before_mm
    assert list(lines({"none": [found]}))[1].startswith("none | 1 of 1 | none | ")
