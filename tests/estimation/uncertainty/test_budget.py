"""Uncertainty budgets against figures computed by hand, by the GUM."""

from __future__ import annotations

import math

import pytest

from cellapp.commands.run_results import RunResults, evidence_of
from cellapp.estimation.calibration.records import Repeatability
from cellapp.estimation.discovery.records import DiscoverResult, Noise
from cellapp.estimation.uncertainty.budget import (
    AIR,
    CENTERING,
    GROWTH,
    MODEL,
    REPEATABILITY,
    STATION,
    TRACKER,
    BudgetEvidence,
    MeasuredConditions,
    angle_budget,
    combined_mm,
    distance_budget,
    expanded_mm,
    expanded_mrad,
    not_given,
    position_budget,
)
from cellapp.estimation.uncertainty.records import UncertaintyContribution
from cellapp.ground.profile.sections import Probe
from tests.estimation.uncertainty.cases import measured, profile_with, results, verification
from tests.interfaces.page.cases import calibration, nothing_missing
from tests.twin import small_twin, with_arm

CALIPER = (0.7, 1.2, 3.4)
"""Three standard uncertainties whose root of the sum of squares is known: sqrt(0.49 + 1.44 + 11.56) = 3.6729."""


def lines(*values: float | None) -> list[UncertaintyContribution]:
    return [
        UncertaintyContribution(source=f"source {k}", standard_mm=value, evaluation="B", basis="")
        for k, value in enumerate(values)
    ]


def by_source(found: RunResults, conditions: MeasuredConditions | None = None) -> dict[str, UncertaintyContribution]:
    return {
        one.source: one for one in position_budget(profile_with({}), "left", evidence_of(found, "left", conditions))
    }


def test_variances_add_and_the_coverage_factor_is_two() -> None:
    assert combined_mm(lines(*CALIPER)) == pytest.approx(3.67287, abs=1e-5)
    assert expanded_mm(lines(*CALIPER)) == pytest.approx(7.34575, abs=1e-5)


def test_a_sum_without_a_contribution_that_nobody_gave_is_no_uncertainty() -> None:
    assert combined_mm(lines(0.01, None)) is None
    assert expanded_mm(lines(None)) is None
    assert expanded_mm([]) is None
    assert not_given(lines(0.01, None)) == ["source 1"]


def test_contributions_of_the_twin_at_four_metres() -> None:
    """15 um + 6 um/m at 4 m across the beam: 39 um, over sqrt 3 22.5 um; 0.2 K at 1 um/m per K over 4 m: 0.8 um."""
    found = by_source(results(verify=verification([measured("a", "left", 0.0), measured("b", "left", 0.0)])))
    assert found[TRACKER].standard_mm == pytest.approx(0.039 / math.sqrt(3.0))
    assert "square root of 3 (rectangular" in found[TRACKER].basis
    assert found[CENTERING].standard_mm == pytest.approx(0.003)
    assert found[AIR].standard_mm == pytest.approx(0.0008)
    assert [found[source].evaluation for source in (TRACKER, CENTERING, AIR)] == ["B", "B", "B"]
    assert STATION not in found
    assert GROWTH not in found


def test_half_of_the_permissible_error_is_a_choice_and_is_stated() -> None:
    profile = profile_with({"mpe": "half"})
    found = results(verify=verification([measured("a", "left", 0.0)]))
    tracker = next(one for one in position_budget(profile, "left", evidence_of(found, "left")) if one.source == TRACKER)
    assert tracker.standard_mm == pytest.approx(0.0195)
    assert "half was chosen" in tracker.basis
    assert profile.model_dump(mode="json")["tolerances"]["mpe"] == "half"
    assert "mpe" not in profile_with({"position": 1e-4}).model_dump(mode="json")["tolerances"], "older hashes hold"


def test_what_nobody_gave_has_no_value_and_says_which_key_gives_it() -> None:
    profile = profile_with({}, {"smr_centering": None, "air_temperature_uncertainty": None})
    budget = position_budget(profile, "left", BudgetEvidence())
    by_name = {one.source: one for one in budget}
    assert set(not_given(budget)) == {TRACKER, CENTERING, AIR, REPEATABILITY, MODEL}
    assert "traceability.smr_centering" in by_name[CENTERING].basis
    assert "traceability.air_temperature_uncertainty" in by_name[AIR].basis
    assert expanded_mm(budget) is None


