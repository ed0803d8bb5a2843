"""The league of real robots: what is drawn and held out, what is measured, which bars are missed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.commands.trials.league.draws import DrawTask, LeagueDraw, run_draw
from cellapp.commands.trials.league.series import (
    Entrant,
    SeriesTexts,
    draw_rows,
    load_entrant,
    parse_entrants,
    parse_rows,
    series_texts,
)
from cellapp.commands.trials.league.tables import league_sentences, league_tables
from cellapp.commands.trials.league.trial import CURVE_ROWS, LeagueResult, league_trials, results_of
from cellapp.commands.view.table import markdown
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.ground.errors import InputError
from cellapp.ground.scale.task import as_json

ROOT = Path(__file__).parents[3]
DATA, PROFILES = ROOT / "tests" / "fixtures", ROOT / "profiles"


@pytest.fixture(scope="module")
def ur5() -> Entrant:
    return load_entrant("UR5", DATA, PROFILES)


@pytest.fixture(scope="module")
def series_c() -> Entrant:
    return load_entrant("C", DATA, PROFILES)


@pytest.fixture(scope="module")
def draw(ur5: Entrant) -> LeagueDraw:
    return run_draw(ur5, DrawTask(series="UR5", rows=100, seed=0))


@pytest.mark.fast
def test_motions_are_derived_before_rows_are_drawn(ur5: Entrant) -> None:
    step = ur5.readings.step
    assert step is not None
    np.testing.assert_allclose(step[1:], np.diff(ur5.readings.q, axis=0), atol=1e-4)
    assert np.all(ur5.readings.approach[1:] != 0)


@pytest.mark.fast
def test_held_out_rows_are_all_others_and_those_of_the_authors_apart(ur5: Entrant) -> None:
    drawn = draw_rows(ur5, 300, seed=3)
    assert {group: len(rows) for group, rows in drawn.held_out.items()} == {"all": 720, "others": 700, "published": 20}
    assert len(drawn.learned) == 300
    assert not set(drawn.learned) & set(drawn.judged)
    assert set(drawn.held_out["published"]) == set(range(1000, 1020))
    assert set(drawn.learned) < set(draw_rows(ur5, 600, seed=3).learned)
    assert set(drawn.learned) != set(draw_rows(ur5, 300, seed=4).learned)
    everything = draw_rows(ur5, "all", seed=3)
    assert list(everything.held_out) == ["published"]
    assert len(everything.learned) == 1000


@pytest.mark.fast
def test_of_a_series_without_held_out_rows_a_fifth_is_held_out(series_c: Entrant) -> None:
    drawn = draw_rows(series_c, "all", seed=0)
    assert (len(drawn.learned), len(drawn.judged)) == (2218, 555)
    assert list(drawn.held_out) == ["all"]
    assert len(draw_rows(series_c, 300, seed=0).judged) == 2473


@pytest.mark.fast
def test_the_learning_curve_is_judged_on_the_same_rows(series_c: Entrant) -> None:
    drawn = [draw_rows(series_c, rows, 5, CURVE_ROWS[-1]) for rows in CURVE_ROWS]
    assert [len(one.learned) for one in drawn] == list(CURVE_ROWS)
    for one in drawn:
        np.testing.assert_array_equal(one.judged, drawn[-1].judged)
        assert not set(one.learned) & set(one.judged)


@pytest.mark.fast
def test_what_is_not_there_is_said(ur5: Entrant, series_c: Entrant, tmp_path: Path) -> None:
    for entrant, rows in ((ur5, 1001), (series_c, 2773)):
        with pytest.raises(InputError, match=rf"--rows: series {entrant.name} has \d+ rows to learn from; ask for"):
            draw_rows(entrant, rows, seed=0)
    with pytest.raises(InputError, match="'E' is not a series of the league; series are C, D, UR5"):
        load_entrant("E", DATA, PROFILES)
    with pytest.raises(InputError, match=r"ur5-real.readings\.csv: file not found; .* say with --data where"):
        load_entrant("UR5", tmp_path, PROFILES)
    assert parse_rows("100, all") == [100, "all"]
    for text in ("", "0", "-5", "1e3", "100,,300", "half"):
        with pytest.raises(InputError, match="expected numbers of rows or 'all'"):
            parse_rows(text)


def test_a_draw_judges_geometry_and_discovery_on_the_same_rows(draw: LeagueDraw) -> None:
    assert (draw.learned, [score.n for score in draw.scores.values()]) == (100, [920, 900, 20])
    for score in draw.scores.values():
        assert 0.02 < score.discovery_mm < score.geometry_mm < 0.15
        assert 0.5 < score.within_95 <= 1.0
        assert score.network_mm is None
    everywhere, apart = draw.scores["all"], [draw.scores["others"], draw.scores["published"]]
    for field in ("geometry_mm", "discovery_mm", "within_95"):
        mean = np.average([getattr(score, field) for score in apart], weights=[score.n for score in apart])
        assert getattr(everywhere, field) == pytest.approx(mean)
    assert draw.seconds > 0.0


def with_error(draw: LeagueDraw, seed: int, discovery_mm: float, within_95: float) -> LeagueDraw:
    scores = {
        group: score.model_copy(update={"discovery_mm": discovery_mm, "within_95": within_95})
        for group, score in draw.scores.items()
    }
    return draw.model_copy(update={"rows": 300, "seed": seed, "scores": scores, "names": ("backlash",) * seed})


def league_of(*draws: LeagueDraw) -> LeagueResult:
    return results_of(draws, (), seeds=len(draws), jobs=1)


def test_bars_are_held_against_means_over_draws(draw: LeagueDraw) -> None:
    good = league_of(with_error(draw, 0, 0.048, 0.93), with_error(draw, 1, 0.052, 0.97))
    assert good.complaints() == []
    assert [bar.what for bar in good.bars] == ["held-out error [mm]", "worst draw to mean", "within 95 %"]
    (line, *_) = good.lines
    assert line.discovery_mm == pytest.approx(0.05)
    assert line.worst_to_mean == pytest.approx(1.04)
    assert line.within_95 == pytest.approx(0.95)
    assert line.names == {"backlash": 1}
    assert [one.published_mm for one in good.lines] == [None, None, 0.155]
    bad = league_of(with_error(draw, 0, 0.04, 1.0), with_error(draw, 1, 0.08, 1.0)).complaints()
    assert bad == [
        "series UR5, 300 rows: held-out error [mm] is 0.060, at most 0.053",
        "series UR5, 300 rows: worst draw to mean is 1.333, at most 1.15",
        "series UR5, 300 rows: within 95 % is 1.000, 0.9 to 0.98",
    ]
    assert [bar.what for bar in league_of(with_error(draw, 0, 0.06, 0.95)).bars] == [
        "held-out error [mm]",
        "within 95 %",
    ]


def test_the_league_in_tables_and_json(draw: LeagueDraw, monkeypatch: pytest.MonkeyPatch) -> None:
    def as_drawn(entrant: Entrant, task: DrawTask) -> LeagueDraw:
        return draw.model_copy(update={"seed": task.seed})

    monkeypatch.setattr("cellapp.commands.trials.league.draws.run_draw", as_drawn)
    result = league_trials(["UR5"], [100], [4, 5], data=DATA, profiles=PROFILES)
    assert LeagueResult.from_json(result.to_json(), "league") == result
    assert [(one.rows, one.seed) for one in result.draws] == [(100, 4), (100, 5)]
    assert [line.held_out for line in result.lines] == [920, 900, 20]
    text = markdown(league_tables(result), league_sentences(result))
    assert "| UR5 | 100 | 20 published |" in text
    assert "| 0.155 |" in text
    assert "graph neural network" in text


def test_stated_intervals_hold_new_readings_where_the_model_is_right(ur5: Entrant) -> None:
    """Readings made by a geometry with noise of 40 um: the intervals of discovery hold 95 % of new ones.

    The errors of all new readings come from the same 34 parameters: one draw of the noise holds 95 % with a standard
    deviation of 2 %, four draws with 1 %.
    """
    split = tuple("identify" if row < 150 else "validate" for row in range(1020))
    readings = replace(ur5.readings, split=split)
    true, _ = calibrate_arm(ur5.profile, ur5.arm, readings)
    within = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(0.0, 40e-6, (1020, 3))
        made = replace(readings, p_M=true.model.predict(ur5.readings.q) + noise)
        arm, _ = calibrate_arm(ur5.profile, ur5.arm, made)
        found = discover_arm(ur5.profile, ur5.arm, arm.model, made)
        left = made.p_M - found.model.predict(made.q)
        within.append(np.abs(left[150:]) <= 1.96 * found.model.measured_uncertainty(made.q)[150:, None])
    assert np.mean(within) == pytest.approx(0.95, abs=0.02)


@pytest.mark.fast
def test_a_series_as_text_is_the_series(ur5: Entrant) -> None:
    """A worker that does not see the files computes from the same numbers."""
    texts = SeriesTexts.model_validate_json(as_json(series_texts(["UR5"], DATA, PROFILES)))
    (sent,) = parse_entrants(texts).values()
    assert sent.profile == ur5.profile
    for name in ("q", "p_M", "approach", "step"):
        np.testing.assert_array_equal(getattr(sent.readings, name), getattr(ur5.readings, name))
    assert sent.readings.split == ur5.readings.split
