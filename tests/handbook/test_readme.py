"""README and handbook as texts: length of the README, links and their anchors, every chapter listed."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

import cellapp.docs
from cellapp.cell.profile import load_profile
from cellapp.commands.docs.handbook import CHAPTERS, PARTS, chapter_text, effect_sections, topic_text, topics
from cellapp.ground.errors import InputError
from cellapp.ground.profile.sections import Obstacle
from cellapp.robot.effects import EFFECTS
from tests.evidence import more_readings
from tests.handbook import frame_figures, planning_figures
from tests.handbook.chart import Chart, Series, chart_svg, shown
from tests.handbook.declarations import with_declarations
from tests.handbook.effect_figures import FIGURES, figure_svg
from tests.handbook.figure_files import write_figures
from tests.handbook.scene import Scene, joint_offset, smr_shift
from tests.program import app

README = Path(__file__).parents[2] / "README.md"
DOCS = Path(cellapp.docs.__file__).parent
TEXTS = {"README": README, **{chapter: DOCS / f"{chapter}.md" for chapter in CHAPTERS}}
MOST_LINES = 150
LINK = re.compile(r"!?\[[^\]]+\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Anchors of the headings of a Markdown file, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", path.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_readme_is_short() -> None:
    assert len(README.read_text("utf-8").splitlines()) <= MOST_LINES


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_to_files_and_headings_that_exist(name: str) -> None:
    path = TEXTS[name]
    for link in LINK.findall(CODE.sub("", path.read_text("utf-8"))):
        if link.startswith(("https://", "http://")):
            continue
        file, _, anchor = link.partition("#")
        target = path.parent / file if file else path
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


def test_the_readme_leads_to_every_chapter_by_parts() -> None:
    listed = re.findall(r"^\| \[(\w+)\]\(cellapp/docs/\1\.md\) \| (.+) \|$", README.read_text("utf-8"), re.MULTILINE)
    assert listed == list(CHAPTERS.items()), "the README's tables 'Read on' are those of the handbook's parts"
    parts = re.findall(r"^\| ([a-z ]+) \| \|$", README.read_text("utf-8"), re.MULTILINE)
    assert parts == list(PARTS)


# -- The glossary: in the order of the alphabet, short, each term with a chapter that says more ------------------------


def test_terms_stand_in_order_are_short_and_lead_to_a_chapter() -> None:
    entries = topic_text("glossary").strip().split("\n\n")[2:]
    terms = [re.match(r"\*\*(.+?)\*\*: ", entry) for entry in entries]
    names = [term[1].lower() for term in terms if term is not None]
    assert len(names) == len(entries) > 60
    assert names == sorted(names)
    for entry in entries:
        assert re.search(r"\]\(\w+\.md", entry), entry
        assert len(re.sub(r"\]\([^)]+\)", "]", entry)) < 260, entry


# -- Times of the handbook come with their computer, or as a ratio -----------------------------------------------------

_README = Path(__file__).parents[2] / "README.md"
_TAKES = re.compile(r"\b(?:takes?|took) (?:some |about )?[\d.]+ (?:m?s|min)\b[^.;|]*")
_KNOWN = ("figures", "AMD EPYC", "times", "of the cell", "simulated twin")
"""What tells where a time is from."""


@pytest.mark.parametrize("name", ["README", "tutorial", "check", "cell"])
def test_no_time_of_the_program_stands_alone(name: str) -> None:
    text = _README.read_text("utf-8") if name == "README" else chapter_text(name)
    text = " ".join(re.sub(r"(?s)```.*?```", "", text).split())
    alone = [words for words in _TAKES.findall(text) if not any(known in words for known in _KNOWN)]
    assert alone == []


# -- The handbook: a section and a figure for every effect, figures that are drawn again alike, the command ------------

ROOT = Path(__file__).parents[2]
TWIN = ROOT / "profiles" / "twin.yaml"
MOST_BYTES = 45_000
DRAWN = {*EFFECTS, planning_figures.FIGURE, more_readings.FIGURE, *frame_figures.FIGURES}
"""Stems of the figures that one command draws."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of(load_profile(TWIN))


