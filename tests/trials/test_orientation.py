"""The trials of orientation and of checks with a probe, with few stops and checks."""

from __future__ import annotations

from tests.trials.kinds import EFFECTS
from tests.trials.orientation import lines, trial
from tests.trials.probed_check import of_cell


def test_a_trial_says_names_errors_and_how_bounds_hold() -> None:
    found = trial(3, "6-D probe", 60)
    assert found["names"] == sorted(EFFECTS)
    assert found["orientation_mrad"] < 0.05
    assert 0.5 < found["true_within"] <= 1.0
    assert 0.5 < found["measured_within"] <= 1.0
    head, line = lines([found, {**found, "seed": 4, "names": ["backlash"], "orientation_mrad": 0.03}])
    assert head.startswith("kind | arms | exact | false")
    assert line.startswith("6-D probe | 2 | 1 | 1 | ")


def test_a_probe_shows_the_last_joints_to_a_check() -> None:
    probe, alone = (of_cell(kind, 7, 1, 1) for kind in ("6-D probe", "positions"))
    for joint in (5, 6):
        assert probe[f"zero of joint {joint}"].keys() <= {"named", "beside a rival"}
        assert alone[f"zero of joint {joint}"].keys().isdisjoint({"named", "beside a rival"})
    assert "arm changed" not in probe["unchanged"]
