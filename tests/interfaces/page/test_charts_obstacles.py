"""Obstacles in maps: outlines where the profile puts them, directions that they block, and none that they do not."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from cellapp.cell.profile import load_profile
from cellapp.commands.plan.charts_obstacles import (
    cell_map_chart,
    outlined_obstacles,
    surface_points,
)
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Chart, Series
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import AnyObstacle
from cellapp.robot.model.nominal import pose_matrix
from tests.twin import PROFILES

READ: TypeAdapter[dict[str, AnyObstacle]] = TypeAdapter(dict[str, AnyObstacle])
PILLAR = {"shape": "cylinder", "radius": 0.08, "length": 2.4, "pose": {"position": [2.4, 0.9, 1.0]}}
HOME = np.radians([0.0, -90.0, 0.0, -90.0, 0.0, 0.0])


@functools.cache
def twin() -> Profile:
    return load_profile(PROFILES / "twin.yaml")


def with_obstacles(**obstacles: dict[str, Any]) -> Profile:
    return twin().model_copy(update={"obstacles": READ.validate_python(obstacles)})


def stops(count: int = 3) -> list[PlannedStop]:
    turned = [HOME + 0.6 * k * np.eye(6)[0] for k in range(count)]
    return [
        PlannedStop(configuration=k, measured=False, q={"left": tuple(q), "right": tuple(q)})
        for k, q in enumerate(turned)
    ]


def named(chart: Chart, name: str) -> Series | None:
    return next((one for one in chart.series if one.name == name), None)


def test_a_mesh_is_drawn_as_its_hull_and_a_missing_one_is_left_out(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1000.0, 2000.0, 3000.0)).export(tmp_path / "box.stl")
    mesh = {"shape": "mesh", "file": str(tmp_path / "box.stl"), "scale": 0.001}
    points = surface_points(READ.validate_python({"guard": mesh})["guard"])
    assert np.allclose(np.ptp(points, axis=0), (1.0, 2.0, 3.0))
    missing = with_obstacles(guard={**mesh, "file": "nowhere.stl"})
    assert named(cell_map_chart(missing, stops()), "obstacles") is None


def test_a_pillar_blocks_the_directions_behind_it() -> None:
    profile = with_obstacles(pillar=PILLAR)
    chart = cell_map_chart(profile, stops())
    shadow = named(chart, "blocked directions")
    assert shadow is not None
    assert "Beams are blocked by pillar from azimuth" in chart.message
    tracker = pose_matrix(profile.tracker.pose)[:2, 3] if profile.tracker.pose else np.zeros(2)
    ends = np.column_stack([shadow.x, shadow.y])[[0, 1]]
    away = np.linalg.norm(ends - tracker, axis=1)
    assert away[1] > away[0] == pytest.approx(1.58, abs=0.05), "from the pillar outwards"
    seen = named(cell_map_chart(profile, stops(), "tracker"), "obstacles")
    assert seen is not None
    low, high = (float(text) for text in chart.message.split("azimuth ")[1].split(" deg")[0].split(" to "))
    assert (np.nanmin(seen.x), np.nanmax(seen.x)) == pytest.approx((low, high), abs=0.51)


def test_what_is_mounted_on_a_flange_is_drawn_where_the_arm_stands_at_home() -> None:
    knob = {"shape": "sphere", "radius": 0.05, "fixed_to": "flange", "arm": "left"}
    profile = with_obstacles(knob=knob, foot={**knob, "fixed_to": "base"})
    found = {one.name: one.p_C.mean(axis=0) for one in outlined_obstacles(profile)}
    base = profile.arms["left"].base
    assert base is not None
    assert np.allclose(found["foot"], base.position, atol=0.01)
    assert 0.3 < np.linalg.norm(found["knob"] - found["foot"]) < 2.0
    assert "knob" not in cell_map_chart(profile, stops()).message, "what moves blocks no direction for all stops"
