"""Proposed stops decide what the run left open, better than random ones, and collection measures them."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning import propose as proposing
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.planning.planned_stops import STOP_CONDITIONS_RESULT, read_planned_stops
from cellapp.cell.planning.propose import DWELLS_S, STEPS_RAD, Effort, Proposal, append_proposed_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_motion
from cellapp.commands.discover.run import propose_after
from cellapp.estimation.discovery.arm_data import UNKNOWN, CandidateLaw, LawScore, ModelTerm
from cellapp.estimation.discovery.joint_fit import ProjectedResidual
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.posterior import posteriors
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.state import Review, possible_score
from cellapp.ground.profile import Profile
from cellapp.robot.effects import ActsOn, EffectColumn
from drivers.no_driver import NoDriver
from tests.estimation.discovery.problems import PLAIN, calibrated_and_searched, problem, proposed
from tests.program import app
from tests.series import readings_at
from tests.sure import sure
from tests.twin import altered, small_twin, with_arms

STOPS = 90
PROPOSED = 20
PLAY = {"backlash": {"play": [8e-5, 8e-5, 5e-5, 0.0, 0.0, 0.0]}}
DWELL_S = 1.2
EFFORT = Effort(sampled=70, kept=50, candidates=3000)
"""Fewer candidates than by default: enough for these claims."""
LITTLE = Effort(sampled=20, kept=50, candidates=480)


def a_profile(effects: Mapping[str, Any]) -> Profile:
    profile = small_twin(STOPS, plant={"effects": effects, "seed": 5})
    return altered(profile, splits={"identify": 45, "train": 25, "validate_": 20}, network={"kind": "none"})


def measured_run(folder: Path, effects: Mapping[str, Any], plan: dict[str, np.ndarray], *, tied: bool) -> RunFile:
    """A run whose readings the plant made in one go; ``tied``: every last step has the same size, so that lost motion
    and a measurement before settling look alike."""
    profile = a_profile(effects)
    plant, homes, rng = build_plant(profile), home_positions(profile), np.random.default_rng(1)

    def fill(run: RunFile) -> None:
        run.write_plan(plan)
        for name, q in plan.items():
            step = np.diff(np.vstack([homes[name], q]), axis=0)
            step = 0.3 * np.sign(step) if tied else step
            exact = plant.smr_positions(name, q, last_step=step, since_rest_s=np.full(STOPS, DWELL_S))
            p_M, covariance_M = plant.measure_positions(exact, rng)
            told = {"payload_kg": 0.3, "dwell_s": DWELL_S, "step": step, "covariance_M": covariance_M}
            time_s = np.linspace(20.0, 20.0 * STOPS, STOPS)
            run.add_readings(name, readings_at(q, p_M, time_s=time_s, approach=np.sign(step), **told))

    return RunFile.create(folder, profile, fill)


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(a_profile({}))


Tied = tuple[RunFile, CellDiscovery, Proposal]


@pytest.fixture(scope="module")
def searched(plan: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CellDiscovery]:
    """Both arms have backlash, which this run cannot distinguish from unsettled measurements; not to be written to."""
    folder = tmp_path_factory.mktemp("searched") / "run"
    with measured_run(folder, {"left": PLAY, "right": PLAY}, plan, tied=True) as run:
        return folder, calibrated_and_searched(run)


@pytest.fixture(scope="module")
def tied(searched: tuple[Path, CellDiscovery], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tied]:
    """A copy of the searched run, with the proposal in its plan."""
    folder, found = searched
    copy = shutil.copytree(folder, tmp_path_factory.mktemp("tied") / "run")
    with RunFile.open(copy, write=True) as run:
        proposal = proposed(run, found, PROPOSED, EFFORT)
        append_proposed_stops(run, proposal.stops)
        yield run, found, proposal


def test_proposed_stops_decide_what_a_poor_plan_leaves_open_and_better_than_random_ones(tied: Tied) -> None:
    _, found, proposal = tied
    for discovery in found.arms.values():
        assert set(discovery.result.accepted[0].answer_set) == {"backlash", "unsettled_measurement"}
    assert len(proposal.stops) == PROPOSED
    for arm in ("left", "right"):
        answers = {(one.effect, one.against): one for one in proposal.questions[arm]}
        assert set(answers) == {("backlash", "unsettled_measurement"), ("unsettled_measurement", "backlash")}
        for answer in answers.values():
            assert answer.discrimination.now < 0.1
            assert answer.discrimination.proposed > 1.0
        hardest = min(answers.values(), key=lambda answer: answer.discrimination.proposed / answer.needed)
        assert hardest.gain_over_random > 1.5


def test_every_leg_is_inside_the_limits_and_free(tied: Tied) -> None:
    run, _, proposal = tied
    cell = cell_bodies(run.profile)
    sizes, signs = set(), set()
    for stop in range(len(proposal.stops)):
        start, there = proposal.stops.approach_starts(stop), proposal.stops.targets(stop)
        assert set(start) == set(there)
        for name, q in there.items():
            via = start[name]
            sizes |= set(np.round(np.abs(q - via), 9).tolist())
            signs |= set(np.sign(q - via).tolist())
        assert refuse_motion(cell, start, there) == ""
        assert refuse_motion(cell, start, start) == ""
    assert sizes == set(STEPS_RAD)
    assert signs == {-1.0, 1.0}
    assert {*np.concatenate(list(proposal.stops.dwell_s.values()))} == set(DWELLS_S)


def test_the_proposal_is_in_the_plan_until_a_new_one_replaces_it(tied: Tied, plan: dict[str, np.ndarray]) -> None:
    run, found, proposal = tied
    for name, q in run.read_plan().items():
        np.testing.assert_array_equal(q[:STOPS], plan[name])
        np.testing.assert_array_equal(q[STOPS:], proposal.stops.q[name])
    stops = read_planned_stops(run)
    assert np.flatnonzero(stops.proposed).tolist() == list(range(STOPS, STOPS + PROPOSED))
    for name, start in stops.approach_from.items():
        np.testing.assert_array_equal(start[STOPS:], proposal.stops.approach_from[name])
    try:
        again = propose_after(run, found, 5, effort=EFFORT)
        assert again.first_configuration == STOPS
        assert len(run.read_plan()["left"]) == STOPS + 5
        assert np.flatnonzero(read_planned_stops(run).proposed).tolist() == list(range(STOPS, STOPS + 5))
    finally:
        append_proposed_stops(run, proposal.stops)


def test_a_run_that_is_not_driven_gets_the_list_only(tied: Tied, tmp_path: Path) -> None:
    run, found, _ = tied
    readings = {name: run.readings(name) for name in run.arms()}

    def fill(copy: RunFile) -> None:
        for name, arm in readings.items():
            copy.add_readings(name, arm)

    drivers = with_arms(run.profile, driver=NoDriver())
    placeless = with_arms(drivers, base=None)
    for number, (profile, says) in enumerate(
        [(run.profile, "no plan"), (drivers, "driver of arms.left is 'none'"), (placeless, "were measured")]
    ):
        with RunFile.create(tmp_path / str(number), profile, fill) as other:
            proposal = propose_after(other, found, 4, effort=LITTLE)
            assert proposal.count == 4
            assert proposal.first_configuration is None
            assert any(says in note for note in proposal.notes)
            assert any("listed only" in note for note in proposal.notes)
            assert other.read_plan() == {}
            assert other.read_document(STOP_CONDITIONS_RESULT) is None
            assert not proposal.written


def test_the_command(tied: Tied, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, _, _ = tied
    monkeypatch.setattr(proposing, "DEFAULT_EFFORT", LITTLE)
    out = tmp_path / "result.json"
    command = ["discover", str(run.folder), "--propose", "3", "--json", str(out)]
    try:
        done = CliRunner().invoke(app, command, catch_exceptions=False)
        assert done.exit_code == 0
        proposal = json.loads(out.read_text("utf-8"))["proposal"]
        assert (proposal["count"], proposal["written"], proposal["first_configuration"]) == (3, True, STOPS)
        assert [row["configuration"] for row in proposal["stops"]] == sorted(2 * [*range(STOPS, STOPS + 3)])
        said = " ".join(done.output.split())
        assert said.count("backlash unsettled_measurement") == 2
        for words in ("3 proposed stops", "these stops", f"stops {STOPS + 1} to {STOPS + 3}", "with --resume"):
            assert words in said
    finally:
        append_proposed_stops(run, tied[2].stops)


@pytest.mark.slow
def test_collecting_the_proposed_stops_distinguishes_the_effects(
    searched: tuple[Path, CellDiscovery], tmp_path: Path
) -> None:
    folder, found = searched
    with RunFile.open(shutil.copytree(folder, tmp_path / "run"), write=True) as run:
        assert all(len(discovery.result.accepted[0].answer_set) == 2 for discovery in found.arms.values())
        proposal = proposed(run, found, 4 * PROPOSED, EFFORT)
        append_proposed_stops(run, proposal.stops)
        held_out = {name: run.readings(name).in_split("validate") for name in run.arms()}
        assert collect_run(run, resume=True).notes[:-1] == ()
        for name in run.arms():
            readings = run.readings(name)
            assert len(readings) == STOPS + 4 * PROPOSED
            np.testing.assert_array_equal(readings.in_split("validate"), held_out[name])
            step = proposal.stops.q[name] - proposal.stops.approach_from[name]
            for stop, row in enumerate(range(STOPS, STOPS + PROPOSED)):
                assert sure(readings.split)[row] == "train"
                np.testing.assert_allclose(sure(readings.step)[row], step[stop], atol=1e-9)
                np.testing.assert_array_equal(readings.approach[row], np.sign(step[stop]))
                assert 0.0 < sure(readings.dwell_s)[row] - proposal.stops.dwell_s[name][stop] < 10.0
        for name, discovery in calibrated_and_searched(run).arms.items():
            assert discovery.result.accepted[0].effect == "backlash", name
            assert "unsettled_measurement" not in discovery.result.accepted[0].answer_set, name
            assert sure(discovery.result.accepted[0].posterior) > 0.9, name
            assert discovery.result.candidates["unsettled_measurement"] < 0.01, name


def test_the_pure_computation_is_reproducible(tied: Tied) -> None:
    run, found, _ = tied
    first, second = (proposed(run, found, 2, LITTLE) for _ in range(2))
    assert first.questions == second.questions
    for name, q in first.stops.q.items():
        np.testing.assert_array_equal(q, second.stops.q[name])


# -- Posterior probabilities of effects from the scores of competing sets ----------------------------------------------

THRESHOLD = 8.0
COORDINATES = 900


def review(slug, score, **alternatives):
    return Review(ModelTerm(slug, PLAIN.law(), ()), score, 0.001, (), alternatives)


def test_a_score_at_the_threshold_leaves_it_open():
    found = posteriors([review("backlash", THRESHOLD)], {}, THRESHOLD, COORDINATES)
    assert found.terms[0] == pytest.approx(0.5)
    assert found.effects["backlash"] == found.terms[0]
    for above, probability in ((0.0, 0.5), (2.0 * math.log(3.0), 0.75)):
        found = posteriors([], {"backlash": THRESHOLD + above}, THRESHOLD, COORDINATES)
        assert found.effects["backlash"] == pytest.approx(probability)


def test_alternatives_that_tie_share_the_probability():
    tied = review("backlash", 900.0, unsettled_measurement=900.0, friction_windup=300.0, base_step=-math.inf)
    found = posteriors([tied, review("joint_compliance", 400.0)], {}, THRESHOLD, COORDINATES)
    np.testing.assert_allclose(found.terms, (0.5, 1.0), atol=1e-3)
    assert found.effects["unsettled_measurement"] == pytest.approx(0.5, abs=1e-3)
    assert found.effects["friction_windup"] < 1e-4
    assert found.effects["base_step"] == 0.0
    three = review("backlash", 900.0, unsettled_measurement=900.0, friction_windup=900.0)
    assert posteriors([three], {}, THRESHOLD, COORDINATES).terms[0] == pytest.approx(1.0 / 3.0, abs=1e-3)
    close = posteriors([review("backlash", 100.0, friction_windup=80.0, base_step=80.0)], {}, THRESHOLD, COORDINATES)
    assert close.effects["friction_windup"] > 10.0 * close.effects["base_step"], "it looks like the name"


def test_two_terms_of_one_effect_count_as_one():
    found = posteriors(
        [review("transmission_error", 3.0), review("transmission_error", 20.0)], {}, THRESHOLD, COORDINATES
    )
    wanted = 1.0 / (1.0 + math.exp(-(23.0 - THRESHOLD) / 2.0))
    np.testing.assert_allclose(found.terms, wanted)


def test_data_driven_terms_are_effects_of_their_own_and_not_among_the_names():
    found = posteriors([review(UNKNOWN, THRESHOLD), review(UNKNOWN, 300.0)], {"backlash": -2.0}, THRESHOLD, COORDINATES)
    assert found.terms[0] == pytest.approx(0.5, abs=0.01)
    assert found.terms[1] == pytest.approx(1.0)
    assert set(found.effects) == {"backlash"}


def bounded(name, block):
    return EffectColumn(name, "rad", block, 0.0, 1.0e3, ActsOn.BASE)


def test_impossible_values_are_no_evidence():
    case = problem(7)
    rows = case.rng.normal(size=(2, len(case.projector.basis)))
    law = CandidateLaw("first", PLAIN.law(), (bounded("a", "one"), bounded("b", "two")), rows)

    def score(signal):
        residual = ProjectedResidual(case.projector, case.visible(signal + case.noise()))
        found = LawScan.of([law], case.projector).score(0, residual)
        assert isinstance(found, LawScore)
        return found.value, possible_score(residual, found)

    value, possible = score(2.0 * rows[0] + rows[1])
    assert possible == value
    value, possible = score(2.0 * rows[0] - 1.0 * rows[1])
    assert 0.0 < possible < value - 50.0
    value, possible = score(-2.0 * rows[0] - rows[1])
    assert value > 100.0
    assert possible == -math.inf
