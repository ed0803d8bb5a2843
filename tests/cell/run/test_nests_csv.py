"""Rows of several nests on a flange through the one door: one reading a stop, mistakes named by row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.run import RunFile, import_csv, write_readings_csv
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Smr
from tests.cell.run.csv_rows import Rows, rows_of, written
from tests.twin import small_twin

pytestmark = pytest.mark.fast
STOPS = 14
OFFSETS = {"A": (0.045, 0.020, 0.060), "B": (-0.05, 0.03, 0.06), "C": (0.0, -0.08, 0.055)}


def with_nests(**changes: Any) -> Profile:
    """The twin's left arm alone, with three nests."""
    profile = small_twin(plant={"effects": {}})
    smr = {"offset": OFFSETS["A"], "name": "A", "nests": {n: {"offset": OFFSETS[n]} for n in "BC"}, **changes}
    arm = profile.arms["left"].model_copy(update={"smr": Smr.model_validate(smr)})
    return profile.model_copy(update={"arms": {"left": arm}})


@pytest.fixture(scope="module")
def profile() -> Profile:
    return with_nests()


@pytest.fixture(scope="module")
def measured(profile: Profile) -> Rows:
    plant = build_plant(profile)
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, (STOPS, 6))
    rows: Rows = []
    for place, name in enumerate(OFFSETS):
        points, _ = plant.measure_positions(plant.smr_positions("left", q, nest="" if name == "A" else name), rng)
        for stop in range(STOPS):
            rows.append(
                {
                    "configuration": str(stop),
                    "arm": "left",
                    "time_s": repr(10.0 * stop + place),
                    **{f"q{joint + 1}": repr(float(angle)) for joint, angle in enumerate(q[stop])},
                    **dict(zip(("x_m", "y_m", "z_m"), map(repr, points[stop].tolist()), strict=True)),
                    "sigma_m": "2e-05",
                    "smr": name,
                    "split": "validate" if stop % 3 == 0 else "identify",
                }
            )
    return sorted(rows, key=lambda row: int(row["configuration"]))


def test_nests_are_one_reading_a_stop_and_are_exported_as_they_were(
    profile: Profile, measured: Rows, tmp_path: Path
) -> None:
    with import_csv(profile, written(tmp_path / "in.csv", measured), tmp_path / "run") as run:
        one, rows = run.readings("left"), run.rows("left")
        write_readings_csv(run, tmp_path / "out.csv")
        assert run.split_counts()["left"] == {"validate": 5, "identify": 9}
        run.assign_splits("left", ["train"] * STOPS)
        assert set(run.rows("left").split or ()) == {"train"}
    assert len(rows) == 3 * STOPS
    assert len(one) == STOPS
    assert one.quaternion_M is not None
    assert one.sigma_rad is not None
    plant = build_plant(profile)
    true = Rotation.from_matrix(plant.true_T_M_B("left")[:3, :3]) * Rotation.from_matrix(
        np.linalg.inv(plant.true_T_M_B("left")[:3, :3]) @ _flange(plant, one.q)
    )
    found = Rotation.from_quat(np.roll(one.quaternion_M, -1, axis=1))
    turned = (true.inv() * found).as_rotvec()  # of S in F, the same at all stops
    assert np.abs(turned - turned.mean(axis=0)).max() < 5.0 * float(one.sigma_rad.max())
    out = rows_of(tmp_path / "out.csv")
    assert [{name: row[name] for name in measured[0]} for row in out] == measured


def _flange(plant: Any, q: np.ndarray) -> np.ndarray:
    """Flange rotations (n, 3, 3) in M from three points of the true arm."""
    mechanism = plant.true_mechanism("left")
    offsets = np.array([mechanism.smr, *mechanism.nests.values()]) - mechanism.smr
    points = np.stack([plant.smr_positions("left", q, nest=name) for name in ("", "B", "C")], axis=1)
    sides = points - points[:, :1]
    third = np.cross(sides[:, 1], sides[:, 2])
    own = np.cross(offsets[1], offsets[2])
    return np.asarray(
        np.stack([sides[:, 1], sides[:, 2], third], axis=2) @ np.linalg.inv(np.column_stack([*offsets[1:], own]))
    )


def exchange(rows: Rows, stops: set[int]) -> None:
    other = {"A": "A", "B": "C", "C": "B"}
    for row in rows:
        if int(row["configuration"]) in stops:
            row["smr"] = other[row["smr"]]


def change(key: str, value: str, place: int) -> Callable[[Rows], None]:
    def act(rows: Rows) -> None:
        rows[place][key] = value

    return act


@pytest.mark.parametrize(
    ("spoil", "line", "column", "says"),
    [
        (lambda rows: exchange(rows, {4}), 14, "smr", "read A, C, B in place of A, B, C: their names are exchanged"),
        (lambda rows: exchange(rows, set(range(STOPS))), 2, "smr", "mm apart"),
        (change("smr", "D", 5), 7, "smr", "'D' is no nest of arm left: its smr has A, B, C"),
        (change("q3", "0.7", 7), 9, "q3", "rad from another row of the same stop"),
        (change("split", "train", 4), 6, "split", "train, but identify in another row of the same stop"),
        (change("x_m", "3.5", 10), 11, "smr", "the nests do not stand as at other stops"),
        (change("smr", "A", 1), 3, "configuration", "0 of arm left was given in line 2 already"),
    ],
)
def test_a_mistake_is_named_by_row(
    profile: Profile,
    measured: Rows,
    tmp_path: Path,
    spoil: Callable[[Rows], None],
    line: int,
    column: str,
    says: str,
) -> None:
    rows = [dict(row) for row in measured]
    spoil(rows)
    path = written(tmp_path / "in.csv", rows)
    with pytest.raises(InputError) as caught:
        import_csv(profile, path, tmp_path / "run")
    first = str(caught.value).splitlines()[0]
    assert first.startswith(f"{path}:{line}: {column}: "), caught.value
    assert says in str(caught.value)


def test_mirrored_offsets_of_the_profile_are_named(measured: Rows, tmp_path: Path) -> None:
    """Three nests that are mirrored keep their distances; only the arm shows how they are turned."""
    plane = {name: (-x, y, z) for name, (x, y, z) in OFFSETS.items()}
    mirrored = with_nests(offset=plane["A"], nests={name: {"offset": plane[name]} for name in "BC"})
    with pytest.raises(InputError, match="are exchanged in all rows, or the offsets in the profile are mirrored"):
        import_csv(mirrored, written(tmp_path / "in.csv", measured), tmp_path / "run")


def test_a_stated_distance_that_the_readings_contradict_is_named(measured: Rows, tmp_path: Path) -> None:
    stated = with_nests(
        nests={"B": {}, "C": {}},
        distances=[{"between": ["A", "B"], "distance": 0.0955}, {"between": ["B", "C"], "distance": 0.3}],
    )
    with pytest.raises(InputError, match=r"nests B and C are .* mm apart, 300.00 mm by arms.left.smr.distances"):
        import_csv(stated, written(tmp_path / "in.csv", measured), tmp_path / "run")


def test_nests_of_unknown_offsets_are_taken(measured: Rows, tmp_path: Path) -> None:
    unknown = with_nests(nests={"B": {}, "C": {}})
    with import_csv(unknown, written(tmp_path / "in.csv", measured), tmp_path / "run") as run:
        assert run.readings("left").quaternion_M is not None
    with RunFile.open(tmp_path / "run") as run:
        assert len(run.readings("left")) == STOPS
