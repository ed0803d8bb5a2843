"""What a person did at the arms, in tables and sentences."""

from __future__ import annotations

import pytest

from cellapp.commands.iso9283.view import view
from cellapp.commands.view.table import Table
from cellapp.estimation.iso9283.records import (
    ArmIso9283,
    CommandedTests,
    ComplianceCharacteristics,
    ForceStep,
    Iso9283Result,
    IsoValue,
    LoadSeries,
    PersonStep,
    PoseCharacteristics,
    WeavingCharacteristics,
)

pytestmark = pytest.mark.fast
_VALUE = IsoValue(value_mm=0.05, expanded_mm=0.02, n=3)


def _result(*, simulated: bool) -> Iso9283Result:
    pose = PoseCharacteristics(
        pose="P1", error_mm=(0.05, 0.0, 0.0), accuracy=_VALUE, repeatability=_VALUE, deviations_mm=((0.05, 0.0, 0.0),)
    )
    yields = ComplianceCharacteristics(
        pose="P1",
        direction="-z",
        compliance_um_n=20.0,
        expanded_um_n=0.5,
        left_mm=0.001,
        steps=(
            ForceStep(force_n=25.0, displacement_mm=(0.0, 0.0, -0.5)),
            ForceStep(force_n=50.0, displacement_mm=(0.0, 0.0, -1.0)),
        ),
        n=3,
    )
    weaving = WeavingCharacteristics(
        stroke_mm=30.0, frequency_hz=0.7, speed_mm_s=50.0, waves=4, stroke_percent=-1.5, stroke_expanded_percent=0.3,
        frequency_percent=-4.0, frequency_expanded_percent=0.4, n=3, slowed="at 385 mm joint 1 allows 32 mm/s",
    )  # fmt: skip
    tests = CommandedTests(
        loads=(LoadSeries(payload_kg=4.0, pose=(pose,)),), weaving=weaving, compliance=(yields,)
    )  # fmt: skip
    arm = ArmIso9283(payload_kg=0.3, tests={"calibrated": tests})
    step = PersonStep(words="arm left: hang 4 kg", time_s=12.0, simulated=simulated)
    return Iso9283Result(tests=("pose", "path", "compliance"), arms={"left": arm}, by_person=(step,))


def test_loads_forces_and_weaving_stand_in_tables() -> None:
    result = _result(simulated=False)
    assert Iso9283Result.from_json(result.to_json(), "test") == result
    tables = {one.title: one for one in view(result).parts if isinstance(one, Table)}
    (loaded,) = tables["Pose accuracy AP and repeatability RP with other loads [mm]"].rows
    assert loaded[:4] == ("left", "calibrated", 4.0, "P1")
    (pulled,) = tables["Static compliance at P1: displacement along the force, axes of the arm's base"].rows
    assert pulled == ("left", "-z", 50.0, 1.0, 20.0, 0.5, 0.001, 3)
    (woven,) = tables["Weaving deviations: stroke WS, frequency WF"].rows
    assert woven[5:9] == (-1.5, 0.3, -4.0, 0.4)


@pytest.mark.parametrize(("simulated", "who"), [(True, "the simulated cell itself"), (False, "a person")])
def test_it_is_said_who_was_at_the_arm(*, simulated: bool, who: str) -> None:
    lines = [one for one in view(_result(simulated=simulated)).parts if isinstance(one, str)]
    assert any(line.startswith(f"1 step at the arms by {who}") for line in lines)
    assert any("add that of your force gauge" in line for line in lines)
    assert "arm left yields by up to 20.0 µm/N" in lines[0]
