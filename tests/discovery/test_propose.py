"""Proposed stops tell apart what the run's own could not, more than random ones; collection comes to them as asked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.calibration.calibrate import calibrate_run
from cellapp.cli import app
from cellapp.collection.cell import Cell, build_plant, open_cell
from cellapp.collection.collect import collect_run
from cellapp.collection.motion import Mover
from cellapp.design.discrimination import Contest
from cellapp.discovery import propose as proposing
from cellapp.discovery.discover import Discovery, discover_run
from cellapp.discovery.propose import STEPS_RAD, Proposal, propose_run
from cellapp.errors import InputError
from cellapp.planning.plan import plan_stops
from cellapp.planning.stop_conditions import (
    STOP_CONDITIONS_RESULT,
    StopConditions,
    read_stop_conditions,
    write_stop_conditions,
)
from cellapp.profile import NoDriver, Profile
from cellapp.progress import Cancelled, CancelToken
from cellapp.reporting.proposal import proposal_lines
from cellapp.run import Readings, RunFile
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import refuse_motion
from drivers.arms.simulated import SimulatedArm
from tests.twin import small_twin, with_arms

STOPS = 90
PROPOSED = 20
PLAY = {"backlash": {"play": [8e-5, 8e-5, 5e-5, 0.0, 0.0, 0.0]}}
SOFT = {"joint_compliance": {"stiffness": [2e6] * 6}}
DWELL_S = 1.2


def a_profile(effects: Mapping[str, Any]) -> Profile:
    profile = small_twin(STOPS, plant={"effects": effects, "seed": 5})
    splits = profile.splits.model_copy(update={"identify": 45, "train": 25, "validate_": 20})
    network = profile.network.model_copy(update={"kind": "none"})
    return profile.model_copy(update={"splits": splits, "network": network})


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
            run.add_readings(
                name,
                Readings(
                    configuration=np.arange(STOPS),
                    time_s=np.linspace(20.0, 20.0 * STOPS, STOPS),
                    q=q,
                    approach=np.sign(step).astype(np.int8),
                    p_M=p_M,
                    payload_kg=np.full(STOPS, 0.3),
                    step=step,
                    dwell_s=np.full(STOPS, DWELL_S),
                    covariance_M=covariance_M,
                ),
            )

    return RunFile.create(folder, profile, fill)


@pytest.fixture(scope="module", autouse=True)
def fewer_candidates() -> Iterator[None]:
    """Enough for what is shown here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proposing, "_DRAWN", 70)
        patch.setattr(proposing, "_POSES", 50)
        patch.setattr(proposing, "_MOST_CANDIDATES", 3000)
        yield


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(a_profile({}))


Tied = tuple[RunFile, dict[str, Discovery], Proposal]


@pytest.fixture(scope="module")
def tied(plan: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tied]:
    """Both arms with backlash, which this run cannot tell from unsettled measurements, and what is proposed then."""
    folder = tmp_path_factory.mktemp("tied") / "run"
    with measured_run(folder, {"left": PLAY, "right": PLAY}, plan, tied=True) as run:
        calibrate_run(run)
        found = discover_run(run)
        yield run, found, propose_run(run, found, PROPOSED)


# -- the mathematics --------------------------------------------------------------------------------------------------


def test_stops_taken_one_by_one_are_the_refit_with_all_of_them() -> None:
    rng = np.random.default_rng(0)
    p, d, m = 6, 40, 15
    contest = Contest(
        rows=rng.normal(size=(p, d)) * np.geomspace(1.0, 1e4, p)[:, None],
        precision=np.array([0.0, 0.0, 0.0, 0.0, 2.0, 0.0]),
        signals=rng.normal(size=(1, d)),
        stops=rng.normal(size=(p, m, 3)) * np.geomspace(1.0, 1e4, p)[:, None, None],
        there=rng.normal(size=(1, m, 3)),
    )
    race = contest.begin()
    taken: list[int] = []
    for stop in (3, 7, 3, 14):
        promised = race.value + race.gains()[stop]
        race.take(stop)
        taken.append(stop)
        design = np.hstack([contest.rows, *(contest.stops[:, k] for k in taken), np.diag(np.sqrt(contest.precision))])
        signal = np.concatenate([contest.signals[0], *(contest.there[0, k] for k in taken), np.zeros(p)])
        fitted = np.linalg.lstsq(design.T, signal, rcond=None)[0]
        truth = float(np.sum((signal - fitted @ design) ** 2))
        assert promised == pytest.approx(truth, rel=1e-8)
        assert race.value == pytest.approx(truth, rel=1e-8)
        assert contest.discrimination(np.array(taken)) == pytest.approx(truth, rel=1e-8)


