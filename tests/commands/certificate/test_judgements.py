"""A run against its tolerances: what was measured and holds is judged, everything else is not."""

from __future__ import annotations

import pytest

from cellapp.cell.targets.records import CompensateResult, TargetCommand
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.report.result import RunResults
from cellapp.estimation.discovery.records import DiscoverResult, Noise
from cellapp.estimation.monitoring.check.records import CheckResult, CheckVerdict
from cellapp.estimation.uncertainty.budget import conformity
from cellapp.estimation.uncertainty.records import Judgement, UncertaintyParts
from cellapp.ground.results import COMPENSATE, ISO9283, VERIFY
from tests.estimation.uncertainty.cases import measured, pair, pose_test, profile_with, results, verification
from tests.interfaces.page.cases import calibration, nothing_missing

pytestmark = pytest.mark.fast

LEFT = [measured("a", "left", 0.03, 0.0), measured("b", "left", 0.05, 0.4)]
RIGHT = [measured("c", "right", 0.02), measured("d", "right", 0.04, 0.3)]


def known_uncertainty() -> dict[str, object]:
    """Discovery and commands from which repeatability (none) and the model's part (0.002 mm) follow."""
    arms = {
        name: nothing_missing(name).model_copy(update={"scatter": 1.0, "noise_mm": Noise(rms=0.03, source="stated")})
        for name in ("left", "right")
    }
    parts = UncertaintyParts(parameters=0.002, effects=0.0, network=0.0, extrapolation=0.0, noise=0.01, conditions=0.0)
    commands = tuple(
        TargetCommand(name=one.name, arm=one.arm, refusal="", q_nominal=(0.0,), q_compensated=(0.0,), parts=parts)
        for one in (*LEFT, *RIGHT)
    )
    return {"discover": DiscoverResult(arms=arms), "compensate": CompensateResult(targets=commands)}


def judged(found: RunResults, **tolerances: object) -> dict[tuple[str, str], Judgement]:
    return {(one.characteristic, one.where): one for one in judge_run(profile_with(tolerances), found)}


@pytest.mark.parametrize(
    ("value", "expanded", "rule", "expected"),
    [
        (0.05, 0.05, "guarded", "conforms"),
        (0.05, 0.0501, "guarded", "cannot say"),
        (0.15, 0.0501, "guarded", "cannot say"),
        (0.1501, 0.05, "guarded", "does not conform"),
        (0.01, None, "guarded", "cannot say"),
        (0.1, 0.5, "simple", "conforms"),
        (0.1001, None, "simple", "does not conform"),
        (None, 0.01, "simple", "cannot say"),
        (None, 0.01, "guarded", "cannot say"),
    ],
)
def test_decision_rules_at_a_tolerance_of_a_tenth(
    value: float | None, expanded: float | None, rule: str, expected: str
) -> None:
    assert conformity(value, expanded, 0.1, rule) == expected  # type: ignore[arg-type]


def test_nothing_is_judged_without_a_tolerance() -> None:
    assert judged(results(verify=verification(LEFT))) == {}


def test_the_largest_verified_error_of_each_arm_is_judged_with_its_expanded_uncertainty() -> None:
    """Tracker 39 um / 2 at 4 m (4.02 m for b), SMR 3 um, air 0.8 um, model 2 um, no excess: k = 2 gives 40 um."""
    found = judged(results(verify=verification([*LEFT, *RIGHT]), **known_uncertainty()), position=1e-4)
    left, right = found["position", "left"], found["position", "right"]
    assert (left.value_mm, left.n, left.source) == (0.05, 2, "verification, 2 targets")
    assert left.expanded_mm == pytest.approx(
        2.0 * ((0.03912 / 3**0.5) ** 2 + 0.003**2 + 0.0008**2 + 0.002**2) ** 0.5, abs=1e-4
    )
    assert left.conformity == "conforms"
    assert right.value_mm == 0.04


def test_an_uncertainty_with_a_gap_decides_nothing_and_names_the_gap() -> None:
    found = results(verify=verification(LEFT), **known_uncertainty())
    profile = profile_with({"position": 1e-4}, {"smr_centering": None})
    left = judge_run(profile, found)[0]
    assert (left.conformity, left.value_mm, left.expanded_mm) == ("cannot say", 0.05, None)
    assert left.source.endswith("uncertainty not known, as not given: SMR centering")


def checked(verdict: CheckVerdict) -> CheckResult:
    return CheckResult(verdict=verdict, planned=20, sure_after=6, p_value=1e-9, arms={})


