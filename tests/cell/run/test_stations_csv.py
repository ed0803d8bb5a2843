"""Readings of two tracker stations through the one door: tied by reference nests, mistakes named by row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.run import RunFile
from cellapp.cell.run.stations import STATIONS_RESULT, stored_tie_sentences
from cellapp.commands.import_ import import_new_run
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import apply, invert, transform
from tests.cell.run.csv_rows import Rows, written
from tests.cell.run.test_several_smrs import change, left_alone

pytestmark = pytest.mark.fast
T = transform(Rotation.from_euler("z", 1.2).as_matrix(), [2.0, -1.0, 0.2])
NESTS = np.array([[2.0, 1.5, -0.5], [3.5, -1.0, -0.5], [4.5, 1.0, -0.4], [3.0, 0.2, -0.6], [4.8, -1.2, 0.3]])
POINTS = np.random.default_rng(2).uniform(-0.8, 0.8, (12, 3)) + np.array([3.5, 0.0, 0.3])


def xyz(p: np.ndarray) -> dict[str, str]:
    return dict(zip(("x_m", "y_m", "z_m"), map(repr, p.tolist()), strict=True))


def readings() -> Rows:
    q = np.random.default_rng(4).uniform(-1.0, 1.0, (12, 6))
    back = apply(invert(T), POINTS)
    return [
        {
            "configuration": str(k),
            "arm": "left",
            **{f"q{j + 1}": repr(float(a)) for j, a in enumerate(q[k])},
            **xyz(POINTS[k] if k < 6 else back[k]),
            "station": "north" if k < 6 else "south",
        }
        for k in range(12)
    ]


def nests() -> Rows:
    noise = np.random.default_rng(5).normal(0.0, 1e-5, (2, 5, 3))
    rows = [{"station": "north", "nest": f"F{k}", **xyz(p)} for k, p in enumerate(NESTS + noise[0])]
    return rows + [
        {"station": "south", "nest": f"F{k}", **xyz(p)} for k, p in enumerate(apply(invert(T), NESTS) + noise[1])
    ]


def test_two_stations_are_one_frame_and_the_import_says_how_well(tmp_path: Path) -> None:
    table, floor = written(tmp_path / "in.csv", readings()), written(tmp_path / "floor.csv", nests())
    result = import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)
    (note,) = (one for one in result.notes if one.startswith("station south is tied to north by 5 reference nests"))
    assert "a coordinate of arm left is known to 0.0" in note
    with RunFile.open(tmp_path / "run") as run:
        left = run.readings("left")
        assert run.rows("left").station == ("north",) * 6 + ("south",) * 6
    assert left.station is None
    np.testing.assert_allclose(left.p_M[:6], POINTS[:6], atol=1e-12)
    np.testing.assert_allclose(left.p_M[6:], POINTS[6:], atol=5e-5)


def test_stations_without_nests_are_refused(tmp_path: Path) -> None:
    table = written(tmp_path / "in.csv", readings())
    with pytest.raises(InputError, match=r"readings of 2 stations \(north, south\) have frames of their own"):
        import_new_run(left_alone(), table, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def drop(count: int) -> Callable[[Rows], None]:
    def act(rows: Rows) -> None:
        del rows[-count:]

    return act


def exchange(rows: Rows) -> None:
    rows[6]["nest"], rows[8]["nest"] = "F3", "F1"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (drop(3), "station 'south' is not tied to 'north': measure three nests or more"),
        (change("x_m", "2.001", 0), "F0"),
        (change("nest", "F1", 5), r":8: nest: 'F1' of station 'south' is in line 7 already"),
        (change("y_m", "far", 3), r":5: y_m: expected metres up to 100, got 'far'"),
        (change("station", "", 3), r":5: station: the value is missing"),
        (exchange, "did it move, or are names exchanged"),
        (drop(5), "no nest of station south, which readings of arm left name"),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, spoil: Callable[[Rows], None], says: str) -> None:
    rows = nests()
    spoil(rows)
    table, floor = written(tmp_path / "in.csv", readings()), written(tmp_path / "floor.csv", rows)
    with pytest.raises(InputError, match=says):
        import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)
    assert not (tmp_path / "run").exists()


def test_a_stop_of_two_stations_is_named(tmp_path: Path) -> None:
    rows = readings()
    rows[6]["configuration"] = "2"
    table, floor = written(tmp_path / "in.csv", rows), written(tmp_path / "floor.csv", nests())
    with pytest.raises(InputError, match="give each station stops of its own"):
        import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)


def test_the_words_are_kept_for_calibration(tmp_path: Path) -> None:
    table, floor = written(tmp_path / "in.csv", readings()), written(tmp_path / "floor.csv", nests())
    import_new_run(left_alone(), table, tmp_path / "run", reference_nests=floor)
    with RunFile.open(tmp_path / "run") as run:
        (sentence,) = stored_tie_sentences(run.read_result(STATIONS_RESULT))
    assert sentence.startswith("station south is tied to north")
    assert stored_tie_sentences(None) == ()
