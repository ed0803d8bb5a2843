"""Motions that the gate admits among obstacles of all shapes, checked by a library that the gate does not use."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, clear_stops, refuse_motion, refuse_stop, visible
from cellapp.cell.safety.shapes import load_mesh
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import MeshObstacle, Placement
from tests.approved import assert_refused
from tests.cell.safety.collision_check import CollisionCheck
from tests.cell.safety.test_gate import crowded, random_segments
from tests.sure import sure
from tests.twin import small_twin

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("fcl")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Meshes: a box off its origin, a ring, a ball with a hole in its surface, and files that are no meshes."""
    folder = tmp_path_factory.mktemp("meshes")
    box = trimesh.creation.box((400.0, 300.0, 200.0))
    box.apply_translation((100.0, 0.0, -50.0))
    box.export(folder / "box.stl")
    trimesh.creation.annulus(0.15, 0.25, 0.06, sections=24).export(folder / "ring.stl", file_type="stl_ascii")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    trimesh.Trimesh(ball.vertices, ball.faces[:-1]).export(folder / "open.stl")
    whole = (folder / "box.stl").read_bytes()
    (folder / "cut.stl").write_bytes(whole[:-70])
    (folder / "empty.stl").write_bytes(b"")
    (folder / "words.stl").write_bytes(
        b"solid x\nfacet normal 0 0 1\nouter loop\nvertex a b c\nendloop\nendfacet\nendsolid"
    )
    return folder


# -- meshes -----------------------------------------------------------------------------------------------------------


def test_meshes_are_as_far_as_the_other_library_says(folder: Path) -> None:
    coal = pytest.importorskip("coal")
    mesh, centre = load_mesh(str(folder / "ring.stl"), 1.0)
    theirs = coal.MeshLoader().load(str(folder / "ring.stl"), np.ones(3))
    start, end = random_segments(np.random.default_rng(5), 200)
    ours, compared = mesh.segment_distance(start, end), 0
    at = coal.Transform3s(np.eye(3), -centre)
    for a, b, gap in zip(start, end, ours, strict=True):
        length = float(np.linalg.norm(b - a))
        z = (b - a) / length if length else np.array([0.0, 0.0, 1.0])
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        capsule = coal.Transform3s(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (a + b))
        args = (theirs, at, coal.Capsule(1e-3, length), capsule, coal.DistanceRequest(), coal.DistanceResult())
        found = coal.distance(*args) + 1e-3
        if gap > 1e-3:  # the other library knows the surface, not the inside
            assert gap == pytest.approx(found, abs=2e-6)
            compared += 1
    assert compared > 150


def meshed(profile: Profile, file: Path, **keys: Any) -> Profile:
    part = MeshObstacle(shape="mesh", file=str(file), **keys)
    return profile.model_copy(update={"obstacles": {**profile.obstacles, "part": part}})


def test_bad_meshes_are_named_as_approved(folder: Path) -> None:
    assert_refused(
        Path(__file__).parent / "approved" / "meshes.txt",
        lambda name: cell_bodies(meshed(crowded(), folder / name)),
        folder,
    )


