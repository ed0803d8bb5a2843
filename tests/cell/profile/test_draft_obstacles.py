"""Obstacles in the form of a profile: every shape comes back, problems stand at their field, comments stay."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.draft import ObstacleDraft, ProfileDraft, draft_of, draft_to_yaml, fields_of, with_text
from cellapp.cell.profile.draft_check import check_draft
from cellapp.cell.profile.draft_edit import edited_text
from cellapp.cell.profile.draft_file import open_profile, save_new
from cellapp.commands.init.answers import write_answers
from cellapp.ground.profile.obstacles import SHAPES
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

SECTION = """obstacles:
  table:   # bolted to the floor
    shape: box
    size: [1.2, "800 mm", 0.05]
    pose: {position: [1.6, 0.0, -0.3]}
  # moved twice a year
  pillar:
    shape: cylinder
    radius: "80 mm"
    length: 2.4
    pose:
      position: [2.4, 0.9, 1.0]

plan:
"""
DRAFTS = (
    ObstacleDraft("table", "box", "cell", "", "1.6, 0, -0.3", "0, 0, 90 deg", size="1.2, 800 mm, 0.05"),
    ObstacleDraft("pillar", "cylinder", "", "", "2.4, 0.9, 1.0", radius="80 mm", length="2.4"),
    ObstacleDraft("cable", "capsule", "flange", "left", "0, 60 mm, 0", radius="30 mm", length="100 mm"),
    ObstacleDraft("knob", "sphere", "base", "right", radius="5 cm"),
)


@functools.cache
def twin() -> tuple[str, ProfileDraft]:
    """Text and draft of the twin with a table and a pillar."""
    path = PROFILES / "twin.yaml"
    text = path.read_text("utf-8").replace("plan:\n", SECTION, 1)
    return text, draft_of(text, path)


def judged(*obstacles: ObstacleDraft) -> dict[str, str]:
    """Problems by field of the twin with these obstacles."""
    checked = check_draft(replace(twin()[1], obstacles=obstacles), PROFILES / "twin.yaml")
    return {problem.field: problem.words for problem in checked.problems}


def edited(draft: ProfileDraft) -> str:
    return edited_text(twin()[0], PROFILES / "twin.yaml", draft).text


def test_obstacles_survive_the_form(tmp_path: Path) -> None:
    profile = load_profile(save_new(tmp_path, replace(twin()[1], obstacles=DRAFTS), "cell.yaml"))
    assert {name: one.shape for name, one in profile.obstacles.items()} == {one.name: one.shape for one in DRAFTS}
    table, cable = profile.obstacles["table"], profile.obstacles["cable"]
    assert isinstance(table, SHAPES["box"])
    assert (cable.fixed_to, cable.arm) == ("flange", "left")
    again = open_profile(tmp_path / "cell.yaml").draft.obstacles
    assert [replace(one, source="") for one in again] == list(DRAFTS)


def test_obstacles_can_be_answers_too(tmp_path: Path) -> None:
    answers = draft_to_yaml(replace(twin()[1], obstacles=DRAFTS)).partition("\ncalibration:")[0]
    (tmp_path / "answers.yaml").write_text(answers, "utf-8")
    written = write_answers(tmp_path / "answers.yaml", tmp_path)
    assert list(load_profile(written.path).obstacles) == [one.name for one in DRAFTS]


def test_a_shape_has_its_own_fields() -> None:
    for shape, known in SHAPES.items():
        draft = replace(twin()[1], obstacles=(ObstacleDraft("one", shape),))
        names = {item.form.path[0] for item in fields_of(draft) if item.id.startswith("obstacles.0.")}
        assert names == set(known.model_fields)


def test_problems_stand_at_their_field() -> None:
    assert judged(*DRAFTS) == {}
    table, pillar, cable, _ = DRAFTS
    assert "at least" not in judged(replace(pillar, radius="-1 mm"))["obstacles.0.radius"]
    assert "more than 0" in judged(replace(pillar, radius="-1 mm"))["obstacles.0.radius"]
    assert "missing" in judged(replace(table, size=""))["obstacles.0.size"]
    assert "3 values" in judged(replace(table, size="1, 2"))["obstacles.0.size"]
    assert "expected 'box'" in judged(replace(table, shape="cone"))["obstacles.0.shape"]
    assert "missing" in judged(replace(cable, arm=""))["obstacles.0.arm"]
    assert "unknown arm" in judged(table, replace(cable, arm="middle"))["obstacles.1.arm"]
    assert "file" in judged(ObstacleDraft("guard", "mesh", file="nowhere.stl"))["obstacles.0.file"]
    assert "needs a name, such as table" in judged(replace(table, name=" "))["obstacles.0.name"]
    assert "given twice" in judged(table, replace(pillar, name="table"))["obstacles.1.name"]


def test_those_that_hold_are_known_while_others_do_not() -> None:
    wrong = replace(DRAFTS[1], radius="")
    checked = check_draft(replace(twin()[1], obstacles=(DRAFTS[0], wrong)), PROFILES / "twin.yaml")
    assert checked.profile is None
    assert list(checked.obstacles) == ["table"]


def test_an_edit_keeps_comments_and_other_lines() -> None:
    text, draft = twin()
    moved = edited(with_text(draft, "obstacles.1.position", "2.4, 0.9, 1.1"))
    assert moved == text.replace("position: [2.4, 0.9, 1.0]", "position: [2.4, 0.9, 1.1]")
    renamed = edited(with_text(draft, "obstacles.0.name", "bench"))
    assert renamed == text.replace("  table:", "  bench:")
    round_pillar = edited(with_text(draft, "obstacles.1.shape", "sphere"))
    assert round_pillar == text.replace("shape: cylinder", "shape: sphere").replace("    length: 2.4\n", "")


@pytest.mark.slow
def test_obstacles_are_added_and_removed() -> None:
    text, draft = twin()
    more = draft_of(edited(replace(draft, obstacles=(*draft.obstacles, DRAFTS[2]))), PROFILES / "twin.yaml")
    assert replace(more.obstacles[1], source="") == DRAFTS[2]
    assert [one.name for one in more.obstacles] == ["table", "cable", "pillar"], "what stands behind the last one stays"
    without = edited_text(text, PROFILES / "twin.yaml", replace(draft, obstacles=()))
    assert "obstacles" not in without.text
    assert "bolted to the floor" in " ".join(without.lost_comments)
    plain = (PROFILES / "twin.yaml").read_text("utf-8")
    first = edited_text(plain, PROFILES / "twin.yaml", replace(draft, obstacles=(DRAFTS[0],))).text
    assert draft_of(first, PROFILES / "twin.yaml").obstacles == (replace(DRAFTS[0], source="table"),)