# -- what is proposed -------------------------------------------------------------------------------------------------


def test_what_a_poor_plan_cannot_tell_is_told_by_the_proposed_stops_more_than_by_random_ones(tied: Tied) -> None:
    _, found, proposal = tied
    for discovery in found.values():
        assert set(discovery.findings[0].answer_set) == {"backlash", "unsettled_measurement"}
    assert len(proposal.stops) == PROPOSED
    for arm in ("left", "right"):
        answers = {(a.effect, a.against): a for a in proposal.answers if a.arm == arm}
        assert set(answers) == {("backlash", "unsettled_measurement"), ("unsettled_measurement", "backlash")}
        for answer in answers.values():
            assert answer.now < 0.1
            assert answer.proposed > 1.0
        hardest = min(answers.values(), key=lambda answer: answer.proposed / answer.needed)
        assert hardest.gain > 1.5


def test_compliance_and_bending(plan: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proposing, "_DRAWN", 200)
    monkeypatch.setattr(proposing, "_POSES", 140)
    with measured_run(tmp_path / "run", {"left": SOFT}, plan, tied=False) as run:
        calibrate_run(run)
        found = discover_run(run)
        assert {"joint_compliance", "link_bending"} <= set(found["left"].findings[0].answer_set)
        proposal = propose_run(run, found, 2 * PROPOSED)
        elastic = {"joint_compliance", "link_bending"}
        answers = [a for a in proposal.answers if a.arm == "left" and {a.effect, a.against} == elastic]
        assert len(answers) == 2
        for answer in answers:
            assert answer.now < answer.random < answer.proposed
            assert answer.gain > 1.3
        # neither feels the last step: nobody goes a detour for it, and a person is told of the load
        assert all(
            one == StopConditions() or one.via is None for stop in proposal.stops for one in stop.factors.values()
        )
        assert any("another load would tell" in advice for advice in proposal.advice)
        seen = [answer for answer in proposal.answers if answer.arm == "right"]
        assert seen, "where nothing was found the stops make the faintest effects more visible"
        assert all(answer.against == "" and answer.proposed > answer.random for answer in seen)


def test_every_leg_is_inside_the_limits_and_free(tied: Tied) -> None:
    run, _, proposal = tied
    cell = cell_bodies(run.profile)
    sizes, signs = set(), set()
    for stop in proposal.stops:
        start = {}
        for name, q in stop.q.items():
            via = stop.factors[name].via
            assert via is not None
            start[name] = via
            sizes |= set(np.round(np.abs(q - via), 9).tolist())
            signs |= set(np.sign(q - via).tolist())
        assert refuse_motion(cell, start, stop.q) == ""
        assert refuse_motion(cell, start, start) == ""
    assert sizes == set(STEPS_RAD)
    assert signs == {-1.0, 1.0}
    dwells = {one.dwell_s for stop in proposal.stops for one in stop.factors.values()}
    assert dwells == set(proposing.DWELLS_S)


def test_the_proposal_in_words_and_as_json(tied: Tied) -> None:
    _, _, proposal = tied
    result = json.loads(json.dumps(proposal.as_dict()))
    assert (result["count"], result["written"], result["first_configuration"]) == (PROPOSED, True, STOPS)
    assert len(result["stops"]) == 2 * PROPOSED
    assert {row["configuration"] for row in result["stops"]} == set(range(STOPS, STOPS + PROPOSED))
    lines = proposal_lines(result)
    assert sum("backlash / unsettled_measurement" in line for line in lines) == 2
    assert all(len(line) <= 80 for line in lines)
    assert any("would tell" in line for line in lines)
    assert f"stops {STOPS + 1} to {STOPS + PROPOSED}" in " ".join(lines)


