"""A run from Python: what it holds, data frames of it, and messages for a caller who mistook something."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import cellapp
from cellapp import dataframes
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.ground.errors import InputError
from cellapp.interfaces.python.api import Run, open_run
from cellapp.robot.kinematics.chain import parameter_names
from tests.approved import assert_approved
from tests.sure import sure
from tests.twin import small_twin


@pytest.fixture(scope="module")
def run(finished_run: Path) -> Run:
    return open_run(finished_run)


def test_residuals_are_as_small_as_the_report_says(run: Run) -> None:
    for arm in run.measured:
        held_out = run.readings(arm).in_split("validate")
        mean_mm = np.linalg.norm(run.residuals(arm)[held_out], axis=1).mean() * 1e3
        stated = sure(run.results.calibrate).arms[arm].validate_["effects"].position_mm.mean
        assert mean_mm == pytest.approx(stated, rel=1e-9)


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
    frame = dataframes.targets(run)
    assert frame.target.tolist() == [target.name for target in sure(run.results.verify).targets]
    assert (frame.compensated_mm < frame.nominal_mm).all()
    assert frame.attrs["units"]["within_mm"] == "mm"


def test_without_pandas_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    for module in ("dataframes", "interfaces.python.frames"):
        monkeypatch.delitem(sys.modules, f"cellapp.{module}", raising=False)
    with pytest.raises(ImportError, match=r"need pandas; install it with: pip install 'cellapp\[pandas\]'"):
        importlib.import_module("cellapp.dataframes")


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


READINGS: dict[str, Any] = {
    "nothing": {},
    "a number": 3.0,
    "no file": "nowhere.csv",
    "misspelt arm": {"lefft": arm(), "right": arm()},
    "one arm": {"left": arm()},
    "no mapping": {"left": [1.0], "right": arm()},
    "no points": {"left": {"q": np.zeros((N, 6))}},
    "unknown quantity": both(p_m=1.0),
    "five joints": both(q=np.zeros((N, 5))),
    "one row": both(q=np.zeros(6)),
    "columns of points": both(p_M=np.zeros((3, N))),
    "fewer points": both(p_M=np.ones((4, 3))),
    "words": both(q=[["a"] * 6] * N),
    "rows differ": {"left": arm(), "right": {name: values[:4] for name, values in arm().items()}},
    "NaN in q": with_cell(2, 3, np.nan),
    "infinite point": with_cell(1, 0, np.inf, "p_M"),
    "degrees": both(q=np.full((N, 6), 90.0)),
    "one in degrees": with_cell(4, 1, 120.0),
    "millimetres": both(p_M=np.full((N, 3), 1500.0)),
    "approach": both(approach=np.full((N, 6), 2)),
    "twice": both(configuration=[0, 1, 2, 3, 4, 4]),
    "half a stop": both(configuration=np.arange(N) + 0.5),
    "sigma": both(sigma_m=-1e-6),
    "a large sigma": both(sigma_m=0.02),
    "heavier than the arm": both(payload_kg=300.0),
    "too few": {name: {key: values[:3] for key, values in arm().items()} for name in ("left", "right")},
    "split": both(split=["test"] * N),
    "no column": frame(x_m=None),
    "column in mm": frame(x_m=None).assign(x_mm=1.0),
    "no joint": frame(q6=None),
    "NaN in a frame": frame(y_m=rows((7, None))),
    "arm in a frame": frame(arm=rows((3, "middle"), of="left")),
    "column twice": frame()[[*frame().columns, "q1"]],
    "empty frame": frame().iloc[:0],
}
CONFIGURATIONS: dict[str, Any] = {
    "one-dimensional": np.zeros(6),
    "seven joints": np.zeros((5, 7)),
    "columns": np.zeros((6, 5)),
    "degrees": np.full((4, 6), 90.0),
    "words": [["a"] * 6],
    "ragged": [[0.0] * 6, [0.0] * 5],
}
CONDITIONS: dict[str, dict[str, Any]] = {
    "misspelt": {"payload": 2.0},
    "too few": {"payload_kg": [1.0, 2.0]},
    "of one joint each": {"approach": np.ones(3)},
    "no direction": {"approach": 2.0},
    "heavier than the arm": {"payload_kg": 300.0},
    "kelvin": {"temperature_c": 293.0},
    "beside an arm": {"other_q": np.zeros(5)},
}
TARGETS: dict[str, Any] = {
    "none": [],
    "no position": [{"name": "A", "arm": "left"}],
    "misspelt arm": [{"name": "A", "arm": "lefft", "position": [0.5, 0.0, 0.5]}],
    "in millimetres": [{"name": "A", "arm": "left", "position": [500, 0, 500]}],
    "misspelt key": [{"name": "A", "arm": "left", "positon": [0.5, 0.0, 0.5]}],
    "no unit": pd.DataFrame({"name": ["A"], "arm": ["left"], "x": [1.0]}),
    "a number": 7,
    "no file": "nowhere.yaml",
}
METHODS = ("predict", "true_joints", "flange", "uncertainty", "measured_uncertainty")


@pytest.fixture(scope="module")
def cell() -> cellapp.Cell:
    return cellapp.Cell(small_twin())


def test_every_mistake_is_explained_as_approved(run: Run, cell: cellapp.Cell, tmp_path: Path) -> None:
    fit, left = run.calibration, run.calibrated_model().arms["left"]
    early = Run(Path("early"), run.profile, {}, type(run.results)(run="early"), None)
    calls: dict[str, Callable[[], object]] = {
        **{f"readings: {name}": partial(cell.calibrate, given) for name, given in READINGS.items()},
        **{f"q: {name}": partial(run.predict, "left", q) for name, q in CONFIGURATIONS.items()},
        **{f"q of {name}": partial(getattr(left, name), np.zeros((5, 7))) for name in METHODS},
        **{f"row of {name}": partial(getattr(left, name), np.zeros(6)) for name in METHODS},
        **{f"{name} of no arm": partial(getattr(run, name), "lefft") for name in ("readings", "residuals")},
        "prediction of no arm": lambda: run.predict("lefft", np.zeros((1, 6))),
        **{
            f"condition: {name}": partial(fit.predict, "left", np.zeros((4, 6)), **given)
            for name, given in CONDITIONS.items()
        },
        **{f"targets: {name}": partial(fit.compensate, given) for name, given in TARGETS.items()},
        "not calibrated": lambda: early.predict("left", np.zeros((1, 6))),
        "no readings": lambda: dataframes.readings(early),
        "no residuals": lambda: dataframes.residuals(early),
        "no targets": lambda: dataframes.targets(early),
        "no folder": lambda: open_run("nowhere"),
    }
    said = []
    for name, call in calls.items():
        with pytest.raises(InputError) as caught:
            call()
        said.append(f"{name}: {caught.value}".replace(str(run.folder), "RUN"))
    assert_approved(Path(__file__).parent / "approved" / "mistakes.txt", "\n".join(said))


def test_unknown_columns_are_kept_and_reported(cell: cellapp.Cell) -> None:
    readings = cell.readings(frame(operator="A. N."))
    assert readings.notes == ("data frame: column 'operator' is unknown; it is kept and not used",)
    assert readings["left"].extras == {"operator": ("A. N.",) * N}
    assert readings.notes[0] in readings.report()
