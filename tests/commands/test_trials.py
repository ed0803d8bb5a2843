"""Blind trials: a run contains nothing of its truth, a broken seal is refused, judging continues, scores are right."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.trials.blind import beyond_geometry
from cellapp.commands.trials.judge import TRIAL_RESULT, judge_run, judge_trials, score_run, source_digest
from cellapp.commands.trials.scoring import ArmFindings, JudgeResult, ScoredRun, judge_tables, scores
from cellapp.commands.trials.sealed import DescribedTerm, GroundTruth, HiddenLaw, check_seal, open_truth, seal_trials
from cellapp.commands.trials.sealed_setup import CONFOUNDED, EXPECTED, PAIRS, TRIPLES, Setup, cases, library_name
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.executors import PoolWork
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, JobToken, Progress
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import JointAngles, jacobian, parameter_names, smr_positions
from cellapp.robot.kinematics.transforms import transform
from cellapp.robot.model.nominal import nominal_arm
from drivers.plant import OUTSIDE, REALISTIC
from tests.approved import assert_approved, commands_of
from tests.cell.run.small_runs import alter_file
from tests.interfaces.cli.conftest import exit_code
from tests.twin import PROFILES, altered, small_twin

STOPS, SEED = 36, 5
ROWS = {"identify": 12, "train": 12, "validate_": 12, "pair_identify": 6, "pair_validate": 6}


def small() -> Profile:
    """The twin with few stops, and few simulations to set the threshold from."""
    profile = small_twin(STOPS, plan={"method": "random"})
    return altered(profile, splits=ROWS, discovery={"null_simulations": 20})


@pytest.fixture(scope="module")
def all_kinds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten sealed runs, of every kind; nobody may change them."""
    folder = tmp_path_factory.mktemp("sealed") / "trials"
    assert seal_trials(small(), folder, 10, Setup(kind="mixed"), seed=SEED).runs == 10
    return folder


@pytest.fixture(scope="module")
def judged_once(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str], JudgeResult]:
    """Three sealed runs that hide nothing, judged in two goes: folder, what the first go left in them, and outcome."""
    folder = tmp_path_factory.mktemp("judged") / "trials"
    seal_trials(small(), folder, 3, Setup(kind="none"), seed=SEED)

    def stop_after_the_first(event: Progress) -> None:
        if event.done == 1:
            job.cancel()

    job = JobToken(stop_after_the_first)
    with pytest.raises(Cancelled):
        judge_trials(folder, PoolWork(job=job))
    first = stored(folder)
    return folder, first, judge_trials(folder, PoolWork())


@pytest.fixture
def mine(all_kinds: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copytree(all_kinds, tmp_path / "trials"))


def stored(folder: Path) -> list[str]:
    """What stands in the runs that were judged, in their order; empty for the others."""
    texts = []
    for path in sorted(folder.glob("run-*")):
        with RunFile.open(path) as run:
            texts.append(run.read_document(TRIAL_RESULT) or "")
    return texts


