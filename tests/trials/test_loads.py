"""The trial of loads, with few stops."""

from __future__ import annotations

import numpy as np

from tests.trials.kinds import Bench
from tests.trials.loads import LAWS, LOADS_KG, Found, arm, lines, measured, predicted


def test_an_arm_of_two_loads_is_predicted_at_a_third() -> None:
    found = predicted(Bench(2, 60), "straight", LOADS_KG)
    assert found.rms_mm < 0.05
    assert found.within > 0.6
    assert list(lines({"straight, 0.3 kg": [found]}))[1].startswith("straight, 0.3 kg | 0.0")


def test_each_arm_has_its_law_and_readings_have_their_loads() -> None:
    bench = Bench(3, 40)
    profiles = {law: arm(bench, law) for law in LAWS}
    laws = [profile.plant.effects["left"]["joint_compliance"] for profile in profiles.values() if profile.plant]
    assert [one.get("law") for one in laws] == [None, "stiffening", None]
    assert laws[0]["stiffness"] == laws[1]["stiffness"]
    its = measured(bench, profiles["straight"], LOADS_KG)
    assert its.payload_kg is not None
    np.testing.assert_array_equal(its.payload_kg, np.resize(LOADS_KG, 40))


def test_the_table_has_medians_and_the_worst_arm() -> None:
    table = list(lines({"a": [Found(0.1, 0.2, 1.0), Found(0.3, 0.2, 0.8), Found(0.2, 0.3, 0.9)]}))
    assert table[1] == "a | 0.200 | 0.200 | 0.900 | 0.800 | 3"
