"""From readings of a real Panda in sockets to a calibration, a discovery and a page; touches between tracker visits."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.csv_text import write_csv
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import calibration_tables
from cellapp.commands.check.run import check_by_touches
from cellapp.commands.discover.run import discover_run
from cellapp.commands.import_.run import import_new_run
from cellapp.commands.report.run import report_run
from cellapp.ground.errors import InputError
from cellapp.interfaces.page import write_page
from drivers.plant import Plant
from drivers.plant.changes import zero_shifted
from drivers.plant.sockets import touches

TESTS = Path(__file__).parents[1]
DATA = TESTS / "fixtures" / "panda-sockets"
PROFILE = TESTS.parent / "profiles" / "panda-sockets.yaml"
REACHED_MM = {"nominal": 8.3, "geometry": 0.75, "effects": 0.43}
"""What plain least squares reach on this arm, mean at the held-out placement."""


@pytest.fixture(scope="module")
def panda_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a real arm, calibrated and searched. No test may write to it."""
    folder = tmp_path_factory.mktemp("panda") / "run"
    result = import_new_run(load_profile(PROFILE), DATA / "readings.csv", folder, distances=DATA / "distances.csv")
    assert result.readings == {"left": 182}
    with RunFile.open(folder, write=True) as run:
        calibrate_run(run)
        discover_run(run)
    return folder


def test_a_real_arm_reaches_what_least_squares_reach(panda_run: Path) -> None:
    with RunFile.open(panda_run) as run:
        calibrated = json.loads(run.stage_rows()[0].text)["arms"]["left"]
        found = json.loads(run.stage_rows()[1].text)["arms"]["left"]
    stages = {**calibrated["validate"], **found["validate"]}
    for stage, most in REACHED_MM.items():
        assert stages[stage]["position_mm"]["mean"] < most
        assert stages[stage]["position_mm"]["n"] == 60
        assert stages[stage]["gauge_mm"]["n"] == 1
    assert stages["geometry"]["gauge_mm"]["mean"] < 0.3
    assert "distance_mm" not in stages["geometry"]
    assert [one["effect"] for one in found["accepted"]] == ["joint_compliance"]
    assert found["heldout_position_mm"]["after"]["mean"] == pytest.approx(stages["effects"]["position_mm"]["mean"])
    assert found["accepted"][0]["posterior"] > 0.1
    assert calibrated["scatter"]["value"] == pytest.approx(2.8e-4, rel=0.2)


def test_known_distances_have_a_table_and_notes_say_what_is_not_seen(tmp_path: Path) -> None:
    import_new_run(load_profile(PROFILE), DATA / "readings.csv", tmp_path / "run", distances=DATA / "distances.csv")
    with RunFile.open(tmp_path / "run", write=True) as run:
        result = calibrate_run(run)
    assert "Arm left: errors of known distances, held out [mm]" in [table.title for table in calibration_tables(result)]
    said = "\n".join(result.notes)
    assert "sockets do not show where the base stands" in said
    assert "hide the scale beyond that" in said


def test_the_page_is_made(panda_run: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(panda_run, tmp_path / "run"))
    with RunFile.open(folder, write=True) as run:
        report_run(run, write_page)
    page = (folder / "report.html").read_text("utf-8")
    assert "errors of known distances" in page
    assert "nan" not in page.lower().split("<script")[0].split()


def touches_csv(path: Path, plant: Plant, home: np.ndarray, *, seed: int, each: int = 10) -> Path:
    """Touches of one socket by the left arm of the twin, led by hand."""
    rng = np.random.default_rng(seed)
    point = plant.smr_positions("left", home[None])[0]
    q = touches(plant, "left", point, home + rng.uniform(-0.9, 0.9, (3 * each, 6)), seating_m=1e-5, rng=rng)[:each]
    assert len(q) == each
    header = ["configuration", "arm", *(f"q{joint}" for joint in range(1, 7)), "point"]
    write_csv(path, header, [[str(n), "left", *map(repr, row.tolist()), "nest 1"] for n, row in enumerate(q)])
    return path


def test_ten_touches_between_tracker_visits_find_and_name_a_changed_joint(finished_copy: Path, tmp_path: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        plant = build_plant(run.profile)
        home = np.array([0.2, -1.7, 0.9, -1.3, 0.4, 0.2])
        before = check_by_touches(run, touches_csv(tmp_path / "before.csv", plant, home, seed=1))
        assert before.verdict in ("valid", "cannot say")
        assert not before.changes
        assert len(before.stops) == 10
        assert any("touches of these sockets cannot show" in note for note in before.notes)
        plant.change_mechanism("left", lambda mechanism: zero_shifted(mechanism, 2, 5e-4))
        after = check_by_touches(run, touches_csv(tmp_path / "after.csv", plant, home, seed=2))
        assert after.verdict == "arm changed"
        assert after.changes[0].what == "zero of joint 3"
        assert after.changes[0].value == pytest.approx(5e-4, abs=2e-4)


def test_touches_check_an_arm_that_was_calibrated_from_sockets(panda_run: Path, tmp_path: Path) -> None:
    with RunFile.open(Path(shutil.copytree(panda_run, tmp_path / "run")), write=True) as run:
        readings = run.readings("left")
        rows = np.flatnonzero(np.array(readings.point) == "right_0")[:10]
        header = ["configuration", "arm", *(f"q{joint}" for joint in range(1, 8)), "point"]
        for name, shift in (("before", 0.0), ("after", 0.01)):  # the joint's encoder slipped
            q = readings.q[rows] + shift * np.eye(7)[3]
            cells = [[str(n), "left", *map(repr, row.tolist()), "right_0"] for n, row in enumerate(q)]
            write_csv(tmp_path / f"{name}.csv", header, cells)
        assert not check_by_touches(run, tmp_path / "before.csv").changes
        found = check_by_touches(run, tmp_path / "after.csv")
    assert found.verdict == "arm changed"
    assert found.changes[0].what == "zero of joint 4"
    assert found.changes[0].value == pytest.approx(-0.01, abs=0.002)


def test_an_earlier_calibration_as_prior_is_refused_for_sockets(panda_run: Path, tmp_path: Path) -> None:
    with (
        RunFile.open(Path(shutil.copytree(panda_run, tmp_path / "run")), write=True) as run,
        pytest.raises(InputError, match="needs measured points"),
    ):
        calibrate_run(run, prior=panda_run)


def test_a_file_of_measured_points_is_no_file_of_touches(finished_copy: Path, tmp_path: Path) -> None:
    header = ["configuration", "arm", *(f"q{joint}" for joint in range(1, 7)), "x_m", "y_m", "z_m"]
    write_csv(tmp_path / "points.csv", header, [[str(n), "left", *["0.1"] * 6, "1", "2", "0"] for n in range(5)])
    with RunFile.open(finished_copy, write=True) as run, pytest.raises(InputError, match="needs points"):
        check_by_touches(run, tmp_path / "points.csv")
