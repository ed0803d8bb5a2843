"""The trial of earlier calibrations: what is mounted elsewhere, what is compared, which bars are missed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.commands.trials.signature import SignatureDraw, SignatureResult, TwinPlan, lines_of, remounted, twin_trials
from cellapp.commands.trials.signature_tables import signature_sentences, signature_tables
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.app import app

PROFILES = Path(__file__).parents[3] / "profiles"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> SignatureResult:
    """By the command, on few stops."""
    file = tmp_path_factory.mktemp("signature") / "result.json"
    sizes = ["--seeds", "1", "--earlier", "80", "--few", "20", "--many", "40", "--held-out", "30"]
    CliRunner().invoke(app, ["trials", "signature", str(PROFILES / "twin.yaml"), *sizes, "--json", str(file)])
    return SignatureResult.from_json(file.read_text("utf-8"), "result")


def test_few_stops_with_the_earlier_calibration_beat_few_without(result: SignatureResult) -> None:
    few, many = result.lines
    assert (few.stops, few.draws, many.stops, many.draws) == (20, 2, 40, 2)
    assert few.discovered_mm is not None
    assert few.discovered_mm < 0.8 * few.alone_mm
    assert few.discovered_mm < 1.15 * many.alone_mm
    assert few.worse == 0
    assert all(draw.held_out == 30 for draw in result.draws)


def test_tables_state_every_draw_and_bar(result: SignatureResult) -> None:
    lines, draws, bars = signature_tables(result)
    assert (len(lines.rows), len(draws.rows), len(bars.rows)) == (2, 4, len(result.bars))
    assert "twin: 80" in signature_sentences(result)[0]
    assert SignatureResult.from_json(result.to_json(), "again") == result


@pytest.mark.fast
def test_only_base_and_smr_are_mounted_elsewhere() -> None:
    profile = load_profile(PROFILES / "twin.yaml")
    before, after = build_plant(profile), build_plant(remounted(profile, 3))
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (30, 6))
    for name in profile.arms:
        here, there = before.smr_positions(name, q), after.smr_positions(name, q)
        assert np.linalg.norm(here - there, axis=1).min() > 1e-3
    assert remounted(profile, 3) == remounted(profile, 3)
    assert remounted(profile, 3) != remounted(profile, 4)


@pytest.mark.fast
def test_a_draw_that_the_earlier_calibration_makes_worse_is_counted() -> None:
    draws = [
        SignatureDraw(
            cell="D", seed=seed, arm="left", stops=30, held_out=100, alone_mm=0.2, calibrated_mm=mm, discovered_mm=mm
        )
        for seed, mm in enumerate((0.1, 0.21))
    ]
    (line,) = lines_of(draws)
    assert line.worse == 1
    assert line.worst_ratio == pytest.approx(1.05)


@pytest.mark.fast
def test_a_profile_without_a_plant_is_refused() -> None:
    with pytest.raises(InputError, match="section 'plant'"):
        twin_trials(TwinPlan(profile=load_profile(PROFILES / "ur10-real.yaml")), [0])
