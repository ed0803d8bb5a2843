"""Paths followed by the simulated cell: what is measured there judges the joint paths."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving import tracked_path
from cellapp.cell.driving.tracked_path import MOST_RUNS
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.path_file import PathSpec
from cellapp.cell.targets.path_records import PathResult
from cellapp.commands.follow.request import VERB as FOLLOW
from cellapp.commands.follow.run import follow_run
from cellapp.commands.follow.view import path_sentences, path_tables
from cellapp.commands.report.result import read_results
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.progress import Cancelled, Progress
from drivers.arms.simulated import SimulatedArm
from drivers.trackers.simulated import SimulatedTracker
from tests.crossed_beam import crossed_beam
from tests.twin import plant_of


def spec(**changes: Any) -> PathSpec:
    """A quarter of a circle of the right arm, whose joints have backlash, and a line back."""
    poses = [
        {"position": [0.20, 0.50, 0.45], "rpy": ["-90 deg", 0, 0]},
        {"position": [0.30, 0.50, 0.55], "via": [0.2293, 0.50, 0.5207]},
        {"position": [0.22, 0.50, 0.45]},
    ]
    content = {"name": "arc", "arm": "right", "tolerance": "0.1 mm", "speed": "100 mm/s", "poses": poses}
    return PathSpec.model_validate({**content, **changes})


OUT_OF_REACH = spec(name="far", poses=[spec().poses[0], {"position": [0.2, 3.0, 0.45]}])


def test_planning_moves_nothing_and_is_stored(run: RunFile, cells: list[Any], tmp_path: Path) -> None:
    result = follow_run(run, [spec(), OUT_OF_REACH], csv=tmp_path / "q.csv")
    assert cells == []
    assert read_results(run).path == result
    assert PathResult.from_json(result.to_json(), "test") == result
    near, far = result.paths
    assert near.refusal == ""
    assert near.driven is None
    assert near.deviation_mm is not None
    assert near.deviation_mm < 0.01
    assert {one.joint for one in near.reversals} <= {1, 2, 3}  # the joints with play
    assert "out of reach" in far.refusal
    assert result.complaints() == [f"path far refused {far.refusal}"]
    with (tmp_path / "q.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == near.samples
    assert {row["path"] for row in rows} == {"arc"}
    assert float(rows[1]["time_s"]) == 0.008


def test_a_followed_path_is_as_good_as_one_measured_at_rest(run: RunFile, cells: list[Any]) -> None:
    heard: list[Progress] = []
    result = follow_run(run, [spec()], heard.append, driving="verify")
    (driven,) = [path.driven for path in result.paths]
    assert driven is not None
    assert (driven.note, driven.judged, driven.verdict) == ("", "moving", "in")
    assert driven.moving is not None
    assert driven.at_rest is not None
    assert driven.nominal is not None
    assert driven.moving.mean <= 1.5 * driven.at_rest.mean
    assert driven.nominal.mean > 40.0 * driven.moving.mean
    assert driven.lag is not None
    assert 25.0 < driven.lag.delay_ms < 45.0
    assert driven.lag.cut_mm < 0.1
    (cell,) = cells
    clearance = plant_of(cell).clearance
    assert clearance is not None
    assert min(clearance.arms_m, clearance.floor_m) > 0.0
    for name, home in home_positions(run.profile).items():
        np.testing.assert_array_equal(plant_of(cell).q(name), home)
    assert heard[-1].job == "follow"
    in_time = driven.in_time
    assert in_time is not None
    # the encoders' delay, and the way of the stamps: the quickest packet
    assert -1.0 < in_time.delay_ms - driven.lag.delay_ms < 45.0
    assert in_time.mean_mm_s is not None
    assert in_time.expanded_mm_s is not None
    assert in_time.speed_mm_s == 100.0
    assert abs(in_time.mean_mm_s - 100.0) < in_time.expanded_mm_s + 0.5
    assert [table.title for table in path_tables(result)][-2:] == [
        "Distance of measured points from the path",
        "In time: delay, which is taken out, and speed",
    ]
    assert any("ms late" in line for line in path_sentences(result))
    assert result.complaints() == []
    planned = follow_run(run, [spec()])
    stored = read_results(run)
    assert (stored.path, stored.follow) == (planned, result)


def test_a_rehearsed_path_cuts_bends_less(run: RunFile) -> None:
    plain = follow_run(run, [spec()], driving="drive").paths[0]
    again = follow_run(run, [spec()], driving="drive", rehearse=True).paths[0]
    assert plain.driven is not None
    assert again.driven is not None
    assert plain.driven.lag is not None
    assert again.driven.lag is not None
    assert (plain.driven.rehearsed, again.driven.rehearsed) == (False, True)
    assert again.driven.lag.cut_mm < 0.6 * plain.driven.lag.cut_mm
    with pytest.raises(InputError, match="a rehearsal moves the arms"):
        FOLLOW.asked({"folder": run.folder, "path": "paths.yaml", "rehearse": True})


def test_without_its_plays_the_path_would_be_worse(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.robot.paths.joint_path._approach", lambda s, turns, crossings: np.zeros((len(s), 6)))
    (path,) = follow_run(run, [spec()], driving="verify").paths
    assert path.driven is not None
    assert path.driven.moving is not None
    assert path.driven.moving.mean > 0.04


EVENTS: dict[str, tuple[Callable[[SimulatedArm, SimulatedTracker], None], str]] = {
    "beam": (lambda arm, tracker: tracker.covered.add("right"), "the beam broke .* its SMR is not found again"),
    "protective stop": (lambda arm, tracker: arm.protective_stop(), "protective stop"),
    "emergency stop": (lambda arm, tracker: arm.emergency_stop(), "emergency stop"),
    "lost link": (lambda arm, tracker: arm.cut_link(), "link is cut"),
}


@pytest.mark.parametrize("event", EVENTS, ids=EVENTS)
def test_an_event_in_mid_path_stops_all_arms(
    event: str, run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    happen, words = EVENTS[event]
    start = SimulatedArm.start_path
    braked: list[str] = []

    def started(arm: SimulatedArm, q: Any, period_s: float) -> None:
        plant = plant_of(cells[0])
        plant.schedule.at(plant.clock_s + 1.0, lambda: happen(arm, cells[0].tracker))
        start(arm, q, period_s)

    brake = SimulatedArm.brake

    def noted(arm: SimulatedArm) -> None:
        braked.append(arm.name)
        brake(arm)

    monkeypatch.setattr(SimulatedArm, "start_path", started)
    monkeypatch.setattr(SimulatedArm, "brake", noted)
    with pytest.raises(HardwareError, match=words):
        follow_run(run, [spec()], driving="verify")
    assert set(braked) == {"left", "right"}
    plant = plant_of(cells[0])
    plant.advance(1.0)  # after a lost link it is not watched until it rests
    assert not any(plant.moving(name) for name in ("left", "right"))


def test_a_path_on_which_the_beam_broke_is_driven_again(
    run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    crossed = crossed_beam(monkeypatch, cells, "right", 1.0, times=2)
    result = follow_run(run, [spec()], driving="verify")
    (driven,) = [path.driven for path in result.paths]
    assert len(crossed) == 2
    assert driven is not None
    assert (driven.lost_beams, driven.note, driven.judged, driven.verdict) == (2, "", "moving", "in")
    assert driven.moving is not None
    assert driven.moving.max < 0.3, "no point is one of a path that was not ended"
    assert "path arc: the beam broke 2 times: the arm came to rest on its path" in " ".join(path_sentences(result))
    assert PathResult.from_json(result.to_json(), "test") == result
    for name, home in home_positions(run.profile).items():
        np.testing.assert_array_equal(plant_of(cells[0]).q(name), home)


def test_a_beam_that_breaks_each_time_leaves_the_path_unmeasured(
    run: RunFile, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    crossed = crossed_beam(monkeypatch, cells, "right", 1.0, times=99)
    result = follow_run(run, [spec()], driving="verify")
    assert len(crossed) == MOST_RUNS
    assert result.paths[0].driven is not None
    assert (result.paths[0].driven.moving, result.paths[0].driven.verdict) == (None, "")
    assert "the beam broke each of the 4 times" in result.complaints()[0]
    plant = plant_of(cells[0])
    assert not any(plant.moving(name) for name in ("left", "right"))


def test_a_person_ends_it(run: RunFile) -> None:
    control = JobControl()

    def at_path(event: Progress) -> None:
        if event.job == "follow":
            control.cancel()

    with pytest.raises(Cancelled):
        follow_run(run, [spec()], at_path, control, driving="drive")


def test_a_path_that_cannot_be_driven_is_not_driven(run: RunFile, cells: list[Any]) -> None:
    with pytest.raises(InputError, match=r"none of the paths can be driven: .*out of reach"):
        follow_run(run, [OUT_OF_REACH], driving="drive")
    assert cells == []


def test_a_tracker_that_cannot_follow_measures_at_rest(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracked_path, "stream_of", lambda tracker: None)
    (path,) = follow_run(run, [spec()], driving="verify").paths
    assert path.driven is not None
    assert (path.driven.moving, path.driven.judged, path.driven.verdict) == (None, "at rest", "cannot say")
    assert path.driven.at_rest is not None
    assert path.driven.at_rest.p95 is not None
    assert path.driven.expanded_mm is not None
    assert path.driven.at_rest.p95 < path.tolerance_mm < path.driven.at_rest.p95 + path.driven.expanded_mm
    assert any("ISO 14253-1" in line for line in path_sentences(PathResult(paths=(path,))))
    assert "verified at rest" in path.driven.note
