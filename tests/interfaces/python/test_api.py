"""A run from Python: what it holds, data frames of it, and messages for a caller who mistook something."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import cellapp
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.ground.errors import InputError
from cellapp.interfaces.python import dataframes
from cellapp.interfaces.python.api import Run, open_run
from cellapp.robot.kinematics.chain import parameter_names
from cellapp.robot.model.arguments import configurations, require_radians
from tests.twin import small_twin


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


# -- What a caller mistook is one sentence: where, what was expected, what to do ---------------------------------------

N = 6
RNG = np.random.default_rng(1)


def arm(**changes: Any) -> dict[str, Any]:
    """Plausible readings of one arm."""
    return {"q": RNG.uniform(-1.0, 1.0, (N, 6)), "p_M": RNG.uniform(1.0, 2.0, (N, 3)), **changes}


def both(**changes: Any) -> dict[str, dict[str, Any]]:
    return {"left": arm(**changes), "right": arm()}


def with_cell(row: int, place: int, value: float, name: str = "q") -> dict[str, dict[str, Any]]:
    readings = both()
    readings["left"][name][row, place] = value
    return readings


def frame(**changes: Any) -> pd.DataFrame:
    """The same as a data frame, with columns changed; None takes a column out."""
    parts = [
        pd.DataFrame(
            {
                "configuration": np.arange(N),
                "arm": name,
                **{f"q{joint + 1}": one["q"][:, joint] for joint in range(6)},
                **{f"{axis}_m": one["p_M"][:, place] for place, axis in enumerate("xyz")},
            }
        )
        for name, one in both().items()
    ]
    made = pd.concat(parts, ignore_index=True)
    for column, values in changes.items():
        made = made.drop(columns=column) if values is None else made.assign(**{column: values})
    return made


def rows(*changed: tuple[int, Any], of: Any = 1.0) -> list[Any]:
    values = [of] * (2 * N)
    for row, value in changed:
        values[row] = value
    return values


DEGREES = np.full((N, 6), 90.0)
CASES: dict[str, tuple[Any, str]] = {
    "nothing": ({}, "readings: no arm is given; expected arrays of left, right"),
    "a number": (3.0, "readings: expected the path of a CSV file, a data frame, or arrays by arm .*, got float"),
    "no file": ("nowhere.csv", "nowhere.csv: file not found; give a CSV file of readings"),
    "misspelt arm": (
        {"lefft": arm(), "right": arm()},
        "no arm 'lefft'; arms of profile twin: left, right; did you mean 'left'\\?",
    ),
    "one arm": ({"left": arm()}, "readings: arm: no reading of arm right of the profile; add its readings, or remove"),
    "no mapping": ({"left": np.zeros((N, 6)), "right": arm()}, "arm left: expected names with arrays"),
    "no points": ({"left": {"q": np.zeros((N, 6))}}, r"arm left: p_M is missing; expected an array \(n, 3\) \[m\]"),
    "unknown quantity": (both(p_m=1.0), "arm left: no quantity is called 'p_m'; did you mean 'p_M'\\?"),
    "five joints": (
        both(q=np.zeros((N, 5))),
        r"arm left: q has shape \(6, 5\), expected \(n, 6\) \[rad\] with n = 6",
    ),
    "one row": (both(q=np.zeros(6)), r"arm left: q has shape \(6,\), .*; a single row is array\[np.newaxis\]"),
    "columns of points": (both(p_M=np.zeros((3, N))), r"arm left: p_M has shape \(3, 6\), expected \(n, 3\) \[m\]"),
    "fewer points": (both(p_M=np.ones((4, 3))), r"arm left: p_M has shape \(4, 3\), .* with n = 6, the rows of q"),
    "words": (both(q=[["a"] * 6] * N), r"arm left: q is no array of numbers; expected shape \(n, 6\) \[rad\]"),
    "rows differ": (
        {"left": arm(), "right": {name: values[:4] for name, values in arm().items()}},
        r"readings: 6 of arm left, 4 of arm right; give 'configuration' \(n,\)",
    ),
    "NaN in q": (with_cell(2, 3, np.nan), "arm left, row 2: q4: the value is missing"),
    "infinite point": (
        with_cell(1, 0, np.inf, "p_M"),
        "arm left, row 1: x_m: expected a finite number such as 0.25, got 'inf'",
    ),
    "degrees": (both(q=DEGREES), "arm left, row 0: q1: expected radians, got 90, and most rows are beyond two turns"),
    "one in degrees": (with_cell(4, 1, 120.0), "arm left, row 4: q2: expected -6.283 to 6.283 rad .*; degrees\\?"),
    "millimetres": (both(p_M=np.full((N, 3), 1500.0)), "arm left, row 0: x_m: expected metres, got 1500"),
    "approach": (both(approach=np.full((N, 6), 2)), r"arm left, row 0: approach1: expected -1, 0 \(unknown\) or 1"),
    "twice": (
        both(configuration=[0, 1, 2, 3, 4, 4]),
        "configuration: 4 .* in arm left, row 4 already",
    ),
    "half a stop": (both(configuration=np.arange(N) + 0.5), "configuration: expected a whole number, got '0.5'"),
    "sigma": (both(sigma_m=-1e-6), "arm left, row 0: sigma_m: expected an uncertainty above 0 m"),
    "split": (both(split=["test"] * N), "arm left, row 0: split: expected identify, train, validate or nothing"),
    "no column": (frame(x_m=None), "^data frame: x_m: the column is missing$"),
    "column in mm": (
        frame(x_m=None).assign(x_mm=1.0),
        "^data frame: x_m: the column is missing; is 'x_mm' meant\\? Its name and unit must be as written here",
    ),
    "no joint": (frame(q6=None), "data frame: q6: the column is missing; arm left has 6 joints"),
    "NaN in a frame": (frame(y_m=rows((7, None))), "data frame, row 7: y_m: the value is missing"),
    "arm in a frame": (frame(arm=rows((3, "middle"), of="left")), "data frame, row 3: arm: arm 'middle' is not in the"),
    "empty frame": (frame().iloc[:0], "data frame: there is a header row but no reading"),
}


@pytest.fixture(scope="module")
def cell() -> cellapp.Cell:
    return cellapp.Cell(small_twin())


@pytest.mark.parametrize("case", CASES)
def test_mistaken_readings_are_explained(cell: cellapp.Cell, case: str) -> None:
    source, message = CASES[case]
    with pytest.raises(cellapp.InputError, match=message):
        cell.calibrate(source)


def test_rows_of_a_frame_are_named_by_its_index(cell: cellapp.Cell) -> None:
    named = frame(z_m=rows((2, 4000.0))).set_axis([f"stop {row}" for row in range(2 * N)])
    with pytest.raises(cellapp.InputError, match="data frame, row stop 2: z_m: expected metres, got 4000"):
        cell.readings(named)


def test_unknown_columns_are_kept_and_reported(cell: cellapp.Cell) -> None:
    readings = cell.readings(frame(operator="A. N."))
    assert readings.notes == ("data frame: column 'operator' is unknown; it is kept and not used",)
    assert readings["left"].extras == {"operator": ("A. N.",) * N}
    assert readings.notes[0] in readings.report()


def test_too_few_readings_are_refused_with_their_number(cell: cellapp.Cell) -> None:
    few = {name: {key: values[:3] for key, values in arm().items()} for name in ("left", "right")}
    with pytest.raises(cellapp.InputError, match=r"arm 'left': 3 readings leave .* measure more configurations"):
        cell.calibrate(few)
    same = {name: {key: np.repeat(values[:1], 80, axis=0) for key, values in its.items()} for name, its in few.items()}
    with pytest.raises(cellapp.InputError, match="1 different configuration to identify"):
        cell.calibrate(same)
    for key, value, words in (
        ("payload_kg", 300.0, "own mass"),
        ("sigma_m", 0.02, "expected 1e-10 to 0.01 m, got 0.02"),
    ):
        with pytest.raises(cellapp.InputError, match=words):
            cell.readings({name: {**arm(), key: value} for name in ("left", "right")})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"payload": 2.0}, "arm left: no condition is called 'payload'; known are .*; did you mean 'payload_kg'\\?"),
        ({"payload_kg": [1.0, 2.0]}, r"arm left: payload_kg: expected shape \(4,\) or one number for all"),
        ({"approach": np.ones(3)}, r"arm left: approach: expected shape \(4, 6\) or one number for all"),
        ({"approach": 2.0}, "approach: expected -1, 0 \\(unknown\\) or 1, got 2"),
        ({"payload_kg": 300.0}, "payload_kg: expected at most the arm's own mass, .* kg, got 300"),
        ({"temperature_c": 293.0}, "temperature_c: expected -100 to 200 degC, not kelvin"),
        ({"other_q": np.zeros(5)}, r"arm beside left: q has shape \(1, 5\), expected \(n, 6\)"),
    ],
)
def test_mistaken_conditions_are_explained(finished_run: Path, given: dict[str, Any], message: str) -> None:
    fit = cellapp.open_run(finished_run).calibration
    with pytest.raises(cellapp.InputError, match=message):
        fit.predict("left", np.zeros((4, 6)), **given)
    with pytest.raises(cellapp.InputError, match=r"q\[0, 0\] is nan; expected a finite number"):
        fit.uncertainty("left", np.full((1, 6), np.nan))


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([], "targets: .*at least 1"),
        ([{"name": "A", "arm": "left"}], "target 'A': position: missing"),
        ([{"name": "A", "arm": "lefft", "position": [0.5, 0.0, 0.5]}], "target 'A': no arm 'lefft'; arms are left,"),
        ([{"name": "A", "arm": "left", "position": [500, 0, 500]}], "position"),
        ([{"name": "A", "arm": "left", "positon": [0.5, 0.0, 0.5]}], "did you mean 'position'\\?"),
        (pd.DataFrame({"name": ["A"], "arm": ["left"], "x": [1.0]}), "data frame: x: has no unit; name it x_mm or x_m"),
        (7, "targets: expected a path, a list, keys with values or a data frame, got 7"),
        ("nowhere.yaml", "nowhere.yaml: .*not found"),
    ],
)
def test_mistaken_targets_are_explained(finished_run: Path, targets: Any, message: str) -> None:
    fit = cellapp.open_run(finished_run).calibration
    with pytest.raises(cellapp.InputError, match=message):
        fit.compensate(targets)
