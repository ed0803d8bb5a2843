"""The section ``obstacles``: what it refuses, with file, line and key, and its words for people."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.loader import profile_from_json, profile_to_json
from cellapp.commands.doctor.view import cell_words, constraint_words
from cellapp.ground.errors import InputError
from tests.twin import PROFILES

pytestmark = pytest.mark.fast


def written(folder: Path, *lines: str) -> Path:
    """The twin's profile with obstacles at its end."""
    text = (PROFILES / "twin.yaml").read_text("utf-8").replace("type: arms/", f"type: {PROFILES}/arms/")
    path = folder / "cell.yaml"
    path.write_text("\n".join([text, "obstacles:", *(f"  {line}" for line in lines), ""]), "utf-8")
    return path


ALL = (
    "table: {shape: box, size: [1.0, '500 mm', 0.04], pose: {position: [0.0, 0.0, -0.4]}}",
    "post: {shape: cylinder, radius: 0.1, length: 2.0, pose: {position: [-1.0, 0, 1], rpy: ['90 deg', 0, 0]}}",
    "lamp: {shape: sphere, radius: '50 mm', pose: {position: [0, 0, 2]}}",
    "hose: {shape: capsule, radius: 0.02, length: 0.1, fixed_to: flange, arm: right}",
    "plinth: {shape: box, size: [0.2, 0.2, 0.2], fixed_to: base, arm: left, pose: {position: [0, 0, -0.1]}}",
    "part: {shape: mesh, file: part.stl, scale: 0.001}",
)


def test_obstacles_are_read_and_kept_in_a_run(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(b"read by the gate, not here")
    profile = load_profile(written(tmp_path, *ALL))
    assert [one.shape for one in profile.obstacles.values()] == [
        "box", "cylinder", "sphere", "capsule", "box", "mesh"
    ]  # fmt: skip
    assert profile_from_json(profile_to_json(profile)) == profile
    words = dict(cell_words(profile))
    assert words["obstacle table"].startswith("box 1000 x 500 x 40 mm, in the cell: x 0.000, y 0.000, z -0.400 m")
    assert words["obstacle post"].startswith("cylinder of radius 100 mm, length 2000 mm, in the cell")
    assert "roll 90.0" in words["obstacle post"]
    assert words["obstacle hose"].startswith("capsule of radius 20 mm, length 100 mm, on the flange of arm right: ")
    assert words["obstacle plinth"].startswith("box 200 x 200 x 200 mm, on the base of arm left: ")
    assert words["obstacle lamp"].startswith("sphere of radius 50 mm, in the cell")
    assert words["obstacle part"].startswith(f"mesh {tmp_path / 'part.stl'}, scale 0.001, in the cell")
    assert "between arms, from 6 obstacles and from the floor" in dict(constraint_words(profile))["clearance"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("a: {shape: box, size: [1, 2]}", "a.size: expected 3 values, got a list of 2"),
        ("a: {shape: box, size: [1, 2, 0]}", "a.size[2]: expected more than 0, got 0"),
        ("a: {shape: sphere, radius: -0.1}", "a.radius: expected more than 0, got -0.1"),
        ("a: {shape: sphere, radius: .nan}", "a.radius: expected a finite number, got .nan"),
        ("a: {shape: sphere, radius: 250}", "a.radius: 250 m is beyond 100 m"),
        ("a: {shape: cone, radius: 1}", "a.shape: expected 'box', 'cylinder', 'capsule', 'sphere' or 'mesh'"),
        ("a: {radius: 1}", "a.shape: missing; it must be given"),
        ("a: {shape: sphere, radius: 1, colour: red}", "a.colour: unknown key; known here are fixed_to, arm"),
        ("a: {shape: cylinder, radius: 1, lenght: 1}", "a.lenght: unknown key; did you mean 'length'?"),
        ("a: {shape: sphere, radius: 1, arm: left}", "a.arm: must not be given for an obstacle that is fixed to"),
        ("a: {shape: sphere, radius: 1, fixed_to: base}", "a.arm: is missing for an obstacle that is fixed to"),
        ("a: {shape: sphere, radius: 1, fixed_to: base, arm: top}", "a.arm: unknown arm; arms are left, right"),
        ("a: {shape: sphere, radius: 1, fixed_to: roof, arm: left}", "a.fixed_to: expected 'cell', 'base' or 'flange'"),
        ("left: {shape: sphere, radius: 1}", "left: an obstacle needs a name of its own, other than those of the arms"),
        ("a: {shape: mesh, file: gone.stl}", "a.file: file not found: "),
        ("a: {shape: mesh}", "a.file: missing; it must be given"),
        ("a: 7", "a: expected keys with values, got 7"),
    ],
)  # fmt: skip
def test_bad_obstacles_are_named_with_their_line(line: str, words: str, tmp_path: Path) -> None:
    path = written(tmp_path, line)
    with pytest.raises(InputError) as caught:
        load_profile(path)
    number = len(path.read_text("utf-8").splitlines())
    assert f"cell.yaml:{number}: obstacles.{words}" in str(caught.value)


def test_the_same_name_twice_is_refused(tmp_path: Path) -> None:
    sphere = "a: {shape: sphere, radius: 0.1}"
    with pytest.raises(InputError, match=r"obstacles\.a: duplicate key \(first in line \d+\); keep one"):
        load_profile(written(tmp_path, sphere, sphere))
