"""Chapters as texts: sections, links, lists and tables agree with the code; figures are kept and shown; what they state
holds."""

from __future__ import annotations

import ast
import json
import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import cellapp.docs
from cellapp.cell.profile import load_profile
from cellapp.cell.run.sqlite_file import SCHEMA_VERSION, create_tables
from cellapp.commands.docs.handbook import (
    CHAPTERS,
    anchor_of,
    chapter_text,
    effect_sections,
    search,
    sections,
    topic_text,
    topics,
)
from cellapp.commands.docs.keys import SHOWN, filled_keys
from cellapp.commands.docs.schema import schemas_text
from cellapp.commands.doctor.run import installed_findings
from cellapp.commands.report.sections import SECTIONS
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import Profile
from cellapp.ground.results import STAGE_NAMES
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import nominal_geometry, parallel_rows, smr_positions
from cellapp.robot.kinematics.transforms import Array, rotation_x, rotation_z, transform
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm
from tests.evidence.skeleton import Limit, Share, programs, stated_results
from tests.handbook import chapters
from tests.handbook.chapters import ROOT, chapter_path
from tests.handbook.declarations import with_declarations
from tests.handbook.page_pictures import PICTURES
from tests.interfaces.plugins.installed import EXAMPLE, REGISTRIES, add_example, installed
from tests.program import app
from tests.sure import sure
from tests.twin import PROFILES, whole_twin

README = Path(__file__).parents[2] / "README.md"
DOCS = Path(cellapp.docs.__file__).parent
TEXTS = {"README": README, **{chapter: DOCS / f"{chapter}.md" for chapter in CHAPTERS}}
MOST_WORDS = 660
LINK = re.compile(r"!?\[[^\]]+\]\((?!https?:)([^)\s#]+)")
MOST_BYTES = 150_000


@pytest.mark.parametrize("name", CHAPTERS)
def test_files_that_are_named_are_there(name: str) -> None:
    prose = re.sub(r"^```.*?^```", "", chapter_text(name), flags=re.S | re.M)
    named = set(re.findall(r"`([\w/]+/\w+\.py)`", prose))
    assert not [one for one in named if not (ROOT / one).exists() and not list(ROOT.glob(f"[cdt]*/**/{one}"))]


@pytest.mark.parametrize("name", ["README", *CHAPTERS])
def test_keys_in_prose_are_filled_from_the_table(name: str) -> None:
    text = README.read_text("utf-8") if name == "README" else chapter_text(name)
    prose = re.sub(r"<!--declared.*?<!--end-->|^```.*?^```", "", text, flags=re.S | re.M)
    keys = "|".join(map(re.escape, SHOWN.values()))
    typed = re.findall(rf"\*\*([1-8]|{keys})\*\*", prose)
    typed += re.findall(r"\bkeys? (?:\*\*)?([a-zA-Z1-9])\b", prose)
    assert not typed, "write {key:MEANING}"
    assert "{key" not in filled_keys(text)


def test_the_readme_is_short_and_no_figure_in_it_is_typed() -> None:
    text = re.sub(r"(?ms)^```.*?^```", "", README.read_text("utf-8"))
    assert len(text.split()) <= MOST_WORDS
    typed = re.sub(r"(?s)<!--declared:readme-->.*?<!--end-->|Python 3\.11 or 3\.12", "", text)
    assert re.findall(r"\d+\.\d+|\d+ (?:of|%|mm|ms|s|times)\b", typed) == []


def test_files_that_are_linked_are_there_and_every_figure_is_shown() -> None:
    linked = {
        (path.parent / link).resolve()
        for path in TEXTS.values()
        for link in LINK.findall(re.sub(r"(?ms)^```.*?^```", "", path.read_text("utf-8")))
    }
    assert [path for path in linked if not path.is_file()] == []
    figures = {path.resolve() for path in (DOCS / "figures").iterdir()}
    assert figures <= linked
    assert all(path.stat().st_size < MOST_BYTES for path in figures)
    assert {picture.name for picture in PICTURES} == {path.stem for path in figures if path.stem.startswith("page-")}


def test_the_readme_leads_to_sections_that_are_there() -> None:
    found = re.findall(r"\(cellapp/docs/(\w+)\.md#?([^)\s]*)\)", README.read_text("utf-8"))
    assert len(found) > 10
    for chapter, anchor in found:
        assert chapter in CHAPTERS
        assert not anchor or anchor in _anchors(chapter), anchor


