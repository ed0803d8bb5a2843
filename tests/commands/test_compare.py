"""Comparing two runs: what differs and by how many standard uncertainties; what cannot be compared is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.compare.run import (
    ArmComparison,
    RunComparison,
    compare_runs,
    comparison_sentences,
    comparison_tables,
)
from cellapp.commands.report.result import read_results
from cellapp.commands.stages import append_stage, basis_of
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import DISCOVER
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import STATION, true_geometry
from tests.cell.run.small_runs import planned_run
from tests.interfaces.page.runs import without_devices

SIGMA_M = 20e-6
STOPS = 60


def calibrated_run(folder: Path, seed: int, *, shift_m: float = 0.0, profile: Profile | None = None) -> Path:
    """Two arms of one cell, measured at stops and with noise of their own; the left base stands ``shift_m`` off."""
    geometry_rng, rng = np.random.default_rng(0), np.random.default_rng([1, seed])
    profile = profile or without_devices("left", "right").model_copy(update={"name": "cell", "seed": seed})
    with RunFile.create(folder, profile) as run:
        for place, (name, arm) in enumerate(profile.arms.items()):
            station = STATION.copy()
            station[0, 3] += 1.5 * place + (shift_m if name == "left" else 0.0)
            true = true_geometry(nominal_arm(arm).with_T_M_B(station), geometry_rng)
            q = rng.uniform(-2.5, 2.5, (STOPS, 6))
            noise = rng.normal(0.0, SIGMA_M, (STOPS, 3))
            run.add_readings(
                name,
                Readings(
                    configuration=np.arange(STOPS, dtype=np.int64),
                    time_s=np.arange(float(STOPS)),
                    q=q,
                    approach=np.zeros((STOPS, 6), np.int8),
                    p_M=smr_positions(true, q) + noise,
                    sigma_m=np.full(STOPS, SIGMA_M),
                ),
            )
        calibrate_run(run)
    return folder


def compared(a: Path, b: Path) -> RunComparison:
    with RunFile.open(a) as first, RunFile.open(b) as second:
        result = compare_runs(first, second)
    assert RunComparison.from_json(result.to_json(), "comparison") == result
    return result


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same cell, measured twice."""
    folder = tmp_path_factory.mktemp("compared")
    return calibrated_run(folder / "a", 1), calibrated_run(folder / "b", 2)


def z_of(arm: ArmComparison) -> np.ndarray:
    return np.array([value.z for value in arm.parameters if value.z is not None])


def test_two_calibrations_of_one_cell_differ_as_their_standard_errors_say(two_runs: tuple[Path, Path]) -> None:
    result = compared(*two_runs)
    assert [(entry.key, entry.a, entry.b) for entry in result.profile] == [("seed", "1", "2")]
    assert list(result.arms) == ["left", "right"]
    z = np.concatenate([z_of(arm) for arm in result.arms.values()])
    assert len(z) > 40
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    left = result.arms["left"]
    assert set(left.heldout_mm) >= {"nominal", "geometry"}
    geometry = left.heldout_mm["geometry"]
    assert geometry.a_mean_mm is not None
    assert geometry.a_mean_mm != geometry.b_mean_mm
    assert result.pair is not None
    assert result.pair.method is not None
    assert {value.name for value in result.pair.parameters} >= {"x", "y", "z"}
    assert result.pair.distance_mm is not None
    assert result.pair.distance_mm < 1.0
    assert [note.partition(" ")[2] for note in result.notes] == [
        "was not searched for missing effects",
        "was not verified at targets",
    ] * 2


def test_a_base_that_moved_is_flagged(two_runs: tuple[Path, Path], tmp_path: Path) -> None:
    moved = calibrated_run(tmp_path / "moved", 3, shift_m=2e-3)
    result = compared(two_runs[0], moved)
    values = {value.name: value for value in result.arms["left"].parameters}
    assert values["x0"].differs
    assert values["x0"].difference == pytest.approx(2e-3, abs=2e-4)
    assert not any(value.name == "x0" and value.differs for value in result.arms["right"].parameters)
    said = "\n".join(comparison_sentences(result))
    assert "arm left: " in said
    assert "x0" in said
    back = {value.name: value for value in compared(moved, two_runs[0]).arms["left"].parameters}
    assert back["x0"].difference == -values["x0"].difference  # type: ignore[operator]