def test_without_the_library_a_mesh_is_refused_with_what_to_install(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fcl", None)
    with pytest.raises(InputError, match=r"obstacles\.part\.file: .*ring\.stl: .* pip install 'cellapp\[meshes\]'"):
        cell_bodies(meshed(crowded(), folder / "ring.stl", scale=0.5))


def test_a_mesh_in_the_beam_hides_the_smr(folder: Path) -> None:
    profile = crowded()
    q = np.random.default_rng(2).uniform(-math.pi, math.pi, (20_000, 6))
    seen = visible(cell_bodies(profile), "left", q)
    x, y, z = sure(profile.tracker.pose).position
    wall = Placement(position=(x - 1.0, y + 0.2, z))
    hidden = seen & ~visible(cell_bodies(meshed(profile, folder / "box.stl", scale=0.001, pose=wall)), "left", q)
    assert 5 < hidden.sum() < seen.sum()


# -- whole motions ----------------------------------------------------------------------------------------------------


def of_all_shapes(folder: Path) -> Profile:
    """The crowded twin with a mesh in the cell, one on a flange and one on a base."""
    ring, box = (f"shape: mesh, file: {folder}/{name}.stl" for name in ("ring", "box"))
    return crowded(f"""
ring: {{{ring}, pose: {{position: [0.45, -0.8, 0.8], rpy: [0.5, 0.3, 0.0]}}}}
tool: {{{box}, scale: 0.0003, fixed_to: flange, arm: right, pose: {{position: [0, 0, 0.09]}}}}
cabinet: {{{box}, scale: 0.001, fixed_to: base, arm: right, pose: {{position: [-0.5, 0.3, 0.3]}}}}
shelf: {{shape: box, fixed_to: base, arm: left, size: [0.3, 0.8, 0.05], pose: {{position: [-0.6, 0.0, 0.7]}}}}
drum: {{shape: cylinder, fixed_to: flange, arm: left, radius: 0.05, length: 0.12, pose: {{position: [0, 0, 0.1]}}}}
""")


Motion = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]


def sampled_motions(cell: CellBodies, homes: dict[str, np.ndarray], count: int, seed: int) -> list[Motion]:
    rng = np.random.default_rng(seed)
    stops = [{name: q + rng.uniform(-1.6, 1.6, len(q)) for name, q in homes.items()} for _ in range(2 * count)]
    return list(zip(stops[:count], stops[count:], strict=True))


def test_motions_that_the_gate_admits_collide_with_nothing(folder: Path) -> None:
    profile = of_all_shapes(folder)
    cell = cell_bodies(profile)
    motions = sampled_motions(cell, home_positions(profile), 120, 11)
    admitted = [motion for motion in motions if not refuse_motion(cell, *motion)]
    assert len(admitted) > 12
    check = CollisionCheck(profile)
    assert list(check.collisions(admitted)) == []
    # and it sees collisions: with all motions it names obstacles of every kind, and the arms
    found = list(check.collisions(motions, timings=1, samples=40))
    met = {name for _, *bodies in found for name in bodies}
    assert {"table", "ring", "drum", "gripper"} <= met


def test_arms_that_reach_for_each_other_are_seen_to_collide() -> None:
    profile = small_twin(plan={"floor": -5.0, "clearance": 0.0})
    cell, homes = cell_bodies(profile), home_positions(profile)
    turns = np.arange(-math.pi, math.pi, math.pi / 2)
    stops = [
        {"left": np.array([a, 0.0, *homes["left"][2:]]), "right": np.array([b, 0.0, *homes["right"][2:]])}
        for a in turns
        for b in turns
    ]
    found = list(CollisionCheck(profile).collisions([(q, q) for q in stops], samples=1))
    assert [motion for motion, *_ in found] == [k for k, q in enumerate(stops) if refuse_stop(cell, q)]
    assert [(first[:4], second[:5]) for _, first, second in found] == [("left", "right")]


def test_stops_that_the_gate_refuses_for_a_collision_collide(folder: Path) -> None:
    """Where no cover is involved, what the gate calls a collision is one, and what collides is refused."""
    profile = of_all_shapes(folder)
    standing = {name: one for name, one in profile.obstacles.items() if one.fixed_to != "flange"}
    profile = profile.model_copy(update={"obstacles": standing})
    cell = cell_bodies(profile)
    stops = [motion[0] for motion in sampled_motions(cell, home_positions(profile), 300, 2)]
    together = {name: np.array([stop[name] for stop in stops]) for name in stops[0]}
    refusals = [refuse_stop(cell, stop) for stop in stops]
    assert clear_stops(cell, together).tolist() == [not refusal for refusal in refusals]
    found = CollisionCheck(profile).collisions([(stop, stop) for stop in stops], timings=1, samples=1)
    collided = {motion for motion, *_ in found}
    said = {k for k, refusal in enumerate(refusals) if "collide" in refusal}
    assert len(said) > 20
    assert said <= collided
    assert collided <= {k for k, refusal in enumerate(refusals) if refusal}