# -- The glossary: in the order of the alphabet, short, each term with a chapter that says more ------------------------


def test_terms_stand_in_order_are_short_and_lead_to_a_chapter() -> None:
    entries = topic_text("glossary").strip().split("\n\n")[2:]
    terms = [re.match(r"\*\*(.+?)\*\*: ", entry) for entry in entries]
    names = [term[1].lower() for term in terms if term is not None]
    assert len(names) == len(entries) > 40
    assert names == sorted(names)
    for entry in entries:
        assert re.search(r"\]\(\w+\.md", entry), entry
        assert len(re.sub(r"\]\([^)]+\)", "]", entry)) < 260, entry


_TAKES = re.compile(r"\b(?:takes?|took) (?:some |about )?[\d.]+ (?:m?s|min)\b[^.;|]*")
_KNOWN = ("validation", "AMD EPYC", "times", "of the cell", "simulated twin")
"""What tells where a time is from."""


@pytest.mark.parametrize("name", ["README", "tutorial", "check", "cell"])
def test_no_time_of_the_program_stands_alone(name: str) -> None:
    text = README.read_text("utf-8") if name == "README" else chapter_text(name)
    text = " ".join(re.sub(r"(?s)```.*?```", "", text).split())
    alone = [words for words in _TAKES.findall(text) if not any(known in words for known in _KNOWN)]
    assert alone == []


# -- The handbook: a section and a figure for every effect, what repeats declarations ---------------------------------


def test_every_effect_has_a_section() -> None:
    assert set(effect_sections()) == set(EFFECTS)


@pytest.mark.parametrize("slug", EFFECTS)
def test_a_section_says_what_it_is_what_imitates_it_and_what_to_do(slug: str) -> None:
    section = effect_sections()[slug]
    assert f"(figures/{slug}.svg)" in section
    for part in ("```\n", "**Visible share.**", "**Usual size**", "**Check or mend.**", "**What settles it.**"):
        assert section.count(part) >= 1, part
    for other in EFFECTS[slug].confounded:
        assert f"[{other}](#{other})" in section


@pytest.mark.parametrize("name", TEXTS)
def test_what_a_text_repeats_of_declarations_and_results_is_up_to_date(name: str) -> None:
    text = TEXTS[name].read_text("utf-8")
    assert with_declarations(text) == text, "renew them: python -m tests.handbook"


def test_effects_are_declared_and_people_need_not_see_the_markers() -> None:
    assert chapter_text("effects").count("<!--declared:") == len(EFFECTS)
    assert "<!--" not in topic_text("effects") + topic_text("backlash")


def test_people_need_not_see_how_tests_run_an_example() -> None:
    assert "\n```sh dev\n" in chapter_text("report")
    assert "```sh dev" not in topic_text("report")
    assert chapter_text("report").count("\n```sh") == topic_text("report").count("\n```sh\n")


# -- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_chapters_and_sections_and_lists_the_topics() -> None:
    runner = CliRunner()
    assert runner.invoke(app, ["docs", "discovery"]).output.startswith("# How discovery decides")
    assert runner.invoke(app, ["docs", "validation"]).output.startswith("# Validation")
    section = runner.invoke(app, ["docs", "backlash"]).output
    assert section.startswith("## backlash\n")
    assert "## friction_windup" not in section
    listed = runner.invoke(app, ["docs"]).output
    assert all(topic in listed for topic in topics())
    found = json.loads(runner.invoke(app, ["docs", "backlash", "--json", "-"]).stdout)
    assert (found["schema"], found["topic"]) == ("cellapp-docs", "backlash")


def test_wrong_use_is_said_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"'sorcery' is not a topic; .* Topics are {', '.join(CHAPTERS)}, joint"):
        topic_text("sorcery")
    with pytest.raises(InputError, match=r"sections with this word: \w+\.md#"):
        topic_text("approach")
    with pytest.raises(InputError, match="did you mean 'cellapp-calibrate'"):
        schemas_text("calibrate")


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
    tables = re.findall(r"^\| the program says .*\n(?:\|.*\n)+", chapter_text("faults"), re.MULTILINE)
    rows = [row.split("|")[1] for table in tables for row in table.splitlines()[2:]]
    return [message for row in rows for message in re.findall(r"`([^`]+)`", row)]