def call(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: object
) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    code = exit_code(monkeypatch, *arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


# -- sealing ----------------------------------------------------------------------------------------------------------


def numbers_in(value: Any) -> Iterator[str]:
    """Every number of a truth as JSON writes it, if it is long enough not to be met by chance."""
    if isinstance(value, Mapping):
        for part in value.values():
            yield from numbers_in(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from numbers_in(part)
    elif isinstance(value, int | float) and len(repr(value)) >= 7:
        yield repr(value)


def test_a_run_contains_nothing_of_its_truth(all_kinds: Path) -> None:
    content = json.loads((all_kinds / "truth.json").read_text("utf-8"))
    plant_effects = ('"effects":{', '"effects": {')  # the plan's own list of effects is null
    words = {*REALISTIC, *OUTSIDE, *plant_effects, "look_alike", "truth", "hidden", content["sealed"]["profile"] + '"'}
    for entry in content["trials"]:
        data = (all_kinds / entry["run"] / "run.sqlite").read_bytes()
        assert b"sealed-" in data
        assert [word for word in words if word.encode() in data] == []
        assert re.search(rb'"effects": *[^ n]', data) is None, "the plan's own key says null"
        secret = [entry["effects"], entry["seeds"], entry["noise_um"], entry["held_out_um"], content["sealed"]["seed"]]
        numbers = set(numbers_in(secret))
        assert len(numbers) >= 7
        assert [number for number in numbers if number.encode() in data] == []
        with RunFile.open(all_kinds / entry["run"]) as run:
            assert run.profile.plant is None
            assert run.profile.seed == int(entry["run"].removeprefix("run-"))
            assert run.events() == []
            assert run.read_plan() == {}


def test_the_truth_names_kinds_and_arms_in_a_random_order(all_kinds: Path) -> None:
    trials = open_truth(all_kinds).trials
    kinds = [trial.kind for trial in trials]
    assert Counter(kinds) == {"one": 6, "none": 2, "outside": 1, "pair": 1}
    ones = [trial for trial in trials if trial.kind == "one"]
    slugs = [trial.effects[0].plant for trial in ones]
    assert set(slugs) == set(REALISTIC[SEED : SEED + 6])
    assert slugs != list(REALISTIC[SEED : SEED + 6])
    assert Counter(trial.arm for trial in ones) == {"left": 3, "right": 3}
    for trial in trials:
        assert bool(trial.arm) == (trial.kind != "none")
        assert len(trial.effects) == {"one": 1, "none": 0, "outside": 1, "pair": 2}[trial.kind]
        for effect in trial.effects:
            assert 0.0 <= effect.visible_um <= effect.raw_um * (1.0 + 1e-9)
        for name in ("left", "right"):
            assert 20.0 < trial.noise_um[name] < 35.0
            assert trial.held_out_um[name] == pytest.approx(trial.noise_um[name], rel=0.6)


def test_every_law_meets_both_arms() -> None:
    known = tuple(slug for slug in REALISTIC if library_name(slug) in EFFECTS)
    for kind, laws in (("one", known), ("outside", OUTSIDE)):
        drawn = cases(("left", "right"), kind, 2 * len(laws), SEED)
        met = {(case.slugs[0], case.arm) for case in drawn}
        assert met == {(law, arm) for law in laws for arm in ("left", "right")}
    assert set(EXPECTED) == set(OUTSIDE)
    pairs = cases(("left", "right"), "pair", len(PAIRS) + len(CONFOUNDED), SEED)
    assert sum(case.confounded for case in pairs) == len(CONFOUNDED)
    triples = cases(("left", "right"), "triple", len(TRIPLES), SEED)
    assert {len(case.slugs) for case in triples} == {3}
    assert {slug for case in (*pairs, *triples) for slug in case.slugs} <= set(known)


def test_a_seed_gives_the_same_trials_and_none_gives_others(
    judged_once: tuple[Path, list[str], JudgeResult], tmp_path: Path
) -> None:
    seal_trials(small(), tmp_path / "again", 3, Setup(kind="none"), seed=SEED)
    assert open_truth(tmp_path / "again").trials == open_truth(judged_once[0]).trials
    drawn = []
    for name in ("a", "b"):
        seal_trials(small_twin(plan={"method": "random"}), tmp_path / name, 1, Setup(kind="none"))
        drawn.append(open_truth(tmp_path / name))
    assert drawn[0].sealed.seed != drawn[1].sealed.seed
    assert drawn[0].trials[0].readings != drawn[1].trials[0].readings


def test_what_geometry_can_follow_is_not_visible() -> None:
    arm = load_profile(PROFILES / "twin.yaml").arms["left"]
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 6))
    geometry = nominal_arm(arm).with_T_M_B(transform(np.eye(3), np.array([3.0, 0.5, -0.4])))
    p_M = smr_positions(geometry, q)
    _, J = jacobian(geometry, JointAngles.of(q), tuple(range(len(parameter_names(6)))))
    for column in np.moveaxis(J, 1, 0):
        moved = 1e-4 * column.T
        assert np.abs(beyond_geometry(arm, q, p_M, moved)).max() < 1e-9
    # a scale of all lengths is geometry too; random displacements keep all but 27 of their 600 directions
    about = p_M - p_M.mean(axis=0)
    assert np.abs(beyond_geometry(arm, q, p_M, 1e-5 * about)).max() < 1e-9
    draws = 1e-5 * np.random.default_rng(1).standard_normal((30, 200, 3))
    left = np.stack([beyond_geometry(arm, q, p_M, noise) for noise in draws])
    assert np.sum(left**2) / np.sum(draws**2) == pytest.approx(1.0 - 27.0 / 600.0, abs=0.01)