def test_every_effect_has_a_section_and_a_figure() -> None:
    assert set(effect_sections()) == set(EFFECTS)
    assert set(FIGURES) == set(EFFECTS)
    drawn = {path.stem for path in (DOCS / "figures").iterdir()}
    assert {stem for stem in drawn if not stem.startswith(("screen-", "page-"))} == DRAWN


@pytest.mark.parametrize("slug", EFFECTS)
def test_a_section_says_what_it_is_what_imitates_it_and_what_to_do(slug: str) -> None:
    section = effect_sections()[slug]
    assert f"(figures/{slug}.svg)" in section
    for part in ("```\n", "**Visible share.**", "**Usual size**", "**Check or mend**", "**What settles it**"):
        assert section.count(part) >= 1, part
    assert all(form.words in " ".join(section.split()) for form in EFFECTS[slug].forms)
    for rival in EFFECTS[slug].look_alikes:
        assert f"[{rival}](#{rival})" in section


def test_what_the_handbook_repeats_of_declarations_is_up_to_date() -> None:
    text = chapter_text("effects")
    assert with_declarations(text) == text, "renew them: python -m tests.handbook"
    assert text.count("<!-- declared: ") == len(EFFECTS)
    assert "<!--" not in topic_text("effects") + topic_text("backlash"), "people need not see the markers"


def test_people_need_not_see_how_tests_run_an_example() -> None:
    assert "\n```sh dev\n" in chapter_text("report")
    assert "```sh dev" not in topic_text("report")
    assert chapter_text("report").count("\n```sh") == topic_text("report").count("\n```sh\n")


@pytest.mark.parametrize("slug", FIGURES)
def test_figures_are_drawn_again_alike_and_are_small(slug: str, scene: Scene) -> None:
    kept = (DOCS / "figures" / f"{slug}.svg").read_text("utf-8")
    assert shown(figure_svg(slug, scene)) == shown(kept), "draw them again: python -m tests.handbook"
    words, drawn = shown(kept)
    assert len(drawn) >= len(FIGURES[slug](scene).series)
    assert FIGURES[slug](scene).y_label in words
    assert len(kept.encode()) < MOST_BYTES
    drawing = ElementTree.fromstring(kept)
    assert drawing.findtext("{*}title")


@pytest.mark.parametrize("slug", FIGURES)
def test_figures_show_an_effect(slug: str, scene: Scene) -> None:
    chart = FIGURES[slug](scene)
    for series in chart.series:
        assert np.isfinite(series.x).all()
        assert np.isfinite(series.y).all()
        assert len(series.x) == len(series.y)
    assert 2.0 < max(float(np.abs(series.y).max()) for series in chart.series) < 5000.0  # um or urad


def test_the_figure_of_obstacles_is_drawn_from_the_example_of_its_chapter() -> None:
    kept = (DOCS / "figures" / f"{planning_figures.FIGURE}.svg").read_text("utf-8")
    twin = load_profile(TWIN)
    assert shown(planning_figures.figure_svg(twin)) == shown(kept), "draw it again: python -m tests.handbook"
    assert {one.shape for one in planning_figures.example_obstacles().values()} == {
        get_args(kind.model_fields["shape"].annotation)[0] for kind in Obstacle.__subclasses__()
    } - {"mesh"}
    outlines, shadows, stands = planning_figures.obstacles_chart(twin).series
    assert np.isnan(outlines.x).sum() == len(planning_figures.example_obstacles())
    assert np.isnan(shadows.x).sum() == 4, "two edges of the shadows of pillar and lamp"
    assert len(stands.x) == 1 + len(twin.arms)
    other = twin.model_copy(update={"arms": {"one": twin.arms["left"]}})
    with pytest.raises(InputError, match="needs arms named left, right"):
        planning_figures.figure_svg(other)


