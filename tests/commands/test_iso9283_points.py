"""Another program computes every figure of a test again from the file of raw points: here with its own formulas."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path
from statistics import fmean, stdev

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.iso9283 import programme
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283.request import VERB, Iso9283Request
from cellapp.commands.iso9283.run import iso9283_run
from cellapp.commands.iso9283.view import iso9283_tables
from cellapp.commands.record import Work
from cellapp.estimation.iso9283.evaluate import orientation_characteristics
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import Outputs
from cellapp.ground.profile.sections import Smr
from tests.cell.planning.planned_cells import one_arm
from tests.commands.test_iso9283 import asked, left_alone
from tests.estimation.iso9283.test_driving import only_paths
from tests.sure import sure

Point = tuple[float, float, float]
Rows = list[dict[str, str]]


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Iso9283Result, Path]]:
    folder = tmp_path_factory.mktemp("iso") / "run"
    with pytest.MonkeyPatch.context() as patch, RunFile.create(folder, left_alone()) as run:
        patch.setattr(programme, "_SEEDS", 4)
        only_paths(patch, "line")
        tests = ["pose", "multidirectional", "distance", "drift", "path"]
        yield iso9283_run(run, asked(run, tests=tests, cycles=3, nominal=True, drift_minutes=0.5), Work()), folder


def rows_of(tested: tuple[Iso9283Result, Path]) -> Rows:
    result, folder = tested
    with (folder / result.points_file).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def left(tested: tuple[Iso9283Result, Path]) -> CommandedTests:
    return tested[0].arms["left"].tests["nominal"]


def xyz(row: dict[str, str], keys: str = "x_m y_m z_m") -> Point:
    x, y, z = (float(row[key]) for key in keys.split())
    return x, y, z


def select(rows: Rows, row: str, **wanted: str) -> Rows:
    return [one for one in rows if one["row"] == row and all(one[key] == value for key, value in wanted.items())]


def mean(points: list[Point]) -> Point:
    return fmean(p[0] for p in points), fmean(p[1] for p in points), fmean(p[2] for p in points)


def ap_rp_mm(points: list[Point], commanded: Point) -> tuple[float, float]:
    centre = mean(points)
    off = [math.dist(p, centre) for p in points]
    return 1e3 * math.dist(centre, commanded), 1e3 * (fmean(off) + 3.0 * stdev(off))


def test_ap_rp_and_vap_follow_from_the_points(tested: tuple[Iso9283Result, Path]) -> None:
    rows = rows_of(tested)
    for one in left(tested).pose:
        (wanted,) = select(rows, "commanded", test="pose", place=one.pose)
        ap, rp = ap_rp_mm([xyz(r) for r in select(rows, "measured", test="pose", place=one.pose)], xyz(wanted))
        assert one.accuracy.value_mm == pytest.approx(ap, rel=1e-9, abs=1e-9)
        assert one.repeatability.value_mm == pytest.approx(rp, rel=1e-9, abs=1e-9)
    for each in left(tested).multidirectional:
        means = [
            mean([xyz(r) for r in select(rows, "measured", test="multidirectional", place=each.pose, approach=a)])
            for a in "xyz"
        ]
        largest = max(math.dist(a, b) for a, b in combinations(means, 2))
        assert each.variation.value_mm == pytest.approx(1e3 * largest, rel=1e-9, abs=1e-9)


def test_ad_and_rd_follow_from_the_points(tested: tuple[Iso9283Result, Path]) -> None:
    rows = rows_of(tested)
    (one,) = left(tested).distance
    ends = [[xyz(r) for r in select(rows, "measured", test="distance", place=place)] for place in ("P2", "P4")]
    wanted = math.dist(*(xyz(select(rows, "commanded", test="distance", place=place)[0]) for place in ("P2", "P4")))
    lengths = [math.dist(a, b) for a, b in zip(*ends, strict=True)]
    assert one.accuracy.value_mm == pytest.approx(1e3 * (fmean(lengths) - wanted), rel=1e-9, abs=1e-9)
    assert one.repeatability.value_mm == pytest.approx(1e3 * 3.0 * stdev(lengths), rel=1e-9, abs=1e-9)


def test_drift_follows_from_the_points_and_their_times(tested: tuple[Iso9283Result, Path]) -> None:
    rows = rows_of(tested)
    drift = sure(left(tested).drift)
    (wanted,) = select(rows, "commanded", test="drift")
    groups = [select(rows, "measured", test="drift", group=str(k + 1)) for k in range(len(drift.groups))]
    found = [ap_rp_mm([xyz(r) for r in group], xyz(wanted)) for group in groups]
    for number, value in enumerate((drift.accuracy.value_mm, drift.repeatability.value_mm)):
        assert value == pytest.approx(max(abs(one[number] - found[0][number]) for one in found), rel=1e-9, abs=1e-9)
    minutes = (float(groups[-1][0]["time_s"]) - float(groups[0][0]["time_s"])) / 60.0
    assert drift.minutes == pytest.approx(minutes, rel=1e-9, abs=1e-9)


def crossing(track: list[Point], place: Point, normal: Point) -> Point:
    """Where a track crosses a plane, next to ``place``."""
    best: Point | None = None
    (nx, ny, nz), (px, py, pz) = normal, place
    heights = [nx * (x - px) + ny * (y - py) + nz * (z - pz) for x, y, z in track]
    for (a, b), (low, high) in zip(pairwise(track), pairwise(heights), strict=True):
        if low <= 0.0 < high:
            share = low / (low - high)
            x, y, z = (a[k] + share * (b[k] - a[k]) for k in range(3))
            if best is None or math.dist((x, y, z), place) < math.dist(best, place):
                best = x, y, z
    return sure(best)


def test_at_and_rt_follow_from_the_points(tested: tuple[Iso9283Result, Path]) -> None:
    rows = rows_of(tested)
    for one in left(tested).path:
        own = select(rows, "measured", test="path", place=one.path)
        tracks = [[xyz(r) for r in own if r["cycle"] == str(k)] for k in (1, 2, 3)]
        each = []
        for place in select(rows, "commanded", test="path", place=one.path):
            normal = xyz(place, "direction_x direction_y direction_z")
            each.append(ap_rp_mm([crossing(track, xyz(place), normal) for track in tracks], xyz(place)))
        assert len(each) == one.points
        assert one.accuracy.value_mm == pytest.approx(max(at for at, _ in each), rel=1e-9, abs=1e-9)
        assert one.repeatability.value_mm == pytest.approx(max(rt for _, rt in each), rel=1e-9, abs=1e-9)


def test_the_result_says_which_file_and_its_hash(tested: tuple[Iso9283Result, Path]) -> None:
    result, folder = tested
    data = (folder / "iso9283-points.csv").read_bytes()
    assert (result.points_file, result.points_sha256) == ("iso9283-points.csv", hashlib.sha256(data).hexdigest())


def test_points_of_an_earlier_test_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programme, "_SEEDS", 4)
    with RunFile.create(tmp_path / "run", left_alone()) as run:
        (tmp_path / "run" / "iso9283-points.csv").write_text("kept", "utf-8")
        result = iso9283_run(run, asked(run, tests=["distance"], cycles=2, nominal=True), Work())
    assert result.points_file == "iso9283-points-2.csv"
    assert (tmp_path / "run" / "iso9283-points.csv").read_text("utf-8") == "kept"


def test_a_result_is_kept_where_its_points_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise InputError("iso9283-points.csv cannot be written: No space left on device")

    monkeypatch.setattr(programme, "_SEEDS", 4)
    monkeypatch.setattr(Outputs, "write", full)
    with RunFile.create(tmp_path / "run", left_alone()) as run:
        result = iso9283_run(run, asked(run, tests=["distance"], cycles=2, nominal=True), Work())
    assert result.points_file == ""
    assert "not kept: iso9283-points.csv cannot be written: No space left" in result.notes[-1]
    assert result.arms["left"].tests["nominal"].distance[0].accuracy.n == 2


# -- AP and RP of the orientation by ISO 9283, from a 6-D probe: from the points, against the truth --------------------

SIGMA = 5e-5
PROBE = {"rpy": [0.2, -0.1, 0.4], "sigma": SIGMA}


def test_orientation_is_measured_stored_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programme, "_SEEDS", 4)
    profile = one_arm()
    plant = sure(profile.plant).model_copy(update={"effects": {}, "repeatability": 1e-4})
    left = profile.arms["left"]
    smr = Smr.model_validate({**left.smr.model_dump(), "probe": PROBE})
    arms = {"left": left.model_copy(update={"smr": smr})}
    with RunFile.create(tmp_path / "run", profile.model_copy(update={"plant": plant, "arms": arms})) as run:
        request = VERB.asked({"folder": run.folder, "tests": ["pose"], "cycles": 6, "nominal": True})
        assert isinstance(request, Iso9283Request)
        result = iso9283_run(run, request, Work())
    poses = result.arms["left"].tests["nominal"].pose
    (line,) = (one for one in result.coverage if one.characteristic == "AP, RP of the orientation")
    assert (line.status, line.words) == ("in part", "6 of 30 cycles, nominal commands")
    assert not any(note.startswith("positions only") for note in result.notes)
    (table,) = (one for one in iso9283_tables(result) if one.title.startswith("Orientation accuracy"))
    assert len(table.rows) == len(poses) == 5
    with (tmp_path / "run" / result.points_file).open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["test"] == "pose"]
    for pose in poses:
        own = [row for row in rows if row["place"] == pose.pose]
        commanded, *attained = (
            Rotation.from_quat([float(row[f"quat_{axis}"]) for axis in "xyzw"])
            for row in sorted(own, key=lambda row: row["row"])
        )
        assert pose.orientation is not None
        off = np.array([(one * commanded.inv()).as_rotvec() for one in attained])
        assert np.linalg.norm(pose.orientation.accuracy_mrad) == pytest.approx(1e3 * np.linalg.norm(off.mean(axis=0)))
        # six joints that stop with 0.1 mrad each, beside the probe
        assert 0.1 < max(pose.orientation.repeatability_mrad) < 2.0
        assert pose.orientation.accuracy_expanded_mrad > 2e3 * SIGMA
        assert np.linalg.norm(pose.orientation.accuracy_mrad) < 5.0


def test_the_formulas_are_those_of_angles_about_the_base() -> None:
    rng = np.random.default_rng(1)
    base_M, commanded_M = Rotation.random(2, random_state=1).as_matrix()
    off_B = np.array([1e-3, -2e-3, 5e-4]) + 1e-4 * rng.standard_normal((30, 3))
    attained = Rotation.from_rotvec(off_B @ base_M.T) * Rotation.from_matrix(commanded_M)
    quaternions = list(np.roll(attained.as_quat(), 1, axis=1))
    found = sure(orientation_characteristics(quaternions, commanded_M, base_M, [4e-5] * 30))
    np.testing.assert_allclose(found.accuracy_mrad, 1e3 * off_B.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.repeatability_mrad, 3e3 * off_B.std(axis=0, ddof=1), rtol=1e-6)
    assert orientation_characteristics(quaternions[:1], commanded_M, base_M, [4e-5]) is None
