"""What a certificate states of results, and what it leaves out."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.targets.records import CompensateResult, MeasuredRelative, TargetCommand, UnknownCondition
from cellapp.commands.certificate.statement import certificate_of, used_instruments
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.judgements import judge_characteristics, judge_run
from cellapp.commands.run_results import RunResults
from cellapp.estimation.discovery.records import DiscoverResult, Noise
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, IsoValue, PoseCharacteristics
from cellapp.estimation.monitoring.records import CheckResult, CheckVerdict
from cellapp.estimation.uncertainty.budget import conformity
from cellapp.estimation.uncertainty.records import Judgement, UncertaintyParts
from cellapp.ground.profile.sections import Instrument, Tolerances
from cellapp.ground.results import CERTIFICATE, CHECK, COMPENSATE, ISO9283, VERIFY, ErrorSummary
from tests.approved import assert_approved
from tests.estimation.uncertainty.cases import measured, pair, pose_test, profile_with, results, verification
from tests.interfaces.page.cases import calibration, nothing_missing
from tests.twin import PROFILES

LEFT = [measured("a", "left", 0.03), measured("b", "left", 0.05, 0.4)]


def certified(found: RunResults, **tolerances: Any) -> CertificateResult:
    return certificate_of(
        profile_with(tolerances),
        found,
        {},
        {},
        ("2026-04-01T08:00:00+00:00",),
        "cellapp",
        number="7",
        run="run",
        issued="2026-01-02T12:00:00+00:00",
    )


# -- Instruments whose calibration was not in force when they were used, and data that nobody gave ---------------------

MEASURED = ("2026-03-02T23:59:59.000+00:00", "2026-03-04T08:00:00.000+00:00")


@pytest.mark.parametrize(
    ("calibrated", "due", "note"),
    [
        (date(2025, 3, 4), date(2026, 3, 4), ""),
        (date(2025, 3, 4), date(2026, 3, 3), "its calibration was overdue: due on 2026-03-03, used on 2026-03-04"),
        (date(2026, 3, 2), None, ""),
        (date(2026, 3, 3), None, "it was calibrated on 2026-03-03, after it was used on 2026-03-02"),
        (None, None, ""),
    ],
    ids=["last day", "overdue", "first day", "later", "not given"],
)
def test_a_calibration_must_be_in_force_on_every_day(calibrated: date | None, due: date | None, note: str) -> None:
    profile = profile_with({}, {"tracker": Instrument(serial="7", calibrated=calibrated, due=due)})
    tracker = used_instruments(profile, MEASURED)[0]
    assert (tracker.role, tracker.note) == ("laser tracker", note)
    assert tracker.due == ("" if due is None else due.isoformat())


# -- Characteristics of ISO 9283 are judged with their uncertainties as the rule says ----------------------------------


def arm(accuracy_mm: float, expanded_mm: float | None, n: int) -> ArmIso9283:
    value = IsoValue(value_mm=accuracy_mm, expanded_mm=expanded_mm, n=n)
    small = IsoValue(value_mm=0.01, expanded_mm=0.001, n=n)
    poses = tuple(
        PoseCharacteristics(pose=name, error_mm=(0.0, 0.0, 0.0), accuracy=one, repeatability=small)
        for name, one in (("P1", small), ("P2", value))
    )
    nominal = PoseCharacteristics(
        pose="P1", error_mm=(9.0, 0.0, 0.0), accuracy=IsoValue(value_mm=9.0, expanded_mm=0.1, n=n), repeatability=small
    )
    return ArmIso9283(
        payload_kg=0.3, tests={"nominal": CommandedTests(pose=(nominal,)), "calibrated": CommandedTests(pose=poses)}
    )


def test_fewer_cycles_are_judged_where_fewer_were_asked_for() -> None:
    (found,) = judge_characteristics(Tolerances(pose_accuracy=1e-4), {"left": arm(0.05, 0.01, 27)}, (), 27)
    assert (found.conformity, found.source) == ("conforms", "ISO 9283, P2, calibrated commands, 27 of 30 cycles")


# -- A run against its tolerances: what was measured and holds is judged, everything else is not -----------------------

LEFT_OF_JUDGEMENTS = [measured("a", "left", 0.03, 0.0), measured("b", "left", 0.05, 0.4)]
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
        for one in (*LEFT_OF_JUDGEMENTS, *RIGHT)
    )
    return {"discover": DiscoverResult(arms=arms), "compensate": CompensateResult(targets=commands)}


def judged(found: RunResults, **tolerances: object) -> dict[tuple[str, str], Judgement]:
    return {(one.characteristic, one.where): one for one in judge_run(profile_with(tolerances), found)}


@pytest.mark.parametrize(
    ("value", "expanded", "rule", "expected"),
    [
        (0.05, 0.05, "guarded", "conforms"),
        (0.05, 0.0501, "guarded", "not decided"),
        (0.15, 0.0501, "guarded", "not decided"),
        (0.1501, 0.05, "guarded", "does not conform"),
        (0.01, None, "guarded", "not decided"),
        (0.1, 0.5, "simple", "conforms"),
        (0.1001, None, "simple", "does not conform"),
        (None, 0.01, "simple", "not decided"),
        (None, 0.01, "guarded", "not decided"),
    ],
)
def test_decision_rules_at_a_tolerance_of_a_tenth(
    value: float | None, expanded: float | None, rule: str, expected: str
) -> None:
    assert conformity(value, expanded, 0.1, rule) == expected  # type: ignore[arg-type]


def test_the_largest_verified_error_of_each_arm_is_judged_with_its_expanded_uncertainty() -> None:
    """Tracker 39 um / 2 at 4 m (4.02 m for b), SMR 3 um, air 0.8 um, model 2 um, no excess: k = 2 gives 40 um."""
    found = judged(results(verify=verification([*LEFT_OF_JUDGEMENTS, *RIGHT]), **known_uncertainty()), position=1e-4)
    left, right = found["position", "left"], found["position", "right"]
    assert (left.value_mm, left.n, left.source) == (0.05, 2, "verification, 2 targets")
    assert left.expanded_mm == pytest.approx(
        2.0 * ((0.03912 / 3**0.5) ** 2 + 0.003**2 + 0.0008**2 + 0.002**2) ** 0.5, abs=1e-4
    )
    assert left.conformity == "conforms"
    assert right.value_mm == 0.04


def test_distances_between_verified_targets() -> None:
    """Points (4, 0), (4, 0.4), missed by 0.03 mm and 0.05 mm along x: the distance changes by 0.5 um at most."""
    found = judged(results(verify=verification([*LEFT_OF_JUDGEMENTS, *RIGHT]), **known_uncertainty()), distance=1e-4)
    left = found["distance", "left"]
    assert left.n == 1
    assert left.value_mm == pytest.approx(0.0, abs=1e-6)
    beside = measured("e", "left", 0.02).model_copy(
        update={"wanted_M": (4.5, 0.0, 0.0), "measured_M": (4.5 - 0.02e-3, 0.0, 0.0)}
    )
    further = judged(results(verify=verification([*LEFT_OF_JUDGEMENTS, beside])), distance=1e-4)["distance", "left"]
    assert further.n == 3
    assert further.value_mm == pytest.approx(0.03, abs=0.02)


def test_pairs_are_judged_and_both_arms_count() -> None:
    errors_mm: dict[str, Any] = dict.fromkeys(("nominal_mm", "compensated_mm", "final_mm"), 0.1)
    relative = MeasuredRelative(**errors_mm, nominal_mrad=4.0, compensated_mrad=0.4, final_mrad=0.4)
    pairs = [pair("p", 0.06), pair("q", 0.02).model_copy(update={"relative": relative})]
    found = judged(
        results(verify=verification([*LEFT_OF_JUDGEMENTS, *RIGHT], pairs), **known_uncertainty()),
        cooperative=2e-4,
        cooperative_orientation=3e-4,
        position=1e-3,
        decision="simple",
    )
    rotated = found["cooperative_orientation", "left and right"]
    assert (rotated.value_mrad, rotated.unit, rotated.conformity, rotated.n) == (0.4, "mrad", "does not conform", 1)
    both = found["cooperative", "left and right"]
    own = [found["position", arm].expanded_mm for arm in ("left", "right")]
    assert (both.value_mm, both.n) == (0.06, 2)
    assert both.expanded_mm == pytest.approx(sum((one or 0.0) ** 2 for one in own) ** 0.5)


@pytest.mark.parametrize(
    ("profile", "verify", "says"),
    [
        ("twin", {}, ("not measured: the flange has no 6-D probe", "not measured: a flange has no 6-D probe")),
        (
            "twin-6d",
            {},
            ("not verified; no held-out", "not verified; predicted at 1 held-out values: largest 0.700 mrad"),
        ),
        ("twin-6d", {"verify": verification(LEFT)}, ("measured no orientation", "measured no cooperative orientation")),
    ],
)
def test_an_orientation_that_was_not_measured_says_why(
    profile: str, verify: dict[str, Any], says: tuple[str, str]
) -> None:
    calibrate = calibration("left", "right")
    turned = ErrorSummary(mean=0.5, rms=0.5, std=0.0, max=0.7, n=1)
    both = {"nominal": calibrate.pair["nominal"].model_copy(update={"cooperative_mrad": turned})}
    limits = profile_with({"orientation": 1e-3, "cooperative_orientation": 1e-3}).tolerances
    cell = load_profile(PROFILES / f"{profile}.yaml").model_copy(update={"tolerances": limits})
    found = judge_run(cell, results(calibrate=calibrate.model_copy(update={"pair": both}), **verify))
    assert [says[" " in one.where] in one.source for one in found] == [True] * 3, [one.source for one in found]


# -- What a certificate says of runs of every kind ---------------------------------------------------------------------


def limited() -> RunResults:
    """Targets that were not measured, were corrected, or may be elsewhere with another approach."""
    missed = [LEFT[0].model_copy(update={"name": f"m{k}", "compensated_mm": None}) for k in range(7)]
    corrected = LEFT[1].model_copy(update={"name": "c", "corrected_mm": 0.01})
    commands = tuple(
        TargetCommand(
            name="a", arm="left", refusal="", q_nominal=None, q_compensated=None,
            unknown=(UnknownCondition(condition="approach", effects=(effect,), mm=mm),),
        )
        for effect, mm in (("backlash", 0.1), ("friction_windup", 0.2))
    )  # fmt: skip
    verify = verification([*LEFT, corrected, *missed], stopped="stopped by hand")
    return results(verify=verify, compensate=CompensateResult(targets=commands))


def checked(verdict: CheckVerdict, **changes: Any) -> RunResults:
    """A verified run whose arms were checked later."""
    check = CheckResult(verdict=verdict, planned=20, sure_after=6, p_value=1e-9, arms={})
    return results(verify=verification(LEFT_OF_JUDGEMENTS), check=check, **known_uncertainty(), **changes)


def of_poses(value: float, expanded: float | None, n: int = 30) -> RunResults:
    """Tested by ISO 9283."""
    test = pose_test()
    return results(iso9283=test.model_copy(update={"arms": {"left": arm(value, expanded, n)}}))


def test_certificates_are_as_approved() -> None:
    outdated = {VERIFY: "the profile was changed since", ISO9283: "the same", CERTIFICATE: "an earlier one"}
    verified, known = verification([*LEFT_OF_JUDGEMENTS, *RIGHT]), known_uncertainty()
    cases: dict[str, tuple[RunResults, dict[str, Any]]] = {
        "tested by ISO 9283": (results(iso9283=pose_test()), {"pose_accuracy": 1.0}),
        "out of date": (
            results(verify=verified, iso9283=pose_test(), out_of_date=outdated, **known),
            {"position": 1.0, "pose_accuracy": 1.0, "decision": "simple"},
        ),
        "outdated commands": (results(verify=verified, out_of_date={COMPENSATE: "x"}, **known), {"position": 1e-4}),
        "limits": (limited(), {"position": 1e-4}),
        "verified": (results(verify=verified, **known), {"position": 1e-4}),
        "simple rule": (results(verify=verification(LEFT)), {"position": 4e-5, "decision": "simple"}),
        "not verified": (results(calibrate=calibration("left", "right")), {"position": 1.0}),
        **{
            f"then {verdict}": (checked(verdict), {"position": 1e-4})
            for verdict in ("valid", "tracker moved", "arm changed", "base moved", "smr moved", "not explained")
        },
        "an outdated check": (checked("arm changed", out_of_date={CHECK: "calibrated"}), {"position": 1e-4}),
        **{
            f"worst pose {value} of {expanded}": (of_poses(value, expanded), {"pose_accuracy": 1e-4})
            for value, expanded in ((0.05, 0.04), (0.08, 0.04), (0.15, 0.04), (0.05, None))
        },
        "27 cycles": (of_poses(0.05, 0.01, 27), {"pose_accuracy": 1e-4, "pose_repeatability": 1e-4}),
    }
    said = []
    for name, (found, tolerances) in cases.items():
        certificate = certified(found, **tolerances)
        said.append(f"# {name}")
        for one in certificate.judgements:
            size, around = (None if mm is None else round(mm, 4) for mm in (one.value_mm, one.expanded_mm))
            words = f"{one.conformity}: {size} ± {around} of {one.n}; {one.source}"
            said.append(f"{one.where}, {one.characteristic}: {words}")
        if certificate.iso9283 is not None:
            said += [str(one) for one in certificate.iso9283.characteristics]
        said += [f"limit: {text}" for text in certificate.limits[1:]]
        said += [f"complaint: {text}" for text in certificate.complaints()]
    assert_approved(Path(__file__).parent / "approved" / "certificates.txt", "\n".join(said))


def test_an_uncertainty_with_a_gap_decides_nothing_and_names_the_gap() -> None:
    found = results(verify=verification(LEFT_OF_JUDGEMENTS), **known_uncertainty())
    left = judge_run(profile_with({"position": 1e-4}, {"smr_centering": None}), found)[0]
    assert (left.conformity, left.value_mm, left.expanded_mm) == ("not decided", 0.05, None)
    assert left.source.endswith("uncertainty not known, as not given: SMR centering")
