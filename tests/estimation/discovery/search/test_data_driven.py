"""Data-driven terms: all laws scored at once, and a field over the workspace found by the structured process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.discovery.accepted import describe
from cellapp.estimation.discovery.arm_data import TRANSMISSION_ERROR, UNKNOWN, ArmData, Excess, ModelTerm
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms, refit, uncertainty_with_scatter
from cellapp.estimation.discovery.posterior import posteriors_of, remaining_scan
from cellapp.estimation.discovery.process import fit_process, process_terms
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.data_driven import (
    in_place_of_names,
    with_data_driven_terms,
    without_imitations,
)
from cellapp.estimation.discovery.search.discrepancy_term import (
    BesideField,
    explains_beside_discrepancies,
    with_discrepancies,
)
from cellapp.estimation.discovery.search.review import review
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import Posteriors, SearchProblem, SearchResult, SearchState
from cellapp.estimation.discovery.search.stepwise import addition, refinement, search
from cellapp.ground.progress import JobSteps, JobToken
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.data_driven import FIELD, acted_on
from cellapp.robot.effects.periodic import LINES
from cellapp.robot.effects.unknown import curve_families, pair_families
from cellapp.robot.kinematics.chain import smr_positions
from drivers.plant.random_functions import RandomField
from tests.estimation.discovery.problems import arm_of, data_of, only
from tests.sure import sure
from tests.twin import PROFILES

SIGMA_M = 15e-6


def readings_with(bend, shift, N=200, stated: float | None = SIGMA_M) -> tuple[ArmData, JointFit]:
    """Geometry fitted to readings with joint offsets ``bend(q)`` and shifts ``shift(p)`` of the measured points."""
    profile = load_profile(PROFILES / "twin.yaml")
    rng = np.random.default_rng(7)
    q = rng.uniform(-2.0, 2.0, (N, 6))
    p_M, approach = smr_positions(arm_of(profile).geometry, q + bend(q)), np.sign(rng.uniform(-1.0, 1.0, (N, 6)))
    p_M += shift(p_M) + rng.normal(0.0, SIGMA_M, (N, 3))
    data = data_of(profile, q, approach, p_M, stated, 60.0 * np.arange(N, dtype=np.float64))
    return data, fit_terms(data, ())


def searched(data: ArmData, fit: JointFit) -> tuple[SearchProblem, SearchState]:
    """A search that stands at a fit."""
    problem = SearchProblem(data, (), np.zeros(20), 30.0, JobToken(), lambda words: None)
    return problem, SearchState(data, fit)


def crosstalk(q):
    """Joint 4 is off by a law of joint 5."""
    return only(4, 2e-4 * np.sin(3.0 * q[:, 4]))


def test_an_unknown_law_is_found_and_named_effects_that_imitate_it_go():
    data, _ = readings_with(crosstalk, np.zeros_like)
    problem, start = searched(*refit(data, ()))
    found = sure(with_data_driven_terms(problem, start))
    assert [term.law.name for term in found.fit.terms] == ["joint 4|q5"]
    wobble = EFFECTS["joint_axis_wobble"].laws(start.data.context)[0]
    names = tuple(column.name for column in data.columns("joint_axis_wobble", wobble))
    named = problem.state((ModelTerm("joint_axis_wobble", wobble, names),), start)
    instead = sure(in_place_of_names(problem, start, named))
    assert instead.fit.terms == found.fit.terms
    assert in_place_of_names(problem, start, start) is None, "nothing was named"


@pytest.mark.parametrize(
    ("periods", "stated", "slug"),
    [(0.7, SIGMA_M, "base_drift"), (3.0, SIGMA_M, UNKNOWN), (0.7, None, "base_drift"), (3.0, None, UNKNOWN)],
)
def test_a_slow_drift_to_and_fro_keeps_its_name_and_a_sway_has_none(periods, stated, slug):
    phase = 2.0 * np.pi * periods * np.arange(200) / 200.0 + 0.8
    shift = 60e-6 * np.sin(phase)[:, None] * np.array([1.0, 0.6, -0.4])
    data, _ = readings_with(np.zeros_like, lambda p: shift, stated=stated)
    found = search(data, tuple(slug for slug in EFFECTS if slug != UNKNOWN), JobSteps())
    assert [term.slug for term in found.fit.terms] == [slug]


def test_weights_without_a_stated_uncertainty_forget_the_scatter_of_a_term_that_goes():
    data, _ = readings_with(np.zeros_like, np.zeros_like, stated=None)
    by_joint = replace(data, sigma=uncertainty_with_scatter(data, Excess(SIGMA_M, joints=(1e-5,) * 6)))
    weighted, _ = refit(by_joint, ())
    assert weighted.sigma == pytest.approx(refit(data, ())[0].sigma, rel=1e-3)


def named(problem: SearchProblem, start: SearchState, slugs: Sequence[str]) -> SearchState:
    """A state with the middle law of some effects."""
    laws = [EFFECTS[slug].laws(start.data.context) for slug in slugs]
    middle = [(slug, some[len(some) // 2]) for slug, some in zip(slugs, laws, strict=True)]
    names = [tuple(column.name for column in start.data.columns(slug, law)) for slug, law in middle]
    terms = [ModelTerm(slug, law, its) for (slug, law), its in zip(middle, names, strict=True)]
    return problem.state(tuple(terms), start)


@pytest.mark.parametrize(("size", "name"), [pytest.param(2.5, "joint 4|q5", marks=pytest.mark.slow), (1.0, None)])
def test_a_term_explains_a_visible_share_of_what_is_left(size, name):
    """Beside a scatter that no law explains, a law of 5 % of the sum of squares is significant in 1000 readings."""
    rng = np.random.default_rng(4)

    def bend(q):
        return size * crosstalk(q) + 6e-5 * rng.normal(size=q.shape)

    problem, start = searched(*refit(readings_with(bend, np.zeros_like, 1000)[0], ()))
    found = with_data_driven_terms(problem, start)
    assert (None if found is None else found.fit.terms[0].law.name) == name


def test_a_field_over_the_workspace_is_one_smooth_term():
    field = RandomField.sampled(11, 0.6)
    data, fit = readings_with(np.zeros_like, lambda p: 60e-6 * field.at(p))
    found = sure(fit_process(data, fit, 30.0))
    terms = process_terms(*found)
    assert [(term.slug, term.law.name) for term in terms] == [(UNKNOWN, "base shift|x|y|z")]
    data, after = refit(data, terms)
    assert np.std(fit.identification.residuals) > 2.0 * SIGMA_M
    assert np.std(after.identification.residuals) < 1.05 * SIGMA_M
    described = describe(data, after, 0)
    assert (described.channel, described.variables) == ("base shift", ("x", "y", "z"))
    assert "depends on the position, a field over the workspace" in described.sentence
    assert described.size_um == pytest.approx(60.0 * np.sqrt(3.0), rel=0.35)


def test_beside_a_field_a_law_counts_for_what_the_waves_of_the_field_cannot_follow():
    field = RandomField.sampled(11, 0.3)

    def gain(amplitude: float) -> float:
        data, fit = readings_with(
            lambda q: amplitude * np.sin(2.0 * q) * (np.arange(6) == 2), lambda p: 60e-6 * field.at(p)
        )
        found = sure(fit_process(data, fit, 30.0))
        data, fit = refit(data, tuple(term for term in process_terms(*found) if term.law.form == FIELD))
        beside = sure(BesideField.of(data, fit))
        assert BesideField.of(data, fit) is beside, "made once for a fit"
        law = fit.candidates(data, ["transmission_error"])[0]
        return beside.gain(law.rows[[column.name in ("cos2q3", "sin2q3") for column in law.columns]])

    assert gain(0.0) < 0.0
    assert gain(1e-4) > 30.0


def lines(cycles: Sequence[int], joints: Sequence[int]) -> ModelTerm:
    """Lines of a transmission error of some joints, from 1."""
    names = tuple(f"{wave}{count}q{joint}" for joint in joints for count in cycles for wave in ("cos", "sin"))
    return ModelTerm(TRANSMISSION_ERROR, LINES.law(), names)


def test_a_free_function_beside_a_law_of_its_effect_has_no_name_however_probable(monkeypatch):
    """Bumps of joints 2 to 4 on top of two cycles of joint 4 are no second error of transmissions."""

    def bend(q):
        bumps = 2e-4 * np.exp(-(((q - 0.3) / 0.3) ** 2)) * (np.abs(np.arange(6) - 2) <= 1)
        return bumps + 2e-4 * np.sin(2.0 * q) * (np.arange(6) == 3)

    data, fit = readings_with(bend, np.zeros_like)
    problem, start = searched(data, fit)
    two_cycles = EFFECTS[TRANSMISSION_ERROR].laws(start.data.context)[0]
    known = ModelTerm(TRANSMISSION_ERROR, two_cycles, ("cos2q4", "sin2q4"))
    beside = sure(stepwise.with_smooth_terms(problem, problem.state((known,), start)))
    assert [(term.slug, term.smooth is None) for term in beside.fit.terms] == [
        (TRANSMISSION_ERROR, True),
        (TRANSMISSION_ERROR, False),
    ]
    monkeypatch.setattr(
        stepwise, "posteriors_of", lambda found, scan: Posteriors((1.0,) * len(found.reviews), {})
    )  # every name is sure
    found = stepwise._probable(problem, stepwise._result(problem, beside, fit), beside)
    assert [term.slug for term in found.fit.terms] == [TRANSMISSION_ERROR, UNKNOWN]


def probable(problem: SearchProblem, state: SearchState) -> float:
    """The probability of the last name of a model in which a search ends."""
    reviews = tuple(review(problem, state, number) for number in range(len(state.fit.terms)))
    found = SearchResult(state.data, state.fit, state.fit, reviews, (), (), problem.threshold)
    return posteriors_of(found, remaining_scan(found)).terms[-1]


def eccentric(q):
    return 3e-4 * np.sin(q + 1.0) * (np.arange(6) == 2)


@pytest.mark.parametrize(
    ("bend", "n", "slug", "probability"),
    [
        (eccentric, 40, "encoder_eccentricity", 0.982),  # the library may lack the cause of any name
        (eccentric, 40, "transmission_error", 0.0),
        (crosstalk, 40, "joint_axis_wobble", 0.049),
    ],
)
def test_a_name_of_a_few_readings_is_as_probable_as_it_beats_laws_without_a_name(bend, n, slug, probability):
    problem, start = searched(*refit(readings_with(bend, np.zeros_like, n)[0], ()))
    best = best_new_score(problem, start, slug)
    state = problem.state((ModelTerm(slug, best.candidate.law, best.names),), start)
    assert probable(problem, state) == pytest.approx(probability, rel=0.05, abs=1e-3)


@pytest.mark.parametrize(("cycles", "probability"), [((2, 3, 4, 5), 0.75), ((2, 20), 0.98), (None, 0.75)])
def test_a_free_function_is_less_probable_than_a_gear(cycles, probability):
    """A series of the lowest cycles, a gear, and a smooth curve."""
    data, fit = readings_with(
        lambda q: 1e-4 * np.sum([np.cos(k * q - 0.4) for k in cycles or (1, 2)], axis=0) * (np.arange(6) == 0),
        np.zeros_like,
    )
    smooth = sure(fit_process(data, fit, 30.0))
    terms = (lines(cycles, (1,)),) if cycles else process_terms(*smooth)
    assert probable(*searched(*refit(data, terms))) == pytest.approx(probability, abs=0.01)


@pytest.mark.parametrize(
    ("cycles", "joints", "beside", "named"),
    [
        ((2, 3, 4, 5), (1,), None, False),  # a series of the lowest cycles
        ((2, 3, 4, 5), (1, 2), None, True),
        ((2, 20), (1,), None, True),  # a gear
        ((2, 20), (1,), "joint 1|q1|q2", False),
        ((2, 20), (1,), "joint 2|q1|q2", True),
        ((2, 20), (1,), "joint 1|q2", False),
        ((2, 20), (1,), "joint 1|time", True),
    ],
)
def test_one_cause_is_one_unknown(cycles, joints, beside, named):
    """What one hose does to a joint is no gear's beside it, and a curve of one joint alone has no name."""

    def bent(q):
        offset = sum(np.cos(count * q - 0.4) for count in cycles) * np.isin(np.arange(1, 7), joints)
        return 3e-5 * offset

    data, _ = readings_with(bent, np.zeros_like)
    problem, start = searched(*refit(data, ()))
    terms: tuple[ModelTerm, ...] = (lines(cycles, joints),)
    if beside is not None:
        family = next(
            family.law(acts_on)
            for family in (*curve_families(data.context), *pair_families(data.context))
            for acts_on in acted_on(6)
            if family.law(acts_on).name == beside
        )
        columns = tuple(column.name for column in data.columns(UNKNOWN, family))
        terms = (*terms, ModelTerm(UNKNOWN, family, columns))
    state = problem.state(terms, start)
    found = without_imitations(problem, state)
    assert (found is state) is named
    if named:
        return
    term = found.fit.terms[0]
    assert (term.slug, term.law.name) == (UNKNOWN, f"imitation|{TRANSMISSION_ERROR}|{LINES.name}")
    assert EFFECTS[UNKNOWN].form(term.law.name) == term.law.form
    np.testing.assert_allclose(found.fit.residual, state.fit.residual, atol=1e-3)
    said = describe(found.data, found.fit, 0)
    assert (said.channel, said.variables) == ("joint 1", ("q1",))
    assert "dress pack" in EFFECTS[UNKNOWN].meaning_of(term.law).cause
    assert said.sentence.startswith("something moves joint 1 and looks like transmission error")