@pytest.mark.parametrize("place", ["new", "."])
def test_a_sealing_that_ends_early_leaves_nothing(tmp_path: Path, place: str) -> None:
    def stop_after_the_first(event: Progress) -> None:
        if event.done == 1:
            job.cancel()

    job = JobToken(stop_after_the_first)
    twin = small_twin(plan={"method": "random"})
    with pytest.raises(Cancelled):
        seal_trials(twin, tmp_path / place, 3, Setup(kind="none"), job=job)
    assert list(tmp_path.iterdir()) == []


# -- the seal ---------------------------------------------------------------------------------------------------------


def test_the_seal_is_the_sha_256_of_the_truth(all_kinds: Path) -> None:
    digest, name = (all_kinds / "seal.txt").read_text("utf-8").split()
    assert name == "truth.json"
    assert digest == hashlib.sha256((all_kinds / "truth.json").read_bytes()).hexdigest()
    assert check_seal(all_kinds) == (all_kinds / "truth.json").read_bytes()


@pytest.mark.parametrize("place", [0.1, 0.5, 0.95])
def test_a_changed_truth_breaks_the_seal(mine: Path, place: float) -> None:
    data = bytearray((mine / "truth.json").read_bytes())
    data[int(place * len(data))] ^= 1
    (mine / "truth.json").write_bytes(data)
    with pytest.raises(CheckFailed, match="the seal is broken"):
        judge_trials(mine, PoolWork())
    assert stored(mine) == [""] * 10, "it is reported before any work"


def test_changed_readings_are_reported(judged_once: tuple[Path, list[str], JudgeResult], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(judged_once[0], tmp_path / "trials"))
    moved = "UPDATE reading SET p_m = '[3.0, 0.5, -0.25]' WHERE arm = 'right' AND configuration = 7"
    alter_file(folder / "run-0002", moved)
    with pytest.raises(CheckFailed, match="run-0002: its readings are not those that were sealed"):
        judge_trials(folder, PoolWork())
    shutil.rmtree(folder / "run-0002")
    with pytest.raises(InputError, match="run-0002 is missing, but was sealed"):
        judge_trials(folder, PoolWork())


