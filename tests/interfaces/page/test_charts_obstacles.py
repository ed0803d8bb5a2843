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
    blocked_directions,
    cell_map_chart,
    outlined_obstacles,
    seen_from,
    surface_points,
)
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Chart, Series
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import AnyObstacle
from cellapp.robot.model.nominal import pose_matrix
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

READ: TypeAdapter[dict[str, AnyObstacle]] = TypeAdapter(dict[str, AnyObstacle])
PILLAR = {"shape": "cylinder", "radius": 0.08, "length": 2.4, "pose": {"position": [2.4, 0.9, 1.0]}}
TABLE = {"shape": "box", "size": [1.2, 0.8, 0.05], "pose": {"position": [1.6, 0.0, -2.0]}}
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


@pytest.mark.parametrize(
    ("obstacle", "extent"),
    [
        ({"shape": "box", "size": [1.0, 2.0, 3.0]}, (1.0, 2.0, 3.0)),
        ({"shape": "cylinder", "radius": 0.5, "length": 3.0}, (1.0, 1.0, 3.0)),
        ({"shape": "capsule", "radius": 0.5, "length": 3.0}, (1.0, 1.0, 4.0)),
        ({"shape": "sphere", "radius": 0.5}, (1.0, 1.0, 1.0)),
    ],
)
def test_points_span_the_shape(obstacle: dict[str, Any], extent: tuple[float, float, float]) -> None:
    points = surface_points(READ.validate_python({"one": obstacle})["one"])
    assert np.allclose(points.max(axis=0) - points.min(axis=0), extent)
    assert np.allclose(points.mean(axis=0), 0.0, atol=0.05)


def test_a_mesh_is_drawn_as_its_hull_and_a_missing_one_is_left_out(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1000.0, 2000.0, 3000.0)).export(tmp_path / "box.stl")
    mesh = {"shape": "mesh", "file": str(tmp_path / "box.stl"), "scale": 0.001}
    points = surface_points(READ.validate_python({"guard": mesh})["guard"])
    assert np.allclose(np.ptp(points, axis=0), (1.0, 2.0, 3.0))
    missing = with_obstacles(guard={**mesh, "file": "nowhere.stl"})
    assert named(cell_map_chart(missing, stops()), "obstacles") is None


def test_an_outline_stands_where_the_profile_says() -> None:
    chart = cell_map_chart(with_obstacles(table=TABLE), stops())
    drawn = named(chart, "obstacles")
    assert drawn is not None
    assert (np.nanmin(drawn.x), np.nanmax(drawn.x)) == pytest.approx((1.0, 2.2), abs=1e-6)
    assert (np.nanmin(drawn.y), np.nanmax(drawn.y)) == pytest.approx((-0.4, 0.4), abs=1e-6)
    assert "blocked" not in chart.message, "the table is below all beams"


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


def test_rays_lead_from_the_tracker_to_the_outermost_stops() -> None:
    rays = named(cell_map_chart(twin(), stops()), "outermost rays")
    assert rays is not None
    assert np.isnan(rays.x).sum() == len(twin().arms)
    assert named(cell_map_chart(twin(), []), "outermost rays") is None


def test_what_is_mounted_on_a_flange_is_drawn_where_the_arm_stands_at_home() -> None:
    knob = {"shape": "sphere", "radius": 0.05, "fixed_to": "flange", "arm": "left"}
    profile = with_obstacles(knob=knob, foot={**knob, "fixed_to": "base"})
    found = {one.name: one.p_C.mean(axis=0) for one in outlined_obstacles(profile)}
    base = profile.arms["left"].base
    assert base is not None
    assert np.allclose(found["foot"], base.position, atol=0.01)
    assert 0.3 < np.linalg.norm(found["knob"] - found["foot"]) < 2.0
    assert "knob" not in cell_map_chart(profile, stops()).message, "what moves blocks no direction for all stops"


def test_a_body_behind_the_tracker_is_in_one_piece() -> None:
    around = np.array([[-2.0, -0.2, 0.0], [-2.0, 0.2, 0.0]])
    azimuth = seen_from(around, np.eye(4), "tracker")[:, 0]
    assert np.ptp(azimuth) < 20.0
    assert blocked_directions([], np.eye(4), around) == []
