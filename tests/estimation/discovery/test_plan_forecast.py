"""The expected noise is the tracker's, and the sizes that a plan promises are those that a search of readings finds."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.plan import plan_stops
from cellapp.estimation.discovery.joint_fit import ProjectedResidual, fit_terms
from cellapp.estimation.discovery.plan_forecast import (
    ArmDesign,
    PlannedReadings,
    arm_designs,
    planned_effects,
    tracker_covariance,
)
from cellapp.estimation.discovery.search.scan import LawScan
from drivers.plant.config import TrackerConfig
from drivers.plant.optics import covariances
from tests.twin import small_twin

pytestmark = pytest.mark.fast

STOPS = 60


@pytest.fixture(scope="module")
def design() -> ArmDesign:
    profile = small_twin(STOPS)
    expected = PlannedReadings(np.linspace(0.0, 8.0 * STOPS, STOPS), np.full(STOPS, 0.2))
    return arm_designs(profile, plan_stops(profile), expected)["left"]


def test_the_expected_noise_is_that_of_the_simulated_tracker() -> None:
    tracker = small_twin().tracker
    p_M = np.random.default_rng(2).uniform(-3.0, 3.0, (50, 3))
    config = TrackerConfig(
        T_C_M=np.eye(4),
        transverse=(tracker.transverse.constant, tracker.transverse.proportional),
        range=(tracker.range.constant, tracker.range.proportional),
        averaging_s=tracker.averaging,
    )
    np.testing.assert_allclose(
        tracker_covariance(tracker, p_M), covariances(config, p_M, tracker.averaging), rtol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["backlash", "encoder_eccentricity", "joint_compliance"])
def test_an_effect_of_twice_the_promised_size_scores_and_of_a_fifth_does_not(slug: str, design: ArmDesign) -> None:
    promised = next(one for one in planned_effects(design) if one.effect == slug)
    name, size = next(iter(promised.smallest_seen.items()))
    fit = fit_terms(design.data, ())
    scan = LawScan.of(fit.candidates(design.data, [slug]), fit.projector)
    one = scan.candidates[0]
    row = one.rows[[column.name for column in one.columns].index(name)]
    scores = []
    for factor in (0.2, 2.0):
        residual = ProjectedResidual(fit.projector, fit.residual + factor * size.value * row)
        best = scan.ranked(residual)
        scores.append(best[0].value if best else -np.inf)
    assert scores[0] < 10.0 < scores[1]