def test_what_is_wrong_is_said_as_approved(
    mine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(PROFILES, tmp_path, dirs_exist_ok=True)
    for name, files in (("empty", ()), ("torn", ("truth.json",)), ("bare", ("truth.json", "seal.txt"))):
        (tmp_path / name).mkdir()
        for file in files:
            shutil.copy(mine / file, tmp_path / name / file)
    shutil.copytree(tmp_path / "bare", tmp_path / "broken")
    (tmp_path / "broken" / "seal.txt").write_text("")
    said = []
    for words in commands_of(SCORES.with_name("refusals.txt")):
        code, out, err = call(capsys, monkeypatch, "trials", *words.split())
        said.append(f"$ {words}\n{out}{err.strip()}\nexit code {code}")
    assert_approved(SCORES.with_name("refusals.txt"), "\n".join(said))
    assert not (tmp_path / "new").exists()


# -- judging ----------------------------------------------------------------------------------------------------------


def test_judging_goes_on_where_it_was_stopped(judged_once: tuple[Path, list[str], JudgeResult]) -> None:
    folder, first, result = judged_once
    done = [text for text in first if text]
    assert 1 <= len(done) < 3
    after = stored(folder)
    assert all(after)
    assert [text for text, before in zip(after, first, strict=True) if before] == done, "not judged twice"
    events: list[Progress] = []
    assert judge_trials(folder, PoolWork(job=JobToken(events.append))).trials == result.trials
    assert [(event.done, event.total) for event in events] == [(3, 3)]
    assert stored(folder) == after


def test_what_hides_in_a_run_is_compared_with_what_was_found_there(tmp_path: Path) -> None:
    folder = tmp_path / "trials"
    seal_trials(small(), folder, 1, Setup(kind="one"), seed=0)
    judge_run(folder / "run-0001", source_digest())
    result = judge_trials(folder, PoolWork())
    (trial,) = result.trials
    assert [hidden.effect for hidden in trial.hidden] == ["joint_compliance"]
    assert trial.visible
    arm = trial.findings
    assert "joint_compliance" in {slug for answers in arm.answer_sets for slug in answers}
    assert trial.in_answer_set
    assert arm.heldout_um.after < 0.2 * arm.heldout_um.before
    assert arm.noise_um == pytest.approx(open_truth(folder).trials[0].noise_um[trial.arm], rel=0.6)
    assert result.judged_by_other_source == 0
    assert {target.target for target in result.targets} >= {"visible: exactly its name", "one arm within 5 s"}


def test_a_run_that_fails_is_reported_and_does_not_stop_the_others(
    judged_once: tuple[Path, list[str], JudgeResult], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(judged_once[0], tmp_path / "trials"))
    for name in ("run-0001", "run-0003"):
        alter_file(folder / name, "DELETE FROM result WHERE name = ?", TRIAL_RESULT)
    alter_file(folder / "run-0001", "UPDATE reading SET split = 'identify'")  # which leaves none to validate
    result = judge_trials(folder, PoolWork())
    assert len(result.failed) == 1
    assert result.failed[0].startswith(
        f"run-0001: arm 'left': {STOPS} readings leave {STOPS} different configurations to identify and 0"
    )
    assert [trial.run for trial in result.trials] == ["run-0002", "run-0003"]


def test_the_commands(
    judged_once: tuple[Path, list[str], JudgeResult],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out.json"
    code, said, _ = call(capsys, monkeypatch, "trials", "judge", judged_once[0], "--json", out)
    assert code == 0
    assert "Sealed trials: targets" in said
    assert f"seed {SEED}" in said
    found = JudgeResult.from_json(out.read_text("utf-8"), str(out))
    assert found.trials == judged_once[2].trials
    shutil.copytree(PROFILES, tmp_path / "profiles")
    monkeypatch.setattr("cellapp.commands.trials.sealed.cases", lambda *arguments: [])
    code, said, _ = call(
        capsys, monkeypatch, "trials", "seal", tmp_path / "profiles" / "twin.yaml", "--out", tmp_path / "new", "--n", 2
    )
    assert code == 0
    sealed = json.loads((tmp_path / "new" / "truth.json").read_text("utf-8"))["sealed"]
    assert (tmp_path / "new" / "seal.txt").read_text("utf-8").split()[0] in said
    assert str(sealed["seed"]) not in said.replace(str(tmp_path), ""), "a drawn seed stays secret"


# -- scores -----------------------------------------------------------------------------------------------------------


def truth(kind: str, *slugs: str, visible_um: float = 100.0, confounded: bool = False) -> GroundTruth:
    expected = EXPECTED.get(slugs[0]) if kind == "outside" else None
    return GroundTruth(
        run="run-0001",
        kind=kind,
        look_alikes=confounded,
        arm="left" if slugs else "",
        effects=tuple(
            HiddenLaw(effect=slug, plant=slug, parameters={}, raw_um=2.0 * visible_um, visible_um=visible_um)
            for slug in slugs
        ),
        expected=None if expected is None else DescribedTerm(channel=expected[0], variables=expected[1]),
        noise_um={"left": 26.0, "right": 26.0},
        held_out_um={"left": 25.0, "right": 25.0},
        seeds={},
        readings="",
    )


def findings(**changes: Any) -> ArmFindings:
    after_um = changes.pop("after_um", 25.5)
    found: dict[str, Any] = {
        "accepted": (),
        "answer_sets": (),
        "described": (),
        "verdict": "nothing missing",
        "heldout_um": BeforeAfter(before=26.0, after=after_um),
        "noise_um": 25.0,
        "seconds": 1.0,
        "cpu_seconds": 0.9,
    }
    return ArmFindings(**{**found, **changes})


NOTHING = findings()
SCORES = Path(__file__).parent / "approved" / "scores.txt"
"""Lines ``$ KIND HIDDEN.. | ACCEPTED[/ANSWER].. | CHANNEL: VARIABLES (SENTENCE) | ..``, each with how it is scored."""


def named(*slugs: str, **changes: Any) -> ArmFindings:
    """An arm where these were accepted; after a slash what answers as well."""
    sets = tuple(tuple(slug.split("/")) for slug in slugs)
    accepted = tuple(answers[0] for answers in sets)
    verdict = "unknown effect" if "unknown" in accepted else "explained" if accepted else "nothing missing"
    return findings(**{"accepted": accepted, "answer_sets": sets, "verdict": verdict, **changes})


def judged(true: GroundTruth, left: ArmFindings, right: ArmFindings = NOTHING) -> ScoredRun:
    return score_run(true, {"left": left, "right": right})


def term(text: str) -> DescribedTerm:
    channel, variables, sentence = re.fullmatch(r"(.*?): ([^(]*?)(?: \((.*)\))?", text).groups()  # type: ignore[union-attr]
    return DescribedTerm(channel=channel, variables=tuple(variables.split(", ")), sentence=sentence or "")


def scored(line: str) -> ScoredRun:
    """The run of a line."""
    hidden, accepted, *described = [part.strip() for part in line.split("|")]
    return judged(truth(*hidden.split()), named(*accepted.split(), described=tuple(map(term, described))))


def test_runs_are_scored_as_approved() -> None:
    said = []
    for line in commands_of(SCORES):
        run = scored(line)
        said += [f"$ {line}", f"{run.outcome}{', among the alternatives' if run.in_answer_set else ''}"]
        said += [f"  description: {run.description or 'wrong'}"] if run.kind == "outside" else []
        said += [f"  second: {name}" for name in run.second_names]
    assert_approved(SCORES, "\n".join(said))


def test_targets_and_misses_are_as_approved() -> None:
    result = scores(
        [
            scored("one backlash | backlash"),
            judged(truth("one", "backlash"), named("friction_windup/backlash", after_um=40.0)),
            judged(truth("one", "tracker_scale", visible_um=0.0), NOTHING, named("joint_drift")),
            scored("none |"),
            judged(truth("none"), named("base_step"), named("unknown", described=(term("tool: q1"),))),
            scored("outside crosstalk | unknown | joint 4: q5"),
            scored("outside tool_sag | joint_drift unknown"),
            scored("pair backlash base_step | base_step backlash"),
            judged(truth("pair", "backlash", "friction_windup", confounded=True), named("backlash", seconds=9.0)),
        ]
    )
    said = [f"{one.target}: {one.reached} of {one.n}, {one.met}" for one in result.targets]
    misses = next(table for table in judge_tables(result) if table.title == "Misses").rows
    said += [f"missed: {str(hidden).split(' (')[0]}; found {found}" for _, hidden, found, *_ in misses]
    assert_approved(SCORES.with_name("targets.txt"), "\n".join(said))
    assert result.missed == (), "too few trials to say so"
    assert max(run.findings.to_drawn for run in result.trials if run.hidden_names == "backlash") == pytest.approx(1.6)
    outcomes = {one.hidden: one.outcomes for one in result.counts}
    assert outcomes["tracker_scale, below"] == {"none": 1}
    assert outcomes["nothing, beside an arm that hides something"] == {"none": 6, "false name": 1}
    assert outcomes["tool_sag"] == {"wrong": 1}
    assert outcomes["crosstalk"] == {"described": 1}


def test_few_clean_arms_meet_no_target_and_many_do() -> None:
    def met(n: int) -> list[object]:
        targets = scores([judged(truth("none"), NOTHING) for _ in range(n)]).targets
        return [target.met for target in targets if target.kind == "none"]

    assert met(149) == [None, None]
    assert met(150) == [True, True]


def quick_twin(name: str = "twin") -> Profile:
    """A profile whose search sets its threshold from few simulations."""
    profile = load_profile(PROFILES / f"{name}.yaml")
    return altered(profile, discovery={"null_simulations": 20})


# -- conditions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["twin", "twin-foreign"])
def test_narrow_ranges_are_10_to_50_degrees_wide(tmp_path: Path, profile: str) -> None:
    seal_trials(quick_twin(profile), tmp_path / "t", 1, Setup(kind="none", ranges="narrow", stops=60), seed=SEED)
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        for name, arm in run.profile.arms.items():
            q = run.readings(name).q
            assert q.shape == (60, len(arm.type.joints))
            assert (np.degrees(np.ptp(q, axis=0)) < 50.0).all()
            assert (np.degrees(np.ptp(q, axis=0)) > 5.0).all()


def test_readings_state_nothing_where_they_shall_not(tmp_path: Path) -> None:
    kept = {}
    for stated in (True, False):
        setup = Setup(kind="none", stops=60, stated=stated)
        seal_trials(quick_twin(), tmp_path / str(stated), 1, setup, seed=SEED)
        with RunFile.open(tmp_path / str(stated) / "run-0001") as run:
            kept[stated] = run.readings("left")
    assert kept[True].covariance_M is not None
    assert kept[False].covariance_M is None
    assert np.array_equal(kept[True].p_M, kept[False].p_M)
    noise_um = open_truth(tmp_path / "False").trials[0].noise_um["left"]
    assert noise_um == open_truth(tmp_path / "True").trials[0].noise_um["left"] > 20.0


def test_brier_score_and_reliability() -> None:
    runs = [
        judged(truth("one", "backlash"), named("backlash", posteriors={"backlash": 0.9, "base_step": 0.3})),
        judged(truth("one", "backlash"), named("base_step", posteriors={"backlash": 0.2, "base_step": 0.7})),
        judged(
            truth("one", "base_drift", visible_um=1.0), named(posteriors={"base_drift": 0.1}, invisible=("backlash",))
        ),
        judged(truth("one", "backlash"), named("backlash")),  # nothing stated
    ]
    by_name = {score.about: score for score in scores(runs).posteriors}
    accepted = by_name["accepted names"]
    assert accepted.n == 2
    assert accepted.brier == pytest.approx((0.1**2 + 0.7**2) / 2)
    assert [(one.n, one.true) for one in accepted.bins] == [(0, None), (0, None), (0, None), (1, 0.0), (1, 1.0)]
    every = by_name["every effect that the plan can show"]
    squares = 0.1**2 + 0.3**2 + 0.8**2 + 0.7**2
    assert every.brier == pytest.approx(squares / every.n), "what is not stated counts as stated with zero"
    targets = [target for target in scores(runs).targets if target.target.startswith("Brier")]
    assert {target.bar for target in targets} == {True}


def test_a_bar_counts_from_enough_trials() -> None:
    def missed(n: int) -> list[str]:
        runs = [judged(truth("one", "backlash"), named("friction_windup")) for _ in range(n)]
        return [target.target for target in scores(runs).missed]

    assert missed(33) == []
    assert missed(34) == ["visible: exactly its name"]