def test_every_quoted_message_is_one_that_the_program_has() -> None:
    texts = spoken()
    messages = quoted()
    assert len(messages) > 40
    parts = {part.strip() for message in messages for part in re.split(r"\.\.\.|[;:(] ?", message)}
    assert not [part for part in parts if part not in texts]


_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
LINK_OF_TEXT = re.compile(r"(?<!!)\[[^\]]+\]\(([^)\s]+)\)")
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def _anchors(chapter: str) -> set[str]:
    """Anchors of the headings of a chapter."""
    return {anchor_of(heading) for heading in _HEADING.findall(_FENCED.sub("", chapter_text(chapter)))}


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_the_sections_of_a_chapter_are_its_text_and_every_link_leads_somewhere(chapter: str) -> None:
    its = sections(chapter)
    assert "".join(one.text for one in its).rstrip("\n") == topic_text(chapter).rstrip("\n")
    assert {one.anchor for one in its} == _anchors(chapter)
    assert its[0].level == 1
    assert not any("![" in one.terminal_text for one in its)
    for place in LINK_OF_TEXT.findall(_FENCED.sub("", chapter_text(chapter))):
        file, _, anchor = place.partition("#")
        there = file.removesuffix(".md") or chapter
        if "://" not in place and there in CHAPTERS:
            assert not anchor or anchor in _anchors(there), place


def test_every_screen_has_a_section_that_its_help_shows() -> None:
    headings = {one.heading for one in sections("terminal")}
    assert {f"Screen {screen.title}" for screen in SCREENS} <= headings


def test_a_picture_is_named_by_its_words_once() -> None:
    backlash = next(one for one in sections("effects") if one.anchor == "backlash")
    words = "Offset of joint 2 over its last step: half play of 40 µrad; hysteresis taken up over 11 deg"
    assert backlash.terminal_text.count(words) == 1
    assert f"*Picture: {words}*" in backlash.terminal_text
    with pytest.raises(InputError, match="not a topic"):
        sections("sorcery")


def test_a_search_finds_all_words_headings_first() -> None:
    found = search("Hayati angle")
    assert found[0].address == "frames.md#hayati-angle"
    assert len(found) > 1
    lines = [one.line_with("Hayati angle").lower() for one in found]
    assert all("hayati" in line or "angle" in line for line in lines if line)
    assert search("") == search("no such word anywhere") == []


def test_the_command_searches() -> None:
    runner = CliRunner()
    listed = runner.invoke(app, ["docs", "--search", "hayati angle"]).output
    assert listed.startswith("frames.md#hayati-angle\n  ")
    result = json.loads(runner.invoke(app, ["docs", "--search", "nosuchword", "--json", "-"]).stdout)
    assert result["text"] == "no section has all of these words: nosuchword"
    assert "without a topic" in str(runner.invoke(app, ["docs", "backlash", "--search", "x"]).exception)


def test_programs_that_are_named_are_there() -> None:
    known = {*programs(), "page", "NAME"}
    for chapter in chapters.CHAPTERS:
        text = (ROOT / chapter_path(chapter)).read_text("utf-8")
        assert {*re.findall(r"python -m\s+tests\.evidence\s(\w+)", text)} <= known, chapter
        assert "python -m tests.trials" not in text, chapter


def test_figures_are_of_programs_and_shown() -> None:
    assert set(stated_results()) <= set(programs())


def test_limits_and_shares_are_said() -> None:
    assert Limit("error", 0.2, most=0.3).words() == "error: 0.2 (at most 0.3)"
    assert Limit("share", 0.5, 1.0, 0.9).words() == "share: 0.5 (at least 0.9, at most 1; MISSED)"
    assert str(Share.of([True, False, None, 1])) == "2 of 4 (6.8 to 93.2 %)"
    assert str(Share.of([])) == ""


INCLUDED = re.compile(r"<!-- file: (\S+) -->\n```[\w ]+\n(.*?)```\n", re.DOTALL)


def test_the_parts_of_the_example_are_printed_as_they_are() -> None:
    printed = dict(INCLUDED.findall(chapter_text("extend")))
    assert len(printed) >= 3
    for name, text in printed.items():
        assert text == (EXAMPLE / name).read_text("utf-8"), f"copy {name} into the chapter again"


