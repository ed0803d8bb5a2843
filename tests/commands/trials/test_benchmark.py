"""The benchmark: a method never sees what is held out, scores are right, methods of strangers take part."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.commands.trials.benchmark.methods import neural_network, symbolic_regression
from cellapp.commands.trials.benchmark.methods.registry import METHODS
from cellapp.commands.trials.benchmark.methods.relevance import relevant_rows
from cellapp.commands.trials.benchmark.problem import Answer
from cellapp.commands.trials.benchmark.real import records_words
from cellapp.commands.trials.benchmark.scoring import scored, set_score
from cellapp.commands.trials.benchmark.trial import (
    BenchmarkResult,
    RealProblems,
    benchmark_table,
    benchmark_trials,
    refused,
    sealed_problem,
)
from cellapp.commands.trials.league.series import series_texts
from cellapp.commands.trials.sealed import SEAL_FILE, TRUTH_FILE, GroundTruth, HiddenLaw
from cellapp.commands.trials.sealed_cases import IN_MOTION
from cellapp.commands.trials.sealed_setup import HELD_OUT
from cellapp.commands.trials.skeleton import Work
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.scale.executor import Resources
from cellapp.robot.effects import EFFECTS
from tests.interfaces.plugins.installed import add_distribution, installed
from tests.twin import PROFILES, small_twin

STOPS, SEED = 60, 3
ROWS = {"identify": 20, "train": 20, "validate_": 20, "pair_identify": 10, "pair_validate": 10}
STRANGER = """
SEEN = []

def guess(problem):
    from cellapp.commands.trials.benchmark.problem import Answer
    SEEN.append(problem)
    return Answer(problem.predicted(problem.geometry_fit.model), {"backlash": 0.5})

def refuses(problem):
    raise ValueError("no answer")

def passes(problem):
    from cellapp.commands.trials.benchmark.problem import Answer, NotTaken
    if problem.name.startswith("one/"):
        raise NotTaken("no single effects")
    return Answer(problem.predicted(problem.geometry_fit.model))

def half(problem):
    from cellapp.commands.trials.benchmark.problem import Answer
    return Answer(problem.predicted(problem.geometry_fit.model)[:1])
"""


def small() -> Profile:
    """The twin with few stops."""
    profile = small_twin(STOPS)
    return profile.model_copy(update={"splits": profile.splits.model_copy(update=ROWS)})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sealed problems: one run of each kind."""
    found = tmp_path_factory.mktemp("benchmark") / "problems"
    benchmark_trials(small(), found, ["geometry"], 1, SEED)
    return found


@pytest.fixture
def stranger(tmp_path: Path) -> Iterator[None]:
    """Methods of a distribution that is not ours."""
    entries = {
        "guess": "stranger:guess",
        "half": "stranger:half",
        "passes": "stranger:passes",
        "refuses": "stranger:refuses",
        "text": "stranger:STRANGER",
    }
    added = add_distribution(
        tmp_path,
        "stranger",
        {"cellapp.trials.methods": entries},
        {"stranger.py": STRANGER + "STRANGER = 'no function'\n"},
    )
    with installed(added):
        yield


def test_a_stranger_s_method_sees_no_held_out_point_and_is_scored(folder: Path, stranger: None) -> None:
    import stranger as module  # type: ignore[import-not-found]

    result = benchmark_trials(small(), folder, ["guess", "geometry"], 1, None)
    for problem in module.SEEN:
        assert np.isnan(problem.held_out.p_M).all()
        assert len(problem.learn) == STOPS - ROWS["validate_"]
        assert not problem.learn.in_split("validate").size
        assert problem.profile.plant is None
    assert result.method == "guess"
    assert result.total.n == 6
    assert set(result.sets) == {"clean", "one", "pair", "outside"}
    assert result.sets["clean"].exact == 0.0
    assert result.sets["clean"].false_names == 1.0
    assert result.compared["geometry"].sets["clean"].exact == 1.0
    assert result.compared["geometry"].total.brier is None
    again = BenchmarkResult.from_json(result.to_json(), "result")
    assert again == result
    assert len(benchmark_table(result).rows) == 10


