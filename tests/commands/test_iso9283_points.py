"""Another program computes every figure of a test again from the file of raw points: here with its own formulas."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path
from statistics import fmean, stdev

import pytest

from cellapp.cell.driving.iso9283 import programme
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283.run import iso9283_run
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import Outputs
from tests.commands.test_iso9283 import asked, left_alone
from tests.estimation.iso9283.test_driving import only_paths

Point = tuple[float, float, float]
Rows = list[dict[str, str]]


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Iso9283Result, Path]]:
    folder = tmp_path_factory.mktemp("iso") / "run"
    with pytest.MonkeyPatch.context() as patch, RunFile.create(folder, left_alone()) as run:
        patch.setattr(programme, "_SEEDS", 4)
        only_paths(patch, "line")
        tests = ["pose", "multidirectional", "distance", "drift", "path"]
        yield iso9283_run(run, asked(run, tests=tests, cycles=3, drift_minutes=0.5)), folder


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
    drift = left(tested).drift
    assert drift is not None
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
    assert best is not None
    return best


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
        result = iso9283_run(run, asked(run, tests=["distance"], cycles=2))
    assert result.points_file == "iso9283-points-2.csv"
    assert (tmp_path / "run" / "iso9283-points.csv").read_text("utf-8") == "kept"


def test_a_result_is_kept_where_its_points_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise InputError("iso9283-points.csv cannot be written: No space left on device")

    monkeypatch.setattr(programme, "_SEEDS", 4)
    monkeypatch.setattr(Outputs, "write", full)
    with RunFile.create(tmp_path / "run", left_alone()) as run:
        result = iso9283_run(run, asked(run, tests=["distance"], cycles=2))
    assert result.points_file == ""
    assert "not kept: iso9283-points.csv cannot be written: No space left" in result.notes[-1]
    assert result.arms["left"].tests["nominal"].distance[0].accuracy.n == 2
