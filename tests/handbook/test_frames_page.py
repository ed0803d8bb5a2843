"""The chapter on frames: a drawing of each, drawn again alike, and the conversions that its text states."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cellapp.docs
from cellapp.cell.profile import load_profile
from cellapp.commands.docs.handbook import topic_text
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import nominal_geometry, parallel_rows, smr_positions
from cellapp.robot.kinematics.transforms import Array, rotation_x, rotation_z, transform
from cellapp.robot.model.nominal import nominal_arm
from tests.handbook.frame_figures import FIGURES, figure_svg
from tests.handbook.sketch import Sketch, arc, arrow, dot, label, line, sketch_svg
from tests.twin import PROFILES

DOCS = Path(cellapp.docs.__file__).parent
MOST_BYTES = 12_000


@pytest.fixture(scope="module")
def twin() -> Profile:
    return load_profile(PROFILES / "twin.yaml")


def test_the_chapter_shows_every_drawing_once_and_names_it() -> None:
    shown = re.findall(r"!\[([^\]]+)\]\(figures/([\w-]+)\.svg\)", topic_text("frames"))
    assert sorted(stem for _, stem in shown) == sorted(FIGURES)
    assert all(len(words) > 20 for words, _ in shown), "the terminal shows these words in the place of the drawing"


@pytest.mark.parametrize("stem", FIGURES)
def test_drawings_are_drawn_again_alike_for_light_and_dark_pages(stem: str, twin: Profile) -> None:
    kept = (DOCS / "figures" / f"{stem}.svg").read_text("utf-8")
    assert figure_svg(stem, twin) == kept, "draw them again: python -m tests.handbook"
    assert len(kept.encode()) < MOST_BYTES
    drawing = ElementTree.fromstring(kept)
    assert drawing.findtext("{*}title") == FIGURES[stem](twin).title
    assert "prefers-color-scheme:dark" in str(drawing.findtext("{*}style"))


@pytest.mark.parametrize("stem", FIGURES)
def test_nothing_lies_outside_of_a_drawing(stem: str, twin: Profile) -> None:
    drawing = ElementTree.fromstring(figure_svg(stem, twin))
    _, _, width, height = map(float, drawing.attrib["viewBox"].split())
    for path in drawing.findall("{*}path"):
        places = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path.attrib["d"]), dtype=np.float64)
        assert np.all((places > 0.0) & (places < [width, height]))
    for words in drawing.findall("{*}text"):
        half = 3.3 * len(str(words.text))  # half of the width of a letter of this size, generously
        left = {"start": 0.0, "middle": half, "end": 2.0 * half}[words.attrib["text-anchor"]]
        x, y = float(words.attrib["x"]), float(words.attrib["y"])
        assert x - left > -8.0, words.text
        assert x - left + 2.0 * half < width + 8.0, words.text
        assert 10.0 < y < height, words.text


def test_a_sketch_is_seen_from_where_it_says() -> None:
    marks = (line([0, 0, 0], [0, 1, 0]), dot([0, 0, 0.5]), arrow([1, 0, 0], [0, 0, 0]), label([0, 0, 0], "a < b"))
    svg = sketch_svg(Sketch("seen along -x", marks, 0.0, 0.0))
    assert 'd="M64.0 ' in svg, "y runs from the left rim"
    assert "L496.0 " in svg, "to the right one"
    assert "a &lt; b" in svg
    quarter = arc([0, 0, 0], [0, 0, 2], [1, 0, 0], np.pi / 2)
    np.testing.assert_allclose(quarter.points[[0, -1]], [[1, 0, 0], [0, 1, 0]], atol=1e-12)


def test_what_a_cell_lacks_for_its_drawings_is_said(twin: Profile) -> None:
    one = twin.model_copy(update={"arms": {"left": twin.arms["left"]}})
    with pytest.raises(InputError, match="needs two arms"):
        figure_svg("frame-pair", one)
    unplaced = twin.model_copy(update={"tracker": twin.tracker.model_copy(update={"pose": None})})
    with pytest.raises(InputError, match="needs the pose of the tracker"):
        figure_svg("frame-cell", unplaced)
    floating = twin.arms["left"].model_copy(update={"base": None})
    with pytest.raises(InputError, match="pose of every base"):
        figure_svg("frame-cell", twin.model_copy(update={"arms": {"left": floating}}))


def test_a_ur_has_hayati_angles_in_rows_2_and_3(twin: Profile) -> None:
    assert parallel_rows(nominal_arm(twin.arms["left"])) == (1, 2)


@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(2, 7))
def test_a_modified_table_is_converted_as_the_chapter_says(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    modified = rng.uniform(-1.0, 1.0, (joints, 4))  # theta, d, a, alpha; a and alpha before the joint
    q, tool = rng.uniform(-3.0, 3.0, joints), rng.uniform(-0.2, 0.2, 3)
    standard = modified.copy()
    standard[:-1, 2:], standard[-1, 2:] = modified[1:, 2:], 0.0
    base = _about_x(modified[0])
    place = base
    for number, (theta, d, _, _) in enumerate(modified):
        place = place if number == 0 else place @ _about_x(modified[number])
        place = place @ transform(rotation_z(q[number] + theta), [0.0, 0.0, d])
    ours = nominal_geometry(standard, tool, base)
    np.testing.assert_allclose(smr_positions(ours, q[None])[0], place[:3, :3] @ tool + place[:3, 3], atol=1e-12)


def _about_x(row: Array) -> Array:
    """``rot_x(alpha) trans(a, 0, 0)`` of a modified row."""
    return transform(rotation_x(row[3]), [row[2], 0.0, 0.0])