def test_a_method_that_cannot_be_used_is_named(folder: Path, stranger: None) -> None:
    with pytest.raises(
        InputError, match=r"'text' is not known; plug-in stranger 1\.0.*expected a function of a Problem"
    ):
        benchmark_trials(small(), folder, ["text"], 1, None)
    with pytest.raises(InputError, match=r"'nobody' is not known; methods are cellapp, geometry"):
        benchmark_trials(small(), folder, ["nobody"], 1, None)
    with pytest.raises(InputError, match=r"predicted shape \(1, 3\), expected \(20, 3\)"):
        benchmark_trials(small(), folder, ["half"], 1, None)


def test_what_a_method_does_not_take_counts_as_not_answered(folder: Path, stranger: None) -> None:
    result = benchmark_trials(small(), folder, ["passes"], 1, None)
    assert (result.total.n, result.total.answered) == (6, 4)
    one = result.sets["one"]
    assert (one.n, one.answered, one.exact, one.heldout_ratio) == (1, 0, 0.0, None)
    assert result.failed == ()


def test_further_cells_and_real_series_are_sets_of_their_own(folder: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(folder, tmp_path / "problems"))
    further = small().model_copy(update={"name": "further"})
    texts = series_texts(["UR5"], PROFILES.parent / "tests" / "fixtures", PROFILES)
    real = RealProblems(texts, rows=60, draws=1)
    result = benchmark_trials(small(), own, ["geometry"], 1, SEED, cells=[further], real=real)
    assert list(result.sets)[-2:] == ["further", "real UR5"]
    assert result.sets["further"].n == 2
    series = result.sets["real UR5"]
    assert (series.n, series.answered, series.exact, series.brier) == (1, 1, None, None)
    assert series.heldout_mm is not None
    assert 0.05 < series.heldout_mm < 1.0
    assert "0.155 mm published" in records_words(["UR5", "C"])[0]
    with pytest.raises(InputError, match="a set cannot be called 'pair'"):
        benchmark_trials(small(), own, ["geometry"], 1, SEED, cells=[small().model_copy(update={"name": "pair"})])


def test_arms_in_motion_are_a_set_that_is_judged_by_stops_at_rest(folder: Path, tmp_path: Path) -> None:
    own, sweeps = Path(shutil.copytree(folder, tmp_path / "problems")), 2
    result = benchmark_trials(small(), own, ["geometry"], 1, SEED, sweeps=sweeps)
    assert result.sets["motion"].n == 1
    assert result.sets["clean"].n == 4
    (hidden,) = {one.problem: one for one in result.answers if one.set == "motion"}.values()
    assert set(hidden.hidden) <= {slug for joints in IN_MOTION for slug in joints}
    problem, measured = sealed_problem(own / "motion", "run-0001", "left")
    assert problem.motion is not None
    (recording,) = problem.motion.recordings
    assert len(recording.points) > 1000
    assert len(problem.motion.stops) == sweeps
    assert len(problem.learn) > 100, "samples of the recordings stand beside the stops"
    assert len(problem.held_out) == HELD_OUT
    assert np.isnan(problem.held_out.p_M).all()
    errors = np.linalg.norm(problem.predicted(problem.geometry_fit.model) - measured, axis=1)
    assert 1e3 * errors.mean() == pytest.approx(
        next(one.heldout_mm for one in result.answers if one.problem == problem.name), rel=1e-3
    )
    with sqlite3.connect(own / "motion" / "run-0001" / "run.sqlite") as connection:
        of_y = "SELECT data FROM stream AS other WHERE name = 'y_m' AND other.recording = stream.recording"
        connection.execute(f"UPDATE stream SET data = ({of_y} AND other.arm = stream.arm) WHERE name = 'z_m'")
    connection.close()
    with pytest.raises(CheckFailed, match=r"motion/run-0001: its readings are not those that were sealed"):
        benchmark_trials(small(), own, ["geometry"], 1, None, sweeps=sweeps)


def test_every_answer_that_failed_is_named(folder: Path, stranger: None) -> None:
    result = benchmark_trials(small(), folder, ["geometry", "refuses"], 1, None)
    assert (len(result.answers), len(result.failed)) == (6, 6)
    assert result.failed[0].startswith("refuses, one/run-0001, arm left: ")
    assert refused(result).startswith("trials benchmark: 6 could not be computed: refuses, one/run-0001")


