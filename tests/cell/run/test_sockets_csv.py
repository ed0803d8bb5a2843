"""Readings of a ball in sockets through the one door: stored, exported, and bad inputs named by row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, import_csv, write_readings_csv
from cellapp.estimation.readings import Distance
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.cell.run.csv_rows import rows_of, written

pytestmark = pytest.mark.fast
TESTS = Path(__file__).parents[2]
DATA = TESTS / "fixtures" / "panda-sockets"
PROFILE = TESTS.parent / "profiles" / "panda-sockets.yaml"


@pytest.fixture(scope="module")
def profile() -> Profile:
    return load_profile(PROFILE)


def test_points_and_distances_are_stored_and_exported(profile: Profile, tmp_path: Path) -> None:
    with import_csv(profile, DATA / "readings.csv", tmp_path / "run", distances=DATA / "distances.csv"):
        pass
    with RunFile.open(tmp_path / "run") as run:
        readings = run.readings("left")
        write_readings_csv(run, tmp_path / "out.csv")
    assert readings.point is not None
    assert readings.point[0] == "back-high_0"
    assert np.isnan(readings.p_M).all()
    assert readings.distances[0] == Distance("back-high_0", "back-high_1", 0.05, 5e-5)
    assert len(readings.distances) == 3
    assert readings.take([3, 5]).point == (readings.point[3], readings.point[5])
    with import_csv(profile, tmp_path / "out.csv", tmp_path / "again") as again:
        assert again.readings("left").point == readings.point
        np.testing.assert_array_equal(again.readings("left").q, readings.q)


def test_a_point_that_was_touched_once_is_named(profile: Profile, tmp_path: Path) -> None:
    rows = rows_of(DATA / "readings.csv")
    rows[7]["point"] = "alone"
    with pytest.raises(InputError, match=r"readings\.csv:9: point: 'alone' is there once"):
        import_csv(profile, written(tmp_path / "readings.csv", rows), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_row_without_point_and_one_with_both_are_named(profile: Profile, tmp_path: Path) -> None:
    rows = [row | {"x_m": "", "y_m": "", "z_m": ""} for row in rows_of(DATA / "readings.csv")]
    rows[4]["point"] = ""
    with pytest.raises(InputError, match=r":6: point: the value is missing"):
        import_csv(profile, written(tmp_path / "missing.csv", rows), tmp_path / "run")
    rows[4] |= {"point": "back-high_0", "x_m": "1.0", "y_m": "0.0", "z_m": "0.5"}
    with pytest.raises(InputError, match=r":6: point: there is a measured position too"):
        import_csv(profile, written(tmp_path / "both.csv", rows), tmp_path / "run")


def test_swapped_sockets_are_named_by_row(profile: Profile, tmp_path: Path) -> None:
    rows = rows_of(DATA / "readings.csv")
    swapped = {"front_0": "front_1", "front_1": "front_0"}
    of_front = [place for place, row in enumerate(rows) if row["point"] in swapped]
    for place in (wrong := of_front[:3]):
        rows[place]["point"] = swapped[rows[place]["point"]]
    with pytest.raises(InputError) as caught:
        import_csv(profile, written(tmp_path / "readings.csv", rows), tmp_path / "run")
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    for place, line in zip(wrong, lines, strict=True):
        assert f"readings.csv:{place + 2}: point: " in line
        assert "are the two swapped?" in line


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distance_m": "0.5"}, r":2: distance_m: 0\.5 m from 'back-high_0' to 'back-high_1'.* finds 0\.0"),
        ({"distance_m": "-0.05"}, r":2: distance_m: expected metres above 0"),
        ({"distance_m": "fifty"}, r":2: distance_m: expected metres above 0 .* got 'fifty'"),
        ({"sigma_m": "0"}, r":2: sigma_m: expected metres above 0"),
        ({"point_b": "back-hihg_1"}, r":2: point_b: no reading is of a point 'back-hihg_1'; is 'back-high_1' meant"),
        ({"point_b": "back-high_0"}, r":2: point_b: 'back-high_0' is both points"),
        ({"point_a": "front_1", "point_b": "front_0"}, r":3: point_a: the distance is in line 2 already"),
    ],
)
def test_wrong_distances_are_named_by_row(
    profile: Profile, tmp_path: Path, change: dict[str, str], message: str
) -> None:
    rows = rows_of(DATA / "distances.csv")
    rows[0] |= change
    path = written(tmp_path / "distances.csv", rows)
    with pytest.raises(InputError, match=message):
        import_csv(profile, DATA / "readings.csv", tmp_path / "run", distances=path)
    assert not (tmp_path / "run").exists()


def test_placements_whose_names_were_exchanged_show_by_their_distances(profile: Profile, tmp_path: Path) -> None:
    rows = rows_of(DATA / "readings.csv")
    exchanged = {"front_0": "right_0", "right_0": "front_0"}
    for row in rows:
        row["point"] = exchanged.get(row["point"], row["point"])
    path = written(tmp_path / "readings.csv", rows)
    with pytest.raises(InputError, match=r"distances\.csv:3: distance_m: .*swapped") as caught:
        import_csv(profile, path, tmp_path / "run", distances=DATA / "distances.csv")
    assert "distances.csv:4" in str(caught.value)


def test_distances_without_points_are_refused(tmp_path: Path) -> None:
    profile = load_profile(TESTS.parent / "profiles" / "ur5-real.yaml")
    with pytest.raises(InputError, match="no reading names one"):
        import_csv(
            profile,
            TESTS / "fixtures" / "ur5-real" / "readings.csv",
            tmp_path / "run",
            distances=DATA / "distances.csv",
        )


def of_both_arms(profile: Profile, changed: dict[str, dict[str, str]]) -> tuple[Profile, list[dict[str, str]]]:
    """Two equal arms that touched the same sockets, with other names of some of them, by arm."""
    both = profile.model_copy(update={"arms": {"left": profile.arms["left"], "right": profile.arms["left"]}})
    rows = []
    for arm in both.arms:
        for row in rows_of(DATA / "readings.csv"):
            number = int(row["configuration"]) + (1000 if arm == "right" else 0)
            point = changed.get(arm, {}).get(row["point"], row["point"])
            rows.append(row | {"arm": arm, "configuration": str(number), "point": point})
    return both, rows


def test_sockets_that_two_arms_name_differently_are_named_by_row(profile: Profile, tmp_path: Path) -> None:
    exchanged = {"back-high_0": "front_0", "front_0": "back-high_0"}
    both, rows = of_both_arms(profile, {"right": exchanged})
    place = [(row["arm"], row["point"]) for row in rows].index(("right", "front_0"))
    words = rf":{place + 2}: point: 'front_0' is not where the other arm touched it: .* exchanged by \d mm"
    with pytest.raises(InputError, match=words):
        import_csv(both, written(tmp_path / "readings.csv", rows), tmp_path / "run")


def test_a_distance_between_two_arms_that_is_ten_times_too_long_is_named_by_row(
    profile: Profile, tmp_path: Path
) -> None:
    both, rows = of_both_arms(profile, {"left": {"front_0": "of left"}, "right": {"front_1": "of right"}})
    path = written(tmp_path / "readings.csv", rows)
    known = {"point_a": "of left", "point_b": "of right", "distance_m": "0.05", "sigma_m": "0.00005"}
    with import_csv(both, path, tmp_path / "run", distances=written(tmp_path / "good.csv", [known])) as run:
        assert run.readings("left").distances == (Distance("of left", "of right", 0.05, 5e-5),)
    wrong = written(tmp_path / "wrong.csv", [known | {"distance_m": "0.5"}])
    with pytest.raises(InputError, match=r"wrong\.csv:2: distance_m: 0\.5 m from 'of left' to 'of right', but the pub"):
        import_csv(both, path, tmp_path / "again", distances=wrong)


def test_a_distance_between_arms_of_a_cell_of_three_is_refused(profile: Profile, tmp_path: Path) -> None:
    both, rows = of_both_arms(profile, {"left": {"front_0": "of left"}, "right": {"front_1": "of right"}})
    three = both.model_copy(update={"arms": {**both.arms, "third": both.arms["left"]}})
    rows += [
        row | {"arm": "third", "configuration": str(2000 + k)} for k, row in enumerate(rows) if row["arm"] == "left"
    ]
    known = {"point_a": "of left", "point_b": "of right", "distance_m": "0.05", "sigma_m": "0.00005"}
    between = known | {"point_a": "back-high_0"}
    path, distances = written(tmp_path / "readings.csv", rows), written(tmp_path / "known.csv", [known, between])
    with pytest.raises(InputError, match=r"known\.csv:2: point_b: .*different arms; with more than two") as caught:
        import_csv(three, path, tmp_path / "run", distances=distances)
    assert len(str(caught.value).splitlines()) == 1