def test_the_arm_grows_by_its_links_where_no_discovery_compared_the_temperatures() -> None:
    """Links of the UR10 add up to 1.7243 m; +-5 K, rectangular: 23e-6 / K * 1.7243 m * 5 K / sqrt(3)."""
    conditions = MeasuredConditions(readings=1, distance_m=(4.0, 4.0), air_c=(18.0, 28.0), joints_c=(25.0, 26.0))
    reach = sum(abs(joint.a) + abs(joint.d) for joint in profile_with({}).arms["left"].type.joints)
    grown = by_source(results(), conditions)[GROWTH]
    assert grown.standard_mm == pytest.approx(23e-6 * reach * 5.0 / math.sqrt(3.0) * 1e3)
    assert grown.evaluation == "B"


def test_both_positions_of_a_distance_count() -> None:
    position = lines(0.01, 0.02)
    assert combined_mm(distance_budget(position)) == pytest.approx(math.sqrt(2.0) * math.hypot(0.01, 0.02))


@pytest.mark.parametrize(("tracker", "expected"), [(0.02, math.sqrt(0.03**2 - 0.02**2)), (0.04, 0.0), (None, 0.03)])
def test_repeats_count_by_what_exceeds_the_tracker(tracker: float | None, expected: float) -> None:
    """Mean distance from the barycentre 0.0479 mm: 0.03 mm a coordinate, as the ``tracker`` is per coordinate."""
    mean, tracker_mm = 0.03 * 2.0 * math.sqrt(2.0 / math.pi), tracker and tracker * math.sqrt(3.0)
    repeats = Repeatability(mean=mean, rp=0.1, n=20)
    base = calibration("left")
    arm = base.arms["left"].model_copy(update={"repeatability_mm": repeats, "tracker_mm": tracker_mm})
    found = by_source(results(calibrate=base.model_copy(update={"arms": {"left": arm}})))[REPEATABILITY]
    assert found.standard_mm == pytest.approx(expected)
    assert found.evaluation == "A"


@pytest.mark.parametrize(
    ("probe", "noise_mrad", "expected"),
    [
        (Probe(sigma=40e-6), 0.05, (0.04, 0.03, 0.1)),
        (Probe(sigma=40e-6), 0.03, (0.04, 0.0, 0.1)),
        (None, 0.05, (None, 0.05, 0.1)),
    ],
)
def test_an_orientation_counts_probe_scatter_beyond_it_and_model(
    probe: Probe | None, noise_mrad: float, expected: tuple[float | None, ...]
) -> None:
    twin = small_twin()
    profile = with_arm(twin, "left", smr=twin.arms["left"].smr.model_copy(update={"probe": probe}))
    found = angle_budget(profile, "left", 0.1, noise_mrad)
    assert [one.standard_mrad for one in found] == [one and pytest.approx(one) for one in expected]
    whole = None if None in expected else pytest.approx(2.0 * math.hypot(*(one or 0.0 for one in expected)))
    assert expanded_mrad(found) == whole


def test_scatter_about_the_model_counts_before_repeats_and_covers_growth() -> None:
    """Noise 0.03 mm long, so 0.01732 mm a coordinate; scatter 1.25: excess 0.75 times that."""
    noise = Noise(rms=0.03, source="stated")
    arm = nothing_missing("left").model_copy(update={"scatter": 1.25, "noise_mm": noise})
    conditions = MeasuredConditions(readings=1, air_c=(18.0, 28.0))
    found = by_source(results(discover=DiscoverResult(arms={"left": arm})), conditions)
    assert found[REPEATABILITY].standard_mm == pytest.approx(0.75 * 0.03 / math.sqrt(3.0))
    assert found[GROWTH].standard_mm == 0.0
    outdated = results(discover=DiscoverResult(arms={"left": arm}), out_of_date={"discover": "readings were added"})
    assert by_source(outdated, conditions)[REPEATABILITY].standard_mm is None