@pytest.mark.parametrize(
    ("verdict", "conformity_after"),
    [
        ("valid", "conforms"),
        ("tracker moved", "conforms"),
        ("arm changed", "cannot say"),
        ("base moved", "cannot say"),
        ("smr moved", "cannot say"),
        ("not explained", "cannot say"),
    ],
)
def test_a_check_that_found_other_arms_leaves_nothing_decided(verdict: CheckVerdict, conformity_after: str) -> None:
    known = known_uncertainty()
    left = judged(results(verify=verification(LEFT), check=checked(verdict), **known), position=1e-4)[
        "position", "left"
    ]
    assert left.conformity == conformity_after
    assert left.source.endswith(f"a later check found: {verdict}") is (conformity_after == "cannot say")
    outdated = results(verify=verification(LEFT), check=checked(verdict), out_of_date={"check": "calibrated"}, **known)
    assert judged(outdated, position=1e-4)["position", "left"].conformity == "conforms"


def test_the_simple_rule_needs_no_uncertainty() -> None:
    found = judged(results(verify=verification(LEFT)), position=4e-5, decision="simple")
    assert found["position", "left"].conformity == "does not conform"
    assert found["position", "right"].conformity == "cannot say"


def test_targets_that_were_not_measured_and_a_stop_are_named() -> None:
    missed = LEFT[0].model_copy(update={"name": "m", "compensated_mm": None, "measured_M": None})
    found = judged(results(verify=verification([*LEFT, missed], stopped="stopped by hand")), position=1e-4)
    assert found["position", "left"].source.startswith("verification, 2 of 3 targets (stopped by hand)")


def test_distances_between_verified_targets() -> None:
    """Points (4, 0), (4, 0.4), missed by 0.03 mm and 0.05 mm along x: the distance changes by 0.5 um at most."""
    found = judged(results(verify=verification([*LEFT, *RIGHT]), **known_uncertainty()), distance=1e-4)
    left = found["distance", "left"]
    assert left.n == 1
    assert left.value_mm == pytest.approx(0.0, abs=1e-6)
    beside = measured("e", "left", 0.02).model_copy(
        update={"wanted_M": (4.5, 0.0, 0.0), "measured_M": (4.5 - 0.02e-3, 0.0, 0.0)}
    )
    further = judged(results(verify=verification([*LEFT, beside])), distance=1e-4)["distance", "left"]
    assert further.n == 3
    assert further.value_mm == pytest.approx(0.03, abs=0.02)


def test_pairs_are_judged_and_both_arms_count() -> None:
    found = judged(
        results(verify=verification([*LEFT, *RIGHT], [pair("p", 0.06), pair("q", 0.02)]), **known_uncertainty()),
        cooperative=2e-4,
        position=1e-3,
    )
    both = found["cooperative", "left and right"]
    own = [found["position", arm].expanded_mm for arm in ("left", "right")]
    assert (both.value_mm, both.n) == (0.06, 2)
    assert both.expanded_mm == pytest.approx(sum((one or 0.0) ** 2 for one in own) ** 0.5)


def test_without_a_verification_the_held_out_figure_is_named_and_nothing_is_decided() -> None:
    left = judged(results(calibrate=calibration("left", "right")), position=1.0)["position", "left"]
    assert (left.value_mm, left.conformity, left.n) == (None, "cannot say", 0)
    assert left.source.startswith("not verified; predicted at")
    assert "largest" in left.source


def test_results_that_are_out_of_date_judge_nothing() -> None:
    outdated = {VERIFY: "20 readings were added since", ISO9283: "the profile was changed since"}
    found = judged(
        results(verify=verification([*LEFT, *RIGHT]), iso9283=pose_test(), out_of_date=outdated, **known_uncertainty()),
        position=1.0,
        pose_accuracy=1.0,
    )
    assert {one.conformity for one in found.values()} == {"cannot say"}
    assert found["position", "left"].source.startswith("the verification is out of date (20 readings were added since)")
    assert found["pose_accuracy", "left"].source.startswith("the test by ISO 9283 is out of date")


def test_commands_that_are_out_of_date_say_nothing_about_the_uncertainty() -> None:
    found = results(
        verify=verification(LEFT), out_of_date={COMPENSATE: "the profile was changed since"}, **known_uncertainty()
    )
    assert "calibrated model" in judged(found, position=1e-4)["position", "left"].source


def test_what_iso_9283_measured_is_judged_by_the_tolerances_of_now() -> None:
    found = judged(results(iso9283=pose_test()), pose_accuracy=6e-5, drift=1e-4)
    assert found["pose_accuracy", "left"].conformity == "does not conform"
    assert found["pose_accuracy", "left"].tolerance_mm == pytest.approx(0.06)
    assert found["pose_accuracy", "right"].source.startswith("not measured")
    assert {found["drift", arm].conformity for arm in ("left", "right")} == {"cannot say"}


def test_too_few_cycles_judge_nothing_by_any_tolerance() -> None:
    found = judged(results(iso9283=pose_test(cycles=3)), pose_accuracy=0.1)
    assert found["pose_accuracy", "left"].conformity == "cannot say"
    assert "too few to judge" in found["pose_accuracy", "left"].source
