"""Laws that may be off: their free parts, further joints, other effects beside them, and wobbles that are none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import refit
from cellapp.estimation.discovery.search.free_part import (
    SHARES,
    FreePartEvidence,
    explains_beside_free_parts,
    possible_free_parts,
    with_free_parts,
)
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import SearchProblem, SearchState, scatter
from cellapp.estimation.discovery.search.stepwise import addition, refinement
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.estimation.readings import Readings
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.twin import PROFILES

SIGMA_M = 15e-6
N = 220
THRESHOLD = 12.0
STIFF = EFFECTS["joint_compliance"].law()


def searched(bend, slug="", names=(), shift=None):
    """A search that stands at one effect, or none.

    The readings have joint offsets ``bend(q, torques, approach)`` and are moved by ``shift(context)``.
    """
    profile = load_profile(PROFILES / "twin.yaml")
    geometry = nominal_arm(profile.arms["left"]).with_T_M_B(STATION)
    up_M = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(profile.arms["left"]), up_M=up_M)
    rng = np.random.default_rng(7)
    q, approach = rng.uniform(-2.0, 2.0, (N, 6)), rng.choice([-1.0, 1.0], (N, 6))
    context = model.context(q)
    bent = bend(q, context.torques, approach)
    moved = np.zeros((N, 3)) if shift is None else shift(context)
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=np.full(N, np.nan),
        q=q,
        approach=approach.astype(np.int8),
        p_M=smr_positions(geometry, q + bent) + moved + rng.normal(0.0, SIGMA_M, (N, 3)),
        sigma_m=np.full(N, SIGMA_M),
    )
    data = ArmData.of(profile, model, readings, measurement_conditions(readings))
    terms = (ModelTerm(slug, EFFECTS[slug].law(), names),) if slug else ()
    problem = SearchProblem(data, tuple(EFFECTS)[:-1], np.zeros(20), THRESHOLD, CancelToken(), lambda words: None)
    return problem, SearchState(*refit(data, terms))


def ratio(state):
    found = scatter(state.data, state.fit)
    assert found is not None
    return found.ratio


def at_joint(joint, offset):
    bent = np.zeros((N, 6))
    bent[:, joint] = offset
    return bent


def softer(q, torques, approach):
    """A spring at joint 2 that is softer under small torques."""
    tau = torques[:, 1]
    return at_joint(1, 1e-5 * tau + 1.2e-4 * np.tanh(tau / 30.0))


def linear(q, torques, approach):
    return at_joint(1, 1.2e-5 * torques[:, 1])


def test_a_law_that_is_off_gets_a_free_part_that_explains_the_rest():
    problem, state = searched(softer, "joint_compliance", ("compliance2",))
    before = ratio(state)
    free = with_free_parts(problem, state)
    assert free is not None
    (term,) = free.fit.terms
    assert {one.driver_name for one in term.modulations} == {"own size"}
    assert before > 1.3 > 1.08 > ratio(free)
    (effect,) = free.fit.model.effects
    assert 0.02 < effect.law_misfit < SHARES[-1]
    assert effect.names[:1] == effect.law_names == ("compliance2",)
    again = with_free_parts(problem, free)
    assert again is not None
    names = [one.name for one in term.modulations]
    assert [one.name for one in again.fit.terms[0].modulations] == names, (
        "free parts are found anew, with the same outcome"
    )


def test_a_law_that_is_right_has_none():
    problem, state = searched(linear, "joint_compliance", ("compliance2",))
    assert with_free_parts(problem, state) is None


def best_new_score(problem, state, slug):
    scan = LawScan.of(state.fit.candidates(state.data, [slug]), state.fit.projector)
    return scan.ranked(state.fit.projected_residual)[0]


def test_another_effect_still_explains_something_beside_a_law_that_may_be_off():
    def both(q, torques, approach):
        return linear(q, torques, approach) + at_joint(1, 4e-5 * np.cos(q[:, 1] + 0.4))

    problem, state = searched(both, "joint_compliance", ("compliance2",))
    score = best_new_score(problem, state, "encoder_eccentricity")
    assert score.value > THRESHOLD
    assert explains_beside_free_parts(problem, state, score)


def test_what_a_law_leaves_over_is_no_other_effect():
    problem, state = searched(softer, "joint_compliance", ("compliance2",))
    plain = [best_new_score(problem, state, slug) for slug in ("transmission_error", "encoder_eccentricity")]
    assert max(score.value for score in plain) > THRESHOLD, "it looks like one"
    assert not any(explains_beside_free_parts(problem, state, score) for score in plain)


def test_a_further_joint_joins_before_another_name():
    def play(q, torques, approach):
        return -approach * np.array([1.5e-4, 5e-5, 0.0, 0.0, 0.0, 0.0])

    problem, state = searched(play, "backlash", ("half_play1",))
    step = refinement(problem, state, THRESHOLD)
    assert step is not None
    (term,) = step.terms
    assert set(term.names) == {"half_play1", "half_play2"}


def test_a_tilt_both_ways_is_a_wobble():
    def tilted(context):
        wave = 2e-4 * np.sin(3.0 * context.q[:, 4] + 0.3)
        return wave[:, None] * context.twist_shift(4, None, np.array([0.6, 0.8, 0.0]))

    problem, state = searched(lambda q, torques, approach: np.zeros((N, 6)), shift=tilted)
    score = best_new_score(problem, state, "joint_axis_wobble")
    step = addition(problem, state, score)
    assert step is not None
    assert {name[:9] for name in step.terms[0].names} == {"wobble_x5", "wobble_y5"}


def test_a_joint_that_follows_its_neighbours_angle_is_no_wobble():
    """Joint 4 that follows three cycles of joint 5 tilts the axis of joint 5 in one direction only."""
    problem, state = searched(lambda q, torques, approach: at_joint(3, 3e-4 * np.sin(3.0 * q[:, 4])))
    score = best_new_score(problem, state, "joint_axis_wobble")
    assert score.value > THRESHOLD, "it looks like one"
    assert addition(problem, state, score) is None


def test_the_prior_of_a_modulation_has_the_rms_of_its_share():
    _, state = searched(linear, "joint_compliance", ("compliance2",))
    value = float(state.fit.term_values(0)[0])
    for part in possible_free_parts(state.data, state.fit, 0):
        # mean square of g over the driver's range: 1/2 for each cosine, 1 for a cosine and a sine together
        assert float(np.sum(part.sd**2)) / 2.0 == pytest.approx(value**2, rel=0.02)


def test_the_gain_of_the_evidence_equals_that_of_dense_covariances():
    rng = np.random.default_rng(2)
    X, Z, y = rng.normal(size=(5, 60)), rng.normal(size=(4, 60)), rng.normal(size=60)
    y = y + 3.0 * Z[0]
    projector = NuisanceProjector.of(X)
    left = np.linalg.svd(X)[2][5:]  # the complement of X
    evidence = FreePartEvidence(
        Z @ projector.project(Z).T, Z @ projector.project(y), float(y @ projector.project(y)), 55.0
    )
    sd = np.array([2.0, 0.5, 0.0, 1.0])

    def dense(noise, sd):
        covariance = noise * np.eye(55) + (left @ Z.T) @ np.diag(sd**2) @ (left @ Z.T).T
        return 2.0 * multivariate_normal.logpdf(left @ y, cov=covariance)

    grid = np.geomspace(0.02, 1.0, 40) * evidence.square / 55.0
    expected = max(dense(one, sd) for one in grid) - dense(evidence.square / 55.0, np.zeros(4))
    assert evidence.gain(sd) == pytest.approx(expected, rel=1e-9)
