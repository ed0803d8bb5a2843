"""What trials cost, and their common options."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.cost import CostResult, cost_of, cost_table
from cellapp.commands.trials.coverage import coverage_trials
from cellapp.commands.trials.skeleton import Work
from cellapp.ground.errors import InputError
from cellapp.ground.scale.executor import Resources
from cellapp.interfaces.cli.app import app
from tests.twin import PROFILES


def test_the_cost_of_many_tasks_follows_from_those_in_a_store(tmp_path: Path) -> None:
    store = tmp_path / "store.sqlite"
    coverage_trials(load_profile(PROFILES / "twin.yaml"), 3, 25, Work(Resources(jobs=1, store=store)))
    result = cost_of(store, 7200)
    (coverage,) = result.jobs
    assert (coverage.job, coverage.tasks) == ("coverage", 6)
    assert 0.0 < coverage.median_s <= coverage.longest_s
    assert coverage.core_hours == pytest.approx(2.0 * coverage.mean_s)
    assert coverage.waited >= 0.99
    assert CostResult.from_json(result.to_json(), "here") == result
    assert cost_table(result).headings[-1] == "7,200 tasks [core hours]"
    shown = CliRunner().invoke(app, ["trials", "cost", str(store), "--tasks", "7200"])
    assert "coverage" in shown.output


def test_a_store_without_results_has_no_cost(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="file not found"):
        cost_of(tmp_path / "none", 1)
    with pytest.raises(InputError, match="section 'plant'"):
        coverage_trials(load_profile(PROFILES / "ur10-ur5.yaml"), 2, 25, Work(Resources(store=tmp_path / "none")))


def test_a_second_run_of_a_trial_takes_its_results_from_the_store(tmp_path: Path) -> None:
    store, profile = tmp_path / "store.sqlite", load_profile(PROFILES / "twin.yaml")
    two = coverage_trials(profile, 2, 25, Work(Resources(jobs=1, store=store)))
    assert two == coverage_trials(profile, 2, 25, Work(Resources(jobs=1)))
    before = cost_of(store, 1)
    assert coverage_trials(profile, 2, 25, Work(Resources(jobs=1, store=store))) == two
    assert cost_of(store, 1) == before


@pytest.mark.parametrize(
    "verb",
    ["coverage", "parameter-sets", "paper", "judge", "blind-matrix", "plans", "targets", "league", "signature",
     "check"],
)  # fmt: skip
def test_every_trial_over_seeds_has_the_same_options(verb: str) -> None:
    shown = CliRunner().invoke(app, ["trials", verb, "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    for option in ("--jobs", "--scheduler", *(() if verb in ("judge", "blind-matrix") else ("--store",))):
        assert option in shown