# -- Laws that may be off: their discrepancy terms, further joints, other effects beside them, and wobbles that are non


N = 220
THRESHOLD = 12.0


def searched_off(bend, slug="", names=(), shift=None):
    """A search that stands at one effect, or none.

    The readings have joint offsets ``bend(q, torques, approach)`` and are moved by ``shift(context)``.
    """
    profile = load_profile(PROFILES / "twin.yaml")
    model, rng = arm_of(profile), np.random.default_rng(7)
    q, approach = rng.uniform(-2.0, 2.0, (N, 6)), rng.choice([-1.0, 1.0], (N, 6))
    context = model.context(q)
    bent = bend(q, context.torques, approach)
    moved = np.zeros((N, 3)) if shift is None else shift(context)
    p_M = smr_positions(model.geometry, q + bent) + moved + rng.normal(0.0, SIGMA_M, (N, 3))
    data = data_of(profile, q, approach, p_M, SIGMA_M)
    terms = (ModelTerm(slug, EFFECTS[slug].law(), names),) if slug else ()
    problem = SearchProblem(data, tuple(EFFECTS)[:-1], np.zeros(20), THRESHOLD, JobToken(), lambda words: None)
    return problem, SearchState(*refit(data, terms))


def softer(q, torques, approach):
    """A spring at joint 2 that is softer under small torques."""
    tau = torques[:, 1]
    return only(2, 1e-5 * tau + 1.2e-4 * np.tanh(tau / 30.0))