def test_it_stands_in_the_run_and_a_new_one_takes_its_place(tied: Tied, plan: dict[str, np.ndarray]) -> None:
    run, found, proposal = tied
    for name, q in run.read_plan().items():
        np.testing.assert_array_equal(q[:STOPS], plan[name])
        np.testing.assert_array_equal(q[STOPS:], [stop.q[name] for stop in proposal.stops])
    factors = read_stop_conditions(run)
    assert sorted(factors) == list(range(STOPS, STOPS + PROPOSED))
    for number, stop in enumerate(proposal.stops):
        for name, one in stop.factors.items():
            np.testing.assert_array_equal(factors[STOPS + number][name].via, one.via)
    try:
        again = propose_run(run, found, 5)
        assert again.first == STOPS
        assert len(run.read_plan()["left"]) == STOPS + 5
        assert sorted(read_stop_conditions(run)) == list(range(STOPS, STOPS + 5))
    finally:
        proposing._write(run, proposal.stops)


def test_a_run_that_is_not_driven_gets_the_list_only(
    tied: Tied, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _, _ = tied
    monkeypatch.setattr(proposing, "_DRAWN", 20)
    monkeypatch.setattr(proposing, "_MOST_CANDIDATES", 480)
    readings = {name: run.readings(name) for name in run.arms()}

    def fill(copy: RunFile) -> None:
        for name, arm in readings.items():
            copy.add_readings(name, replace(arm, split=None))

    drivers = with_arms(run.profile, driver=NoDriver(kind="none"))
    placeless = with_arms(drivers, base=None)
    for number, (profile, says) in enumerate(
        [(run.profile, "no plan"), (drivers, "driver of arms.left is 'none'"), (placeless, "were measured")]
    ):
        with RunFile.create(tmp_path / str(number), profile, fill) as other:
            calibrate_run(other)
            proposal = propose_run(other, discover_run(other), 4)
            assert len(proposal.stops) == 4
            assert proposal.first is None
            assert any(says in note for note in proposal.notes)
            assert any("listed only" in note for note in proposal.notes)
            assert other.read_plan() == {}
            assert other.read_result(STOP_CONDITIONS_RESULT) is None
            assert not proposal.as_dict()["written"]


def test_the_command(tied: Tied, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, _, _ = tied
    monkeypatch.setattr(proposing, "_DRAWN", 20)
    monkeypatch.setattr(proposing, "_MOST_CANDIDATES", 480)
    out = tmp_path / "result.json"
    command = ["discover", str(run.folder), "--propose", "3", "--json", str(out)]
    try:
        done = CliRunner().invoke(app, command, catch_exceptions=False)
        assert done.exit_code == 0
        proposal = json.loads(out.read_text("utf-8"))["proposal"]
        assert proposal["count"] == 3
        assert "3 proposed stops" in done.output
        assert "collect DIR --resume" in " ".join(done.output.split())
    finally:
        proposing._write(run, tied[2].stops)


# -- collecting it ----------------------------------------------------------------------------------------------------


def test_collecting_them_tells_the_effects_apart(plan: dict[str, np.ndarray], tmp_path: Path) -> None:
    with measured_run(tmp_path / "run", {"left": PLAY, "right": PLAY}, plan, tied=True) as run:
        calibrate_run(run)
        before = {name: discovery.findings[0] for name, discovery in discover_run(run).items()}
        assert all(len(finding.answer_set) == 2 for finding in before.values())
        proposal = propose_run(run, discover_run(run), 2 * PROPOSED)
        held_out = {name: run.readings(name).in_split("validate") for name in plan}
        assert collect_run(run, resume=True)[:-1] == ()
        for name in plan:
            readings = run.readings(name)
            assert len(readings) == STOPS + 2 * PROPOSED
            np.testing.assert_array_equal(readings.in_split("validate"), held_out[name])
            assert readings.step is not None
            assert readings.dwell_s is not None
            for row, stop in enumerate(proposal.stops, start=STOPS):
                asked = stop.factors[name]
                assert readings.split is not None
                assert readings.split[row] == "train"
                assert asked.via is not None
                np.testing.assert_allclose(readings.step[row], stop.q[name] - asked.via, atol=1e-9)
                np.testing.assert_array_equal(readings.approach[row], np.sign(stop.q[name] - asked.via))
                assert asked.dwell_s < readings.dwell_s[row] < asked.dwell_s + 10.0
        calibrate_run(run)
        for name, discovery in discover_run(run).items():
            assert discovery.findings[0].term.slug == "backlash", name
            assert discovery.findings[0].answer_set == ("backlash",), name


class Moves:
    """What the simulated arms were sent to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.goals: list[tuple[str, np.ndarray]] = []
        moves = self

        class Arm(SimulatedArm):
            def start_move(self, q: Any, *rest: Any) -> None:
                moves.goals.append((self.name, np.array(q)))
                super().start_move(q, *rest)

        drivers = {"simulated": lambda name, arm, plant: Arm(plant, name)}
        monkeypatch.setattr("cellapp.collection.cell.ARM_DRIVERS", drivers)

    def went(self, name: str, q: np.ndarray) -> bool:
        return any(arm == name and np.allclose(goal, q) for arm, goal in self.goals)


def test_nothing_moves_that_the_gate_refuses(
    plan: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves = Moves(monkeypatch)
    few = {name: q[:3] for name, q in plan.items()}
    into_the_floor = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    beyond = few["right"][2] + 20.0
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_plan(few)
        write_stop_conditions(
            run, {1: {"left": StopConditions(into_the_floor)}, 2: {"right": StopConditions(beyond, 1.0)}}
        )
        notes = collect_run(run)
        assert run.stops_done() == {0}
        assert [note[:34] for note in notes[:2]] == [
            "stop 2: left out: refused to move:",
            "stop 3: left out: refused to move:",
        ]
        assert "floor" in notes[0]
        assert "limits" in notes[1]
        assert [event.text for event in run.events() if event.level == "warning"] == list(notes[:2])
    assert not moves.went("left", into_the_floor)
    assert not moves.went("right", beyond)
    for name in few:
        assert not moves.went(name, few[name][1])
        assert not moves.went(name, few[name][2])


def test_via_and_dwell_of_one_arm_are_honoured(
    plan: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves = Moves(monkeypatch)
    few = {name: q[:2] for name, q in plan.items()}
    via = few["left"][1] - 0.03
    with RunFile.create(tmp_path / "run", small_twin(2)) as run:
        run.write_plan(few)
        write_stop_conditions(run, {1: {"left": StopConditions(via, 30.0), "right": StopConditions()}})
        collect_run(run)
        left, right = run.readings("left"), run.readings("right")
    assert left.step is not None
    assert right.step is not None
    assert left.dwell_s is not None
    assert right.dwell_s is not None
    np.testing.assert_allclose(left.step[1], 0.03, atol=1e-9)
    np.testing.assert_allclose(right.step[1], few["right"][1] - few["right"][0], atol=1e-9)
    home = home_positions(small_twin(2))
    np.testing.assert_allclose(left.step[0], few["left"][0] - home["left"], atol=1e-9)
    assert moves.went("left", via)
    assert 30.0 < left.dwell_s[1] < 33.0
    assert right.dwell_s[1] < 6.0, "who need not wait is measured first"
    assert left.time_s[1] > right.time_s[1]
    assert 0.0 < left.dwell_s[0] < 6.0


def test_a_real_arms_wait_ends_when_somebody_asks_to_stop() -> None:
    profile = small_twin(2)
    with open_cell(profile) as cell:
        real = Cell(cell.arms, cell.tracker, None)
        mover, token = Mover(profile, real, cell_bodies(profile)), CancelToken()
        mover.rest("left", 0.0, token)
        token.cancel()
        with pytest.raises(Cancelled):
            mover.rest("left", 600.0, token)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[]", "damaged"),
        ('{"1": {"left": {"via": [0, 1]}}}', "6 finite joint positions"),
        ('{"1": {"left": {"dwell_s": 1e9}}}', "between 0 and 600 s"),
        ('{"1": {"middle": {}}}', "middle"),
        ('{"one": {}}', "damaged"),
    ],
)
def test_damaged_factors_are_named(tmp_path: Path, text: str, says: str) -> None:
    with RunFile.create(tmp_path / "run", small_twin(2)) as run:
        run.write_result(STOP_CONDITIONS_RESULT, text)
        with pytest.raises(InputError, match=says):
            read_stop_conditions(run)