def test_every_group_is_in_the_table() -> None:
    rows = re.findall(r"^\| `(cellapp\.[\w.]+)` \|", chapter_text("extend"), re.MULTILINE)
    assert set(rows) == {registry.group for registry in REGISTRIES}


def test_what_the_chapter_shows_is_what_the_program_says(tmp_path: Path) -> None:
    with installed(add_example(tmp_path)):
        (finding,) = installed_findings()
        section = topic_text("hose_pull")
    assert f"ok       {finding.subject}: {finding.text}" in chapter_text("extend")
    assert section.startswith("## hose_pull\n\n*pull of the hose package.*")
    assert "**Usual size** (estimate). 0.1 to 0.5 mrad for each radian beyond." in section


def block(section: str, language: str) -> str:
    """The first example in a language of a section."""
    found = re.search(rf"^#+ {re.escape(section)}\n.*?```{language}[^\n]*\n(.*?)```", topic_text("files"), re.M | re.S)
    assert found is not None, section
    return found[1]


def rows(section: str) -> dict[str, str]:
    """First cell -> the rest, of the tables of a section."""
    text = re.search(rf"^#+ {re.escape(section)}\n(.*?)(?=^#+ |\Z)", topic_text("files"), re.M | re.S)
    assert text is not None, section
    return dict(re.findall(r"^\| (.+?) \| (.+) \|$", text[1], re.M))


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    shutil.copytree(PROFILES / "arms", tmp_path / "arms")
    (tmp_path / "my-cell.yaml").write_text(block("Profile", "yaml"), "utf-8")
    return tmp_path / "my-cell.yaml"


def test_the_least_profile_is_a_profile_and_every_section_is_listed(profile: Path) -> None:
    assert list(load_profile(profile).arms) == ["left"]
    listed = set(re.findall(r"`(\w+)(?:\.NAME)?`", " ".join(rows("Profile"))))
    assert listed == {field.alias or name for name, field in Profile.model_fields.items()} - {
        "schema",
        "version",
        "name",
        "seed",
    }


def test_every_column_of_readings_is_described_with_its_unit() -> None:
    described = rows("Readings")
    for column in COLUMNS:
        names = column.csv_names(9) if column.shape != "joints" else (f"{column.csv[0]}1",)
        row = next(cells for first, cells in described.items() if names[0] in re.split(r"[`, ]+", first))
        assert row.startswith(column.unit.replace("^2", "²") or "|"), (column.name, row)
        assert ("**required**" in row) == column.required


def test_the_tables_of_a_run_file_are_those_that_are_made() -> None:
    described = rows("run.sqlite")
    assert f"(schema {SCHEMA_VERSION})" in chapter_text("files")
    with closing(sqlite3.connect(":memory:")) as connection:
        create_tables(connection)
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        assert {f"`{name}`" for name in tables} == set(described) - {"table", "---"}
        for table in tables:
            columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
            as_reading = described["`reading`"] if "as `reading`" in described[f"`{table}`"] else ""
            words = re.findall(r"`(\w+)`", as_reading + described[f"`{table}`"])
            assert set(columns) <= set(words), table
    listed = sure(re.search(r"names in `stage` are ([^.]+)\.", chapter_text("files")))
    assert tuple(listed[1].replace("\n", " ").split(", ")) == STAGE_NAMES


def test_the_model_file_has_the_keys_that_are_listed() -> None:
    twin = load_profile(PROFILES / "twin.yaml")
    model = json.loads(CellModel({"left": nominal_model(twin, "left")}).to_json())
    example = json.loads(block("calibration.json", "json"))
    assert set(example) - {"pair"} <= set(model)
    listed = {name for first in rows("calibration.json") for name in re.findall(r"`(\w+)`", first)}
    assert set(model["arms"]["left"]) == listed - {"key"}
    of_example, of_model = (one["arms"]["left"]["geometry"]["parameters"] for one in (example, model))
    assert set(of_example) <= set(of_model)


def test_a_ur_has_hayati_angles_in_rows_2_and_3() -> None:
    assert parallel_rows(nominal_arm(whole_twin().arms["left"])) == (1, 2)


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


def test_every_section_is_described() -> None:
    missing = [title for title, *_ in SECTIONS.values() if title.split(",")[0] not in chapter_text("report")]
    assert not missing