def linear(q, torques, approach):
    return only(2, 1.2e-5 * torques[:, 1])


def test_a_law_that_is_right_has_none():
    problem, state = searched_off(linear, "joint_compliance", ("compliance2",))
    assert with_discrepancies(problem, state) is None


def best_new_score(problem, state, slug):
    scan = LawScan.of(state.fit.candidates(state.data, [slug]), state.fit.projector)
    return scan.ranked(state.fit.projected_residual)[0]


def test_what_a_law_leaves_over_is_no_other_effect():
    problem, state = searched_off(softer, "joint_compliance", ("compliance2",))
    plain = [best_new_score(problem, state, slug) for slug in ("transmission_error", "encoder_eccentricity")]
    assert max(score.value for score in plain) > THRESHOLD, "it looks like one"
    assert not any(explains_beside_discrepancies(problem, state, score) for score in plain)
    wave = ModelTerm("transmission_error", plain[0].candidate.law, plain[0].names)
    assert probable(problem, problem.state((*state.fit.terms, wave), state)) < 0.01


def test_a_small_name_beside_a_larger_one_of_the_same_variables_is_of_unknown_state():
    def both(q, torques, approach):
        return only(1, -1.5e-4 * approach[:, 0]) + only(3, -5e-7 * approach[:, 2] * np.abs(torques[:, 2]))

    problem, state = searched_off(both, "backlash", ("half_play1",))
    best = best_new_score(problem, state, "friction_windup")
    friction = ModelTerm("friction_windup", best.candidate.law, best.names)
    assert probable(problem, problem.state((*state.fit.terms, friction), state)) == pytest.approx(0.72, abs=0.02)


