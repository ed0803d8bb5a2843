"""The library on readings of the simulated cell: what the commands store, the truth behind it, and no file written."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import cellapp
from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import sample_stops
from cellapp.cell.profile.loader import load_text
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.cell.run.csv_export import table_of_arrays
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.targets.targets import load_targets
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.robot.effects import MeasurementConditions
from tests.conftest import FEW_TARGETS
from tests.sure import sure
from tests.twin import PROFILES, finished_twin

TARGETS = PROFILES / "targets" / "twin.yaml"


@pytest.fixture(scope="module")
def fit(run: cellapp.Run, tmp_path_factory: pytest.TempPathFactory) -> Iterator[cellapp.Calibration]:
    """The cell of the finished run, calibrated by the library in a folder in which nothing appears."""
    empty = tmp_path_factory.mktemp("empty")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(empty)
        made = cellapp.Cell(run.profile).calibrate(run.measured)
        yield made
    assert list(empty.iterdir()) == []


@pytest.fixture(scope="module")
def found(run: cellapp.Run) -> cellapp.Discovery:
    return run.discovery


def without(result: Any, *keys: str) -> Any:
    """A result as plain data without what differs from one time to the next."""

    def cut(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: cut(part) for key, part in value.items() if key not in keys}
        return [cut(part) for part in value] if isinstance(value, list) else value

    return cut(result.model_dump(mode="json"))


# -- what the commands give -------------------------------------------------------------------------------------------


def test_calibrate_gives_what_the_command_stored(fit: cellapp.Calibration, run: cellapp.Run) -> None:
    stored = sure(run.results.calibrate).without_effects()
    assert without(fit.result, "written") == without(stored, "written")
    q = run.readings("left").q
    assert np.array_equal(fit.predict("left", q), run.calibration.predict("left", q))


def test_discover_gives_what_the_command_stored(fit: cellapp.Calibration, found: cellapp.Discovery) -> None:
    searched = fit.discover()
    assert without(searched.result, "seconds") == without(found.result, "seconds")
    assert searched.effects == {"left": ("joint_compliance",), "right": ("backlash",)}
    assert searched.calibration is fit
    for arm, readings in fit.readings.items():
        assert np.array_equal(searched.predict(arm, readings.q), found.predict(arm, readings.q))


def test_compensate_gives_what_the_command_stored(found: cellapp.Discovery, run: cellapp.Run) -> None:
    wanted = load_targets(TARGETS, run.profile)[:FEW_TARGETS]
    moves = found.compensate(wanted)
    assert moves.result.targets == sure(run.results.compensate).targets
    of_file = found.compensate(TARGETS)
    assert of_file.result.targets[: len(moves.result.targets)] == moves.result.targets


def test_residuals_and_tables_are_those_of_the_run(found: cellapp.Discovery, run: cellapp.Run) -> None:
    for arm in run.measured:
        assert np.array_equal(found.residuals_M[arm], run.residuals(arm))
    pd.testing.assert_frame_equal(found.residuals(), cellapp.dataframes.residuals(run))
    pd.testing.assert_frame_equal(found.parameters(), cellapp.dataframes.parameters(run))


# -- the truth --------------------------------------------------------------------------------------------------------


def test_what_is_found_predicts_the_true_cell_within_its_uncertainty(found: cellapp.Discovery) -> None:
    profile = finished_twin()
    plant = build_plant(profile)
    q = sample_stops(cell_bodies(profile), profile, 150, np.random.default_rng(7))
    for arm in q:
        sign = np.sign(np.random.default_rng(8).normal(size=q[arm].shape))
        others = {name: stops for name, stops in q.items() if name != arm}
        true_M = plant.smr_positions(arm, q[arm], approach=sign, others=others, last_step=0.3 * sign)
        error = found.predict(arm, q[arm], approach=sign, step=0.3 * sign) - true_M
        stated = found.uncertainty(arm, q[arm], approach=sign, step=0.3 * sign)
        assert np.linalg.norm(error, axis=1).mean() < 0.03e-3, arm
        # errors of different postures are of the same parameters: they scatter less or more together
        assert 0.3 < np.sqrt(np.mean((error / stated[:, np.newaxis]) ** 2)) < 2.0, arm


def test_conditions_are_those_of_the_model(found: cellapp.Discovery) -> None:
    q = found.readings["right"].q[:4]
    below = found.predict("right", q, approach=1)
    assert np.array_equal(below, found.model.predict("right", q, approach=np.ones_like(q)))
    assert np.linalg.norm(below - found.predict("right", q, approach=-1), axis=1).max() > 0.05e-3
    heavier = found.predict("left", q, payload_kg=3.0, other_q=np.zeros(6))
    stated = MeasurementConditions(payload_kg=np.full(4, 3.0))
    assert np.allclose(heavier, found.model.predict("left", q, conditions=stated), rtol=0.0, atol=1e-12)
    assert np.array_equal(found.predict("left", q), found.model.predict("left", q))


# -- readings ---------------------------------------------------------------------------------------------------------


def test_file_data_frame_and_arrays_are_the_same_readings(run: cellapp.Run, finished_run: Path, tmp_path: Path) -> None:
    cell, path = cellapp.Cell(run.profile), tmp_path / "readings.csv"
    with RunFile.open(finished_run) as file:
        write_readings_csv(file, path)
    arrays = {
        name: {column.name: getattr(arm, column.name) for column in COLUMNS} for name, arm in run.measured.items()
    }
    frame = cellapp.dataframes.readings(run)
    for source in (path, str(path), frame, frame.iloc[::-1], arrays, run.measured, cell.readings(frame)):
        checked = cell.readings(source)
        assert list(checked) == ["left", "right"]
        assert ["110 configurations and 10 repeats" in note for note in checked.notes] == [True, True]
        for name, arm in run.measured.items():
            for column in COLUMNS:
                assert_same(getattr(checked[name], column.name), getattr(arm, column.name))
    pd.testing.assert_frame_equal(cell.readings(arrays).frame(), frame)
    n = len(arrays["left"]["q"])
    arrays["left"] |= {"configuration": [np.int64(one) for one in arrays["left"]["configuration"]]}
    arrays["left"] |= {"split": [*["train"] * (n - 2), float("nan"), "identify"], "smr": None, "station": [1] * n}
    given = table_of_arrays(run.profile, arrays).cells
    assert (given["configuration"][0], given["split"][n - 2], given["station"][0]) == ("0", "", "1")


def assert_same(one: Any, other: Any) -> None:
    if isinstance(other, np.ndarray):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other, equal_nan=other.dtype.kind == "f")
    else:
        assert one == other


def test_targets_may_be_mappings_or_a_data_frame(found: cellapp.Discovery) -> None:
    listed: list[Mapping[str, Any]] = [
        {"name": "A", "arm": "left", "position": np.array([0.6, 0.2, 0.4]), "tolerance": "0.2 mm"},
        {"name": "B", "arm": "right", "position": (0.4, 0.1, 0.3)},
        {"name": "far", "arm": "right", "position": [3.0, 0.0, 0.3]},
    ]
    moves = found.compensate(listed)
    rows = [(one["name"], one["arm"], *(1e3 * value for value in one["position"])) for one in listed]
    frame = pd.DataFrame(rows, columns=["name", "arm", "x_mm", "y_mm", "z_mm"])
    frame["tolerance_mm"] = [0.2, None, None]
    assert np.allclose(found.compensate(frame).q("left"), moves.q("left"), rtol=0.0, atol=1e-9)
    assert moves.q("right").shape == (2, 6)
    assert np.isnan(moves.q("right")[1]).all(), "a target that is refused has no command"
    assert moves.frame().target.tolist() == ["A", "B", "far"]
    assert "2 of 3 targets compensated" in moves.report()
    assert "2 of 3" in repr(moves)


# -- a profile, names, imports ----------------------------------------------------------------------------------------


def test_a_profile_may_be_a_file_or_a_mapping() -> None:
    content = load_text(PROFILES / "twin.yaml").data
    cell = cellapp.Cell.load(PROFILES / "twin.yaml")
    assert cellapp.Cell.from_dict(content, PROFILES) == cell
    del content["arms"]["left"]["smr"]
    with pytest.raises(cellapp.InputError, match=r"^profile: arms\.left\.smr: missing"):
        cellapp.Cell.from_dict(content, PROFILES)
    with pytest.raises(cellapp.InputError, match=r"^profile: arms\.left\.type: file not found: .*ur10\.yaml"):
        cellapp.Cell.from_dict(content)


def test_public_names_are_found_late_and_listed() -> None:
    from cellapp import dataframes
    from cellapp.api import Run, open_run

    assert (Run, open_run) == (cellapp.Run, cellapp.open_run)
    assert cellapp.dataframes.residuals is dataframes.residuals
    assert {"Cell", "open_run", "InputError", "__version__"} <= set(dir(cellapp))
    for name in dir(cellapp):
        assert getattr(cellapp, name) is not None or name.startswith("__")
    with pytest.raises(AttributeError, match="module 'cellapp' has no attribute 'Sell'"):
        _ = cellapp.Sell


def test_import_alone_loads_nothing_heavy() -> None:
    heavy = {"numpy", "scipy", "pydantic", "pandas", "matplotlib", "typer", "rich", "textual", "yaml"}
    code = f"import sys, cellapp; sys.exit(', '.join({heavy!r} & sys.modules.keys()) or None)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_the_library_loads_no_screen_and_no_driver_of_an_arm() -> None:
    heavy = {"torch", "textual", "plotly", "typer", "pandas", "matplotlib", "rtde_control"}
    code = f"import sys, cellapp; cellapp.Cell; sys.exit(', '.join({heavy!r} & sys.modules.keys()) or None)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
