"""A run from Python: what it holds, data frames of it, and messages for a caller who mistook something."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.ground.errors import InputError
from cellapp.interfaces.python import dataframes
from cellapp.interfaces.python.api import Run, open_run
from cellapp.robot.kinematics.chain import parameter_names
from cellapp.robot.model.arguments import configurations, require_radians


@pytest.fixture(scope="module")
def run(finished_run: Path) -> Run:
    return open_run(finished_run)


def test_the_run_is_a_snapshot_of_the_file(run: Run, finished_run: Path) -> None:
    with RunFile.open(finished_run) as file:
        for arm in file.arms():
            assert np.array_equal(run.readings(arm).q, file.readings(arm).q)
        assert run.profile == file.profile
    assert list(run.measured) == ["left", "right"]
    assert run.results.discover is not None


def test_residuals_are_as_small_as_the_report_says(run: Run) -> None:
    assert run.results.calibrate is not None
    for arm in run.measured:
        held_out = run.readings(arm).in_split("validate")
        mean_mm = np.linalg.norm(run.residuals(arm)[held_out], axis=1).mean() * 1e3
        stated = run.results.calibrate.arms[arm].validate_["effects"].position_mm.mean
        assert mean_mm == pytest.approx(stated, rel=1e-9)


def test_one_configuration_or_many(run: Run) -> None:
    q = run.readings("left").q[:3]
    p_M = run.predict("left", q)
    assert p_M.shape == (3, 3)
    assert np.allclose(run.predict("left", q[:1].tolist()), p_M[:1], rtol=0.0, atol=1e-12)


MISTAKES: dict[str, tuple[Any, str]] = {
    "one-dimensional": (np.zeros(6), r"q has shape \(6,\), expected \(n, 6\): one row a configuration; .*np.newaxis"),
    "seven joints": (np.zeros((5, 7)), r"q has shape \(5, 7\), expected \(n, 6\): n configurations of 6 joints"),
    "columns": (np.zeros((6, 5)), r"q has shape \(6, 5\), expected \(n, 6\)"),
    "degrees": (np.full((4, 6), 90.0), r"q reaches 90 and most rows .* expected radians"),
    "words": ([["a"] * 6], r"q is no array of numbers; expected shape \(n, 6\)"),
    "ragged": ([[0.0] * 6, [0.0] * 5], r"q is no array of numbers; expected shape \(n, 6\)"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistaken_q_is_explained(run: Run, case: str) -> None:
    q, message = MISTAKES[case]
    with pytest.raises(InputError, match=f"^arm left: {message}"):
        run.predict("left", q)


@pytest.mark.parametrize("method", ["predict", "true_joints", "flange", "uncertainty", "measured_uncertainty"])
def test_the_model_of_an_arm_explains_a_mistaken_shape(run: Run, method: str) -> None:
    ask = getattr(run.calibrated_model().arms["left"], method)
    for q in (np.zeros(6), np.zeros((5, 7))):
        with pytest.raises(InputError, match=r"^q has shape \(.*\), expected \(n, 6\)"):
            ask(q)


def test_a_single_wide_row_is_not_taken_for_degrees() -> None:
    q = np.zeros((3, 6))
    q[1, 2] = 90.0
    require_radians(q, "left")
    assert configurations(q, 6) is q


def test_a_misspelt_arm_is_named_with_those_that_there_are(run: Run) -> None:
    message = "no arm 'lefft'; arms of this {}: left, right; did you mean 'left'?"
    q = np.zeros((1, 6))
    for call in (run.readings, run.residuals):
        with pytest.raises(InputError) as caught:
            call("lefft")
        assert str(caught.value) == message.format("run")
    with pytest.raises(InputError) as caught:
        run.predict("lefft", q)
    assert str(caught.value) == message.format("model")


def test_readings_are_those_of_the_exported_csv(run: Run, finished_run: Path, tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    with RunFile.open(finished_run) as file:
        write_readings_csv(file, path)
    frame = dataframes.readings(run)
    exported = pd.read_csv(path)
    pd.testing.assert_frame_equal(frame, exported, check_dtype=False, rtol=1e-12)
    assert frame.attrs["units"]["q1"] == "rad"
    assert frame.attrs["units"]["x_m"] == "m"
    assert set(frame.attrs["units"]) <= set(frame.columns)


def test_residuals_and_parameters_of_both_arms(run: Run) -> None:
    frame = dataframes.residuals(run)
    assert len(frame) == sum(len(arm) for arm in run.measured.values())
    assert np.allclose(np.linalg.norm(frame[["dx_mm", "dy_mm", "dz_mm"]], axis=1), frame.residual_mm)
    table = dataframes.parameters(run).set_index(["arm", "parameter"])
    left = run.calibrated_model().arms["left"]
    for name, value in zip(parameter_names(6), left.geometry.vector()):
        assert table.loc[("left", name), "identified"] == value
    effects = [name for arm, name in table.index if arm == "left" and "." in name]
    assert {name.partition(".")[0] for name in effects} == {term.slug for term in left.effects}


def test_targets_show_what_was_measured(run: Run) -> None:
    assert run.results.verify is not None
    frame = dataframes.targets(run)
    assert frame.target.tolist() == [target.name for target in run.results.verify.targets]
    assert (frame.compensated_mm < frame.nominal_mm).all()
    assert frame.attrs["units"]["within_mm"] == "mm"


def test_what_a_run_does_not_have_yet_is_said_with_the_command(tmp_path: Path, run: Run) -> None:
    early = Run(tmp_path, run.profile, {}, type(run.results)(run=str(tmp_path)), None)
    with pytest.raises(InputError, match="not calibrated yet; run 'cellapp calibrate"):
        early.predict("left", np.zeros((1, 6)))
    for table in (dataframes.readings, dataframes.residuals):
        with pytest.raises(InputError, match="holds no readings yet"):
            table(early)
    with pytest.raises(InputError, match="no targets yet; run 'cellapp compensate'"):
        dataframes.targets(early)
    with pytest.raises(InputError, match="run folder not found"):
        open_run(tmp_path / "nowhere")


def test_without_pandas_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    for module in ("dataframes", "frames"):
        monkeypatch.delitem(sys.modules, f"cellapp.interfaces.python.{module}", raising=False)
    with pytest.raises(ImportError, match=r"need pandas; install it with: pip install 'cellapp\[pandas\]'"):
        importlib.import_module("cellapp.interfaces.python.dataframes")