def test_every_value_is_in_the_tables(two_runs: tuple[Path, Path]) -> None:
    result = compared(*two_runs)
    tables = {table.title: table for table in comparison_tables(result)}
    assert tables["Profile: what differs"].text_rows() == (("seed", "1", "2"),)
    parameters = tables["Arm left: identified parameters"].text_rows()
    assert [row[0] for row in parameters] == [value.name for value in result.arms["left"].parameters]
    assert "Pair: held-out cooperative errors [mm]" in tables


def test_effects_in_one_run_only_and_in_both(finished_run: Path, finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        found = read_results(run).discover
        assert found is not None
        (backlash, *rest) = found.arms["right"].accepted
        changed = {
            name: value.model_copy(update={"value": 1.5 * value.value}) for name, value in backlash.parameters.items()
        }
        right = found.arms["right"].model_copy(
            update={"accepted": (backlash.model_copy(update={"parameters": changed}), *rest)}
        )
        left = found.arms["left"].model_copy(update={"accepted": ()})
        store(run, found.model_copy(update={"arms": {"left": left, "right": right}}))
    result = compared(finished_run, finished_copy)
    assert {effect.found_in for effect in result.arms["left"].effects} == {"a"}
    twin = result.arms["right"].effects[0]
    assert (twin.effect, twin.found_in) == (backlash.effect, "both")
    for value in twin.parameters:
        assert value.a is not None
        assert value.difference == pytest.approx(0.5 * value.a)
    assert result.arms["left"].verified_mm["compensated"].b_mean_mm is not None
    said = "\n".join(comparison_sentences(result))
    assert "was found in a only" in said
    assert "was found in both; sizes differ: " in said
    assert f"{finished_copy}: out of date: " in said
    assert {effect.found_in for effect in compared(finished_copy, finished_run).arms["left"].effects} == {"b"}


def store(run: RunFile, result: DiscoverResult) -> None:
    """Append a discovery that the product did not make; nothing rests on its model here."""
    append_stage(run, DISCOVER, result, basis_of(run))


@pytest.mark.fast
def test_runs_without_results_are_compared_by_their_profiles(tmp_path: Path) -> None:
    planned_run(tmp_path / "a").close()
    planned_run(tmp_path / "b").close()
    result = compared(tmp_path / "a", tmp_path / "b")
    assert result.profile == ()
    assert result.pair is None
    assert result.arms == {"left": ArmComparison(), "right": ArmComparison()}
    assert comparison_tables(result) == []
    assert f"{tmp_path / 'b'} is not calibrated" in result.notes
    assert "the profiles are the same" in comparison_sentences(result)


def test_other_arms_and_other_types_are_sentences(two_runs: tuple[Path, Path], tmp_path: Path) -> None:
    profile = without_devices("left", "right")
    swapped = profile.model_copy(
        update={"arms": {"left": profile.arms["right"], "third": profile.arms["left"]}, "name": "other"}
    )
    other = calibrated_run(tmp_path / "other", 4, profile=swapped)
    result = compared(two_runs[0], other)
    assert list(result.arms) == ["left"]
    assert result.arms["left"].parameters == ()
    assert "geometry" in result.arms["left"].heldout_mm
    said = "\n".join(result.notes)
    assert f"arm 'right' is in {two_runs[0]} only; the arms of {other} are left, third" in said
    assert f"arm 'third' is in {other} only" in said
    assert "arm 'left' is of type UR10" in said
    keys = {entry.key: entry for entry in result.profile}
    assert keys["name"].b == '"other"'
    assert keys["arms.left.type.model"].a == '"UR10"'
    assert any(key.startswith("arms.third.") and entry.a is None for key, entry in keys.items())


@pytest.mark.fast
def test_a_run_is_not_compared_with_itself(tmp_path: Path) -> None:
    planned_run(tmp_path / "a").close()
    with (
        RunFile.open(tmp_path / "a") as run,
        RunFile.open(tmp_path / "a" / ".." / "a") as same,
        pytest.raises(InputError, match="are the same run"),
    ):
        compare_runs(run, same)
