"""Data-driven terms: all laws scored at once, and a field over the workspace found by the structured process."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.calibration.measurement_conditions import measurement_conditions
from cellapp.discovery.arm_data import ArmData
from cellapp.discovery.describe import describe
from cellapp.discovery.joint_fit import JointFit, fit_terms, refit
from cellapp.discovery.process.structured import fit_process, process_terms
from cellapp.discovery.search.channel_scan import ChannelScan, Families
from cellapp.discovery.search.scan import LawScan
from cellapp.discovery.terms import UNKNOWN
from cellapp.effects.data_driven import channels
from cellapp.effects.unknown import curve_families, pair_families
from cellapp.kinematics.chain import smr_positions
from cellapp.model import ArmModel
from cellapp.model.nominal import bodies_of, nominal_arm
from cellapp.profile import load_profile
from cellapp.run import Readings
from drivers.plant.random_functions import RandomField
from tests.arms import STATION
from tests.twin import PROFILES

SIGMA_M = 15e-6
N = 200


def readings_with(bend, shift) -> tuple[ArmData, JointFit]:
    """Geometry fitted to readings with joint offsets ``bend(q)`` and shifts ``shift(p)`` of the measured points."""
    profile = load_profile(PROFILES / "twin.yaml")
    geometry = nominal_arm(profile.arms["left"]).with_T_M_B(STATION)
    rng = np.random.default_rng(7)
    q = rng.uniform(-2.0, 2.0, (N, 6))
    p_M = smr_positions(geometry, q + bend(q))
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=60.0 * np.arange(N, dtype=np.float64),
        q=q,
        approach=np.sign(rng.uniform(-1.0, 1.0, (N, 6))).astype(np.int8),
        p_M=p_M + shift(p_M) + rng.normal(0.0, SIGMA_M, (N, 3)),
        sigma_m=np.full(N, SIGMA_M),
    )
    up = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(profile.arms["left"]), up_M=up)
    data = ArmData.of(profile, model, readings, measurement_conditions(readings))
    return data, fit_terms(data, ())


@pytest.mark.fast
def test_families_score_as_their_laws_do_one_by_one():
    data, fit = readings_with(lambda q: 1e-4 * np.sin(q + q[:, ::-1]), np.zeros_like)
    chosen = channels(6)
    families = [*curve_families(data.context)[::5], *pair_families(data.context)[::23]]
    scan = ChannelScan.of(data, fit)
    values = scan.scores(Families.of(data, families), chosen)
    candidates = [fit.candidate(data, UNKNOWN, family.law(channel)) for channel in chosen for family in families]
    one_by_one = LawScan.of(candidates, fit.projector)
    residual = fit.projected_residual
    wanted = one_by_one.best_block_scores(residual.projected[:, None], np.array([residual.square]))
    seen = np.isfinite(wanted.ravel())
    assert seen.sum() > 200
    assert (np.isfinite(values.ravel()) == seen).all()
    np.testing.assert_allclose(values.ravel()[seen], wanted.ravel()[seen], rtol=1e-6, atol=1e-4)


def test_a_field_over_the_workspace_is_one_smooth_term():
    field = RandomField.drawn(11, 0.6)
    data, fit = readings_with(np.zeros_like, lambda p: 60e-6 * field.at(p))
    found = fit_process(data, fit, 30.0)
    assert found is not None
    terms = process_terms(*found)
    assert [(term.slug, term.law.name) for term in terms] == [(UNKNOWN, "base shift|x|y|z")]
    data, after = refit(data, terms)
    assert np.std(fit.identification.residuals) > 2.0 * SIGMA_M
    assert np.std(after.identification.residuals) < 1.05 * SIGMA_M
    described = describe(data, after, 0)
    assert (described.channel, described.variables) == ("base shift", ("x", "y", "z"))
    assert "depends on the position, a field over the workspace" in described.sentence
    assert described.size_um == pytest.approx(60.0 * np.sqrt(3.0), rel=0.35)
