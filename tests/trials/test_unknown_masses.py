"""Elastic joints of an arm without masses take one name, whatever tool it carries."""

from __future__ import annotations

from tests.trials.unknown_masses import lines, named


def test_an_arm_without_masses_and_with_an_unknown_tool_gets_one_name_for_its_elastic_joints() -> None:
    found = named(12, "none", "iiwa with a tool")
    assert found.names == ("joint_compliance smooth",)
    assert found.after_mm < 0.2 * found.before_mm
    assert list(lines({"none": [found]}))[1].startswith("none | 1 of 1 | none | ")
