"""What the norm asks for, done and not done, with the reason."""

from __future__ import annotations

import pytest

from cellapp.estimation.iso9283.coverage import NOT_ASKED, NOT_OFFERED, ONE_SMR, coverage, not_done
from cellapp.estimation.iso9283.norm import IsoTest
from cellapp.estimation.iso9283.records import (
    ArmIso9283,
    CommandedTests,
    DriftCharacteristics,
    IsoConditions,
    IsoLine,
    IsoValue,
    PoseCharacteristics,
)

CONDITIONS = IsoConditions(cycles=30, speed_share=0.5, dwell_s=1.0, averaging_s=1.0, commands=("nominal",))


def value(n: int) -> IsoValue:
    return IsoValue(value_mm=0.1, expanded_mm=0.02, n=n)


def posed(n: int, **more: object) -> ArmIso9283:
    pose = PoseCharacteristics(
        pose="P1", error_mm=(0.1, 0.0, 0.0), accuracy=value(n), repeatability=value(n), deviations_mm=()
    )
    tests = {"nominal": CommandedTests(pose=(pose,))}
    return ArmIso9283.model_validate({"payload_kg": 0.3, "tests": tests, **more})


def line(lines: tuple[IsoLine, ...], words: str) -> IsoLine:
    (found,) = (one for one in lines if one.characteristic.startswith(words))
    return found


@pytest.mark.fast
def test_every_characteristic_of_the_norm_has_a_line_and_a_reason() -> None:
    lines = coverage(["pose"], {"left": posed(30)}, CONDITIONS)
    assert [one.clause for one in lines if one.words == NOT_OFFERED] == [
        "7.4",
        "7.5",
        "7.7",
        "8.4",
        "8.5",
        "9",
        "10",
        "11",
    ]
    assert all(one.words for one in lines)
    assert line(lines, "pose accuracy") == IsoLine(
        clause="7.2",
        characteristic="pose accuracy AP, repeatability RP",
        arms=("left",),
        status="done",
        words="30 cycles, nominal commands",
    )
    assert line(lines, "distance accuracy").words == NOT_ASKED
    assert line(lines, "AP, RP of the orientation").words == ONE_SMR
    assert "AP, RP of the orientation" in not_done(lines)[ONE_SMR]
    assert "distance accuracy AD, repeatability RD" in not_done(lines)[NOT_ASKED]


@pytest.mark.fast
@pytest.mark.parametrize(
    ("n", "stopped", "status", "words"),
    [(5, "", "in part", "5 of 30 cycles"), (30, "", "done", "30 cycles")],
)
def test_fewer_cycles_than_the_norms_are_a_part(n: int, stopped: str, status: str, words: str) -> None:
    found = line(coverage(["pose"], {"left": posed(n)}, CONDITIONS, stopped), "pose accuracy")
    assert found.status == status
    assert found.words.startswith(words)


@pytest.mark.fast
def test_arms_that_differ_have_lines_of_their_own() -> None:
    reason = "this tracker's driver cannot measure a moving SMR"
    tests: list[IsoTest] = ["pose", "path"]
    arms = {"left": posed(30), "right": posed(30, refused={"path": reason})}
    lines = [one for one in coverage(tests, arms, CONDITIONS) if one.characteristic.startswith("path accuracy AT")]
    assert [(one.arms, one.status) for one in lines] == [(("left",), "not done"), (("right",), "not done")]
    assert lines[1].words == reason
    assert len([one for one in coverage(tests, arms, CONDITIONS) if one.clause == "7.2.3"]) == 1


@pytest.mark.fast
def test_what_stopped_the_job_is_the_reason() -> None:
    arm = ArmIso9283(payload_kg=0.3)
    found = line(coverage(["pose"], {"left": arm}, CONDITIONS, "stopped: arm left: protective stop"), "pose accuracy")
    assert (found.status, found.words) == ("not done", "stopped: arm left: protective stop")


@pytest.mark.fast
def test_a_short_drift_test_is_a_part() -> None:
    drift = DriftCharacteristics(
        pose="P1", minutes=60.0, accuracy=value(10), repeatability=value(10), shift_mm=0.0, groups=()
    )
    arm = ArmIso9283(payload_kg=0.3, tests={"nominal": CommandedTests(drift=drift)})
    found = line(coverage(["drift"], {"left": arm}, CONDITIONS), "drift")
    assert (found.status, found.words) == ("in part", "10 cycles a group, over 60 of 480 min, nominal commands")


@pytest.mark.fast
def test_speeds_and_loads_that_were_not_tested_are_named() -> None:
    lines = coverage(["pose"], {"left": posed(30)}, CONDITIONS)
    assert line(lines, "speeds").words == "50% of the profile's speed; 100%, 10%: not asked for"
    assert "profiles state no rated load" in line(lines, "rated load").words