def test_changed_readings_are_reported(folder: Path, tmp_path: Path) -> None:
    changed = Path(shutil.copytree(folder, tmp_path / "problems"))
    connection = sqlite3.connect(changed / "pair" / "run-0001" / "run.sqlite")
    connection.execute("UPDATE reading SET p_m = '[3.0, 0.5, -0.25]' WHERE arm = 'right' AND configuration = 7")
    connection.commit()
    connection.close()
    with pytest.raises(CheckFailed, match=r"pair/run-0001: its readings are not those that were sealed"):
        benchmark_trials(small(), changed, ["geometry"], 1, None)
    shutil.rmtree(changed / "pair" / "run-0001")
    with pytest.raises(InputError, match=r"pair/run-0001 is missing, but was sealed"):
        benchmark_trials(small(), changed, ["geometry"], 1, None)


def test_a_store_has_no_answers_to_other_problems_of_the_same_folder(folder: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(folder, tmp_path / "problems"))
    said: list[str] = []
    work = Work(Resources(jobs=1, store=tmp_path / "store"), lambda event: said.append(event.note))
    for expected in ("", "6 in the store", "6 there of another program or other data are not used"):
        if expected.endswith("used"):
            truth = (own / "pair" / TRUTH_FILE).read_bytes() + b"\n"
            (own / "pair" / TRUTH_FILE).write_bytes(truth)
            (own / "pair" / SEAL_FILE).write_text(f"{hashlib.sha256(truth).hexdigest()}  {TRUTH_FILE}\n")
        said.clear()
        assert benchmark_trials(small(), own, ["geometry"], 1, None, work).total.n == 6
        assert said[0] == expected


@pytest.mark.parametrize("name", METHODS)
def test_every_method_answers(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(symbolic_regression, "_POPULATION", 60)
    monkeypatch.setattr(neural_network, "_STEPS", 150)
    problem, _ = sealed_problem(folder / "one", "run-0001", "left")
    answer = METHODS[name](problem)
    assert answer.p_M.shape == (ROWS["validate_"], 3)
    assert np.isfinite(answer.p_M).all()
    assert set(answer.names) <= set(EFFECTS)
    assert all(0.0 <= probability <= 1.0 for probability in answer.names.values())


def truth(kind: str, *effects: tuple[str, float]) -> GroundTruth:
    """Truth of a run whose left arm has effects of some visible size [um] in a noise of 20 um."""
    laws = tuple(HiddenLaw(effect=slug, plant=slug, parameters={}, raw_um=um, visible_um=um) for slug, um in effects)
    both = {"left": 20.0, "right": 20.0}
    return GroundTruth(
        run="run-0001", kind=kind, look_alikes=False, arm="left", effects=laws, expected=None, noise_um=both,
        held_out_um=both, seeds={}, readings="",
    )  # fmt: skip


def score(of: GroundTruth, arm: str = "left", **names: float) -> Any:
    """The score of an answer that is 40 um off everywhere."""
    measured = np.zeros((5, 3))
    return scored("any", "p", arm, of, Answer(measured + np.array([40e-6, 0.0, 0.0]), names), measured, 1.0)


@pytest.mark.fast
def test_names_are_exact_where_they_are_those_of_the_effects_larger_than_the_noise() -> None:
    pair = truth("pair", ("backlash", 90.0), ("base_step", 12.0))
    found = score(pair, backlash=0.9)
    assert (found.set, found.exact, found.false_names) == ("pair", True, 0)
    assert found.heldout_ratio == pytest.approx(2.0)
    assert score(pair, backlash=0.9, base_step=0.8).exact, "what is below the noise counts neither way"
    wrong = score(pair, backlash=0.9, joint_drift=0.6)
    assert (wrong.exact, wrong.false_names) == (False, 1)
    assert set_score([wrong]).brier == pytest.approx((0.1**2 + 0.6**2) / 2.0)
    assert not score(pair).exact
    assert not score(pair, backlash=0.9, unknown=1.0).exact


@pytest.mark.fast
def test_the_other_arm_is_clean_and_outside_the_library_no_name_is_right() -> None:
    one = truth("one", ("backlash", 90.0))
    assert score(one, "right").set == "clean"
    assert score(one, "right").exact
    assert score(one, "right", unknown=0.9).false_names == 1
    outside = truth("outside", ("dress_pack", 90.0))
    assert score(outside).exact
    assert score(outside, unknown=0.9).exact
    assert score(outside, backlash=0.9).false_names == 1


@pytest.mark.fast
def test_relevance_keeps_the_columns_that_explain() -> None:
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(12, 300))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    y = 40.0 * rows[3] - 25.0 * rows[7] + rng.normal(size=300)
    kept = set(relevant_rows(rows, y).tolist())
    assert {3, 7} <= kept
    assert len(kept) < len(rows)
