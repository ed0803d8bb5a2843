"""Characteristics of ISO 9283 are judged with their uncertainties as the rule says."""

from __future__ import annotations

import pytest

from cellapp.commands.certificate.iso9283_judgements import judge_characteristics
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, IsoValue, PoseCharacteristics
from cellapp.ground.profile.sections import Tolerances

pytestmark = pytest.mark.fast


def arm(accuracy_mm: float, expanded_mm: float | None, n: int) -> ArmIso9283:
    value = IsoValue(value_mm=accuracy_mm, expanded_mm=expanded_mm, n=n)
    small = IsoValue(value_mm=0.01, expanded_mm=0.001, n=n)
    poses = tuple(
        PoseCharacteristics(pose=name, error_mm=(0.0, 0.0, 0.0), accuracy=one, repeatability=small, deviations_mm=())
        for name, one in (("P1", small), ("P2", value))
    )
    nominal = PoseCharacteristics(
        pose="P1",
        error_mm=(9.0, 0.0, 0.0),
        accuracy=IsoValue(value_mm=9.0, expanded_mm=0.1, n=n),
        repeatability=small,
        deviations_mm=(),
    )
    return ArmIso9283(
        payload_kg=0.3, tests={"nominal": CommandedTests(pose=(nominal,)), "calibrated": CommandedTests(pose=poses)}
    )


@pytest.mark.parametrize(
    ("value", "expanded", "verdict"),
    [
        (0.05, 0.04, "conforms"),
        (0.08, 0.04, "cannot say"),
        (0.15, 0.04, "does not conform"),
        (0.05, None, "cannot say"),
    ],
)
def test_the_worst_pose_as_left_is_judged(value: float, expanded: float | None, verdict: str) -> None:
    tolerances = Tolerances(pose_accuracy=0.1e-3)
    (found,) = judge_characteristics(tolerances, {"left": arm(value, expanded, 30)}, (), 30)
    assert (found.characteristic, found.where, found.value_mm) == ("pose_accuracy", "left", value)
    assert found.conformity == verdict
    assert found.source == "ISO 9283, P2, calibrated commands, 30 cycles"


def test_too_few_cycles_are_not_judged_unless_fewer_were_asked_for() -> None:
    tolerances = Tolerances(pose_accuracy=0.1e-3, pose_repeatability=0.1e-3)
    of_27 = {"left": arm(0.05, 0.01, 27)}
    for one in judge_characteristics(tolerances, of_27, (), 30):
        assert (one.conformity, one.n) == ("cannot say", 27)
        assert one.source.endswith("27 of 30 cycles, too few to judge")
    for one in judge_characteristics(tolerances, of_27, (), 27):
        assert one.conformity == "conforms"
        assert one.source.endswith("27 of 30 cycles")