def test_a_further_joint_joins_before_another_name():
    def play(q, torques, approach):
        return -approach * np.array([1.5e-4, 5e-5, 0.0, 0.0, 0.0, 0.0])

    problem, state = searched_off(play, "backlash", ("half_play1",))
    step = sure(refinement(problem, state, THRESHOLD))
    (term,) = step.terms
    assert set(term.names) == {"half_play1", "half_play2"}


def test_a_tilt_both_ways_is_a_wobble():
    def tilted(context):
        wave = 2e-4 * np.sin(3.0 * context.q[:, 4] + 0.3)
        return wave[:, None] * context.twist_shift(4, None, np.array([0.6, 0.8, 0.0]))

    problem, state = searched_off(lambda q, torques, approach: np.zeros((N, 6)), shift=tilted)
    score = best_new_score(problem, state, "joint_axis_wobble")
    step = sure(addition(problem, state, score))
    assert {name[:9] for name in step.terms[0].names} == {"wobble_x5", "wobble_y5"}


def test_a_joint_that_follows_its_neighbours_angle_is_no_wobble():
    """Joint 4 that follows three cycles of joint 5 tilts the axis of joint 5 in one direction only."""
    problem, state = searched_off(lambda q, torques, approach: only(4, 3e-4 * np.sin(3.0 * q[:, 4])))
    score = best_new_score(problem, state, "joint_axis_wobble")
    assert score.value > THRESHOLD, "it looks like one"
    assert addition(problem, state, score) is None