def test_a_chart_places_its_values_and_escapes_its_words() -> None:
    chart = Chart("a < b", "x [m]", "y", (Series("one & two", np.array([0.0, 10.0]), np.array([0.0, 5.0])),))
    text = chart_svg(chart)
    assert "<title>a &lt; b</title>" in text
    assert "one &amp; two" in text
    words, drawn = shown(text)
    assert "one & two" in words
    (x, y, far, high) = map(float, re.findall(r"[-0-9.]+", drawn[0]))
    assert (x, far) == (50.4, 391.1), "from the left end of the axes to the right one"
    assert 26.5 < high < y < 192.4


def test_a_parameter_that_a_law_does_not_have_is_refused(scene: Scene) -> None:
    context, law = scene.context(scene.stretched(2)), EFFECTS["backlash"].law("constant")
    with pytest.raises(ValueError, match="effect backlash: 0 of the parameters half_play9 are joint offsets"):
        joint_offset(context, "backlash", law, {"half_play9": 1.0})
    with pytest.raises(ValueError, match="shift the SMR"):
        smr_shift(context, "backlash", law, {"half_play1": 1.0})


# -- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_chapters_and_sections_and_lists_the_topics() -> None:
    runner = CliRunner()
    assert runner.invoke(app, ["docs", "discovery"]).output.startswith("# How discovery decides")
    assert runner.invoke(app, ["docs", "figures"]).output.startswith("# Figures")
    section = runner.invoke(app, ["docs", "backlash"]).output
    assert section.startswith("## backlash\n")
    assert "## friction_windup" not in section
    listed = runner.invoke(app, ["docs"]).output
    assert all(topic in listed for topic in topics())
    found = json.loads(runner.invoke(app, ["docs", "backlash", "--json", "-"]).stdout)
    assert (found["schema"], found["topic"]) == ("cellapp-docs", "backlash")


def test_all_figures_are_drawn(tmp_path: Path) -> None:
    assert {path.stem for path in write_figures(load_profile(TWIN), tmp_path / "new")} == DRAWN


def test_wrong_use_is_said_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"'sorcery' is not a topic; topics are {', '.join(CHAPTERS)}, joint"):
        topic_text("sorcery")
    with pytest.raises(InputError, match="'cellapp docs screens' was removed"):
        topic_text("screens")
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match=r"cannot be written .*; give a file in a folder that you may write to"):
        write_figures(load_profile(TWIN), tmp_path / "file")
    twin = load_profile(TWIN)
    unplaced = twin.model_copy(update={"tracker": twin.tracker.model_copy(update={"pose": None})})
    with pytest.raises(InputError, match="figures need the poses of the tracker"):
        write_figures(unplaced, tmp_path)


# -- The chapter on messages quotes what the program says: every quoted message stands in its source -------------------

SPEAKING = ("drivers/arms", "drivers/trackers", "cellapp/cell/driving", "cellapp/cell/safety")
"""Folders whose messages the chapter explains."""
OTHERS = ("cellapp/commands/stages.py", "cellapp/ground/errors.py", "cellapp/interfaces/cli/program.py")
GAP = "..."
"""Stands in the chapter for what changes from case to case; here for the values in an f-string."""


def spoken() -> str:
    """All texts of the modules that have messages, one a line."""
    modules = [*(ROOT / name for name in OTHERS), *(path for name in SPEAKING for path in (ROOT / name).rglob("*.py"))]
    nodes = [node for module in modules for node in ast.walk(ast.parse(module.read_text("utf-8")))]
    texts = [node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            texts.append("".join(str(part.value) if isinstance(part, ast.Constant) else GAP for part in node.values))
    return "\n".join(texts)


def quoted() -> list[str]:
    """Messages in the tables whose first column is what the program says."""
    tables = re.findall(r"^\| the program says .*\n(?:\|.*\n)+", chapter_text("messages"), re.MULTILINE)
    rows = [row.split("|")[1] for table in tables for row in table.splitlines()[2:]]
    return [message for row in rows for message in re.findall(r"`([^`]+)`", row)]


def test_every_quoted_message_is_one_that_the_program_has() -> None:
    texts = spoken()
    messages = quoted()
    assert len(messages) > 40
    parts = {part.strip() for message in messages for part in re.split(r"\.\.\.|[;:(] ?", message)}
    assert not [part for part in parts if part not in texts]
