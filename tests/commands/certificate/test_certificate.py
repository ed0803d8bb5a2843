"""What a certificate states of results, and what it leaves out."""

from __future__ import annotations

from typing import Any

import pytest

from cellapp.cell.targets.records import CompensateResult, TargetCommand, UnknownCondition
from cellapp.commands.certificate.result import CertificateResult, CertifiedCharacteristic
from cellapp.commands.certificate.statement import CertificateInput, certificate_of
from cellapp.commands.report.result import RunResults
from cellapp.ground.results import CERTIFICATE, ISO9283, VERIFY
from tests.estimation.uncertainty.cases import measured, pose_test, profile_with, results, verification

pytestmark = pytest.mark.fast

LEFT = [measured("a", "left", 0.03), measured("b", "left", 0.05, 0.4)]


def certified(found: RunResults, **tolerances: Any) -> CertificateResult:
    return certificate_of(
        CertificateInput(
            number="7",
            run="run",
            issued="2026-01-02T12:00:00+00:00",
            program="cellapp",
            profile=profile_with(tolerances),
            results=found,
            conditions={},
            controllers={},
            measured=("2026-04-01T08:00:00+00:00",),
            rests_on={},
        )
    )


def test_each_characteristic_of_iso_9283_is_stated_with_its_commands() -> None:
    found = certified(results(iso9283=pose_test())).iso9283
    assert found is not None
    assert found.characteristics[0] == CertifiedCharacteristic(
        where="left", characteristic="pose_accuracy", commands="calibrated", value_mm=0.08, expanded_mm=0.01, n=30
    )
    assert [one.characteristic for one in found.characteristics] == ["pose_accuracy", "pose_repeatability"]
    assert found.payload_kg == {"left": 1.0}


def test_figures_that_are_out_of_date_are_left_out_and_marked() -> None:
    reasons = {VERIFY: "the profile was changed since", ISO9283: "the same", CERTIFICATE: "an earlier one"}
    outdated = results(verify=verification(LEFT), iso9283=pose_test(), out_of_date=reasons)
    found = certified(outdated, position=1.0, decision="simple")
    assert found.iso9283 is None
    assert found.arms["left"].errors.left is None
    assert found.warnings[1] == (
        "not verified: the verification is out of date (the profile was changed since); its figures are left out"
    )
    assert found.out_of_date == ("verify: the profile was changed since", "iso9283: the same")
    assert {one.conformity for one in found.judgements} == {"cannot say"}
    assert {"verify: the profile was changed since", *found.warnings} <= set(found.complaints())


def test_limits_name_what_was_not_measured_corrected_or_may_be_otherwise() -> None:
    missed = [LEFT[0].model_copy(update={"name": f"m{k}", "compensated_mm": None}) for k in range(7)]
    corrected = LEFT[1].model_copy(update={"name": "c", "corrected_mm": 0.01})
    command = TargetCommand(
        name="a",
        arm="left",
        refusal="",
        q_nominal=None,
        q_compensated=None,
        unknown=(UnknownCondition(condition="approach", effects=("backlash",), mm=0.1),),
    )
    again = command.model_copy(
        update={"unknown": (UnknownCondition(condition="approach", effects=("friction_windup",), mm=0.2),)}
    )
    found = certified(
        results(verify=verification([*LEFT, corrected, *missed]), compensate=CompensateResult(targets=(command, again)))
    )
    assert found.limits[1:] == (
        "Arm left: 7 of 10 targets were not measured: m0, m1, m2, m3, m4 and 2 more.",
        "Arm left: 1 of 10 targets were corrected by measuring them.",
        "Arm left: verified with the approach that the commands are made for; with another one the SMR may be"
        " elsewhere by up to 0.200 mm (backlash, friction windup).",
    )
    assert "arm right: not verified" in found.warnings


def test_a_cell_with_one_simulated_device_is_marked() -> None:
    assert certified(results()).warnings[0].startswith("simulated cell")
