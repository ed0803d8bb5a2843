"""A form's texts become YAML that loads; problems stand at their field; an edit leaves everything else as it was."""

from __future__ import annotations

import difflib
import functools
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.draft import (
    ArmDraft,
    ProfileDraft,
    arm_kinds,
    draft_of,
    draft_to_yaml,
    fields_of,
    file_name,
    tracker_kinds,
    with_text,
)
from cellapp.cell.profile.draft_check import check_draft, check_text
from cellapp.cell.profile.draft_edit import edited_text
from cellapp.cell.profile.draft_file import blank_draft, changed_on_disk, new_text, open_profile, save, save_new
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.twin import PROFILES

SHIPPED = sorted(PROFILES.glob("*.yaml"))


@functools.cache
def draft(name: str = "twin") -> ProfileDraft:
    path = PROFILES / f"{name}.yaml"
    return draft_of(path.read_text("utf-8"), path)


def changed(name: str, **texts: str) -> ProfileDraft:
    """A shipped profile's draft with fields changed; a double underscore stands for a dot."""
    result = draft(name)
    for field, text in texts.items():
        result = with_text(result, field.replace("__", "."), text)
    return result


def formed(profile: Profile) -> tuple[object, ...]:
    """What a form fills of a profile, without settings of drivers and probes that it does not have."""
    arms = [
        (name, arm.type, arm.driver.kind, arm.base, arm.payload, arm.limits, arm.home, arm.speed_scale, smr)
        for name, arm in profile.arms.items()
        for smr in (arm.smr.model_copy(update={"probe": None}),)
    ]
    plan = (profile.plan.stops, profile.plan.clearance, profile.plan.floor)
    return profile.name, arms, profile.tracker.driver.kind, profile.tracker.pose, plan


# -- draft -> YAML -> profile -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_cell_survives_the_form(path: Path, tmp_path: Path) -> None:
    """Two makes of arms, six and seven joints, every kind of driver, an unknown SMR offset."""
    written = save_new(tmp_path, draft(path.stem), "cell.yaml")
    assert formed(load_profile(written)) == formed(load_profile(path))


def test_the_yaml_explains_itself(tmp_path: Path) -> None:
    text = draft_to_yaml(draft("ur10-ur5"))
    assert "host: 192.168.0.10   # address of the controller" in text
    assert '      - ["-170 deg", "-10 deg"]' in text
    assert "plant" not in text
    assert max(map(len, text.splitlines())) <= 120
    assert "plant:" in draft_to_yaml(draft())


@settings(max_examples=25, deadline=None)
@given(
    name=st.text(min_size=1, max_size=20),
    arm=st.text(min_size=1, max_size=20),
    position=st.tuples(*[st.floats(-99.0, 99.0)] * 3),
    angle=st.floats(-360.0, 360.0),
)
def test_any_text_and_any_number_come_back_as_typed(name, arm, position, angle) -> None:
    form = replace(draft(), name=name, arms=(replace(draft().arms[0], name=arm),))
    form = with_text(form, "arms.0.position", ", ".join(map(repr, position)))
    form = with_text(form, "arms.0.rpy", f"0, {angle!r} deg, 0")
    checked = check_draft(form, PROFILES / "new.yaml")
    if not arm.strip() or not name.strip() or any("\ud800" <= letter <= "\udfff" for letter in name + arm):
        return
    assert [str(problem) for problem in checked.problems] == []
    assert checked.profile is not None
    assert (checked.profile.name, [*checked.profile.arms]) == (name.strip(), [arm])
    base = checked.profile.arms[arm].base
    assert base is not None
    assert base.position == position


def test_the_form_knows_all_kinds_of_devices() -> None:
    assert arm_kinds() == ("simulated", "ur", "none")
    assert tracker_kinds() == ("simulated", "lmf", "bridge", "none")
    fields = {item.id for item in fields_of(changed("twin", tracker__kind="bridge", arms__0__kind="ur"))}
    assert {"arms.0.host", "tracker.url", "tracker.token_file"} <= fields
    assert not {"arms.1.host", "tracker.address"} & fields


def test_a_name_makes_a_file_name() -> None:
    assert file_name(ProfileDraft(name="Halle 3/links")) == "Halle-3-links.yaml"
    assert file_name(ProfileDraft(name="../..")) == "cell.yaml"


# -- problems at their fields -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "text", "words"),
    [
        ("name", "", "expected a text, got an empty one"),
        ("arms.0.kind", "urr", "expected 'simulated', 'ur' or 'none', got 'urr'"),
        ("arms.0.type", "arms/nope.yaml", "file not found"),
        ("arms.0.type", "", "missing; it must be given"),
        ("arms.0.position", "1, 2", "expected 3 values, got a list of 2"),
        ("arms.0.position", "0,85; 1; 2", "expected a"),
        ("arms.1.position", "850, 0, 0", "850 m is beyond 100 m; a plain number is metres"),
        ("arms.1.rpy", "0, 0, 90 mm", "'mm' is not a unit of angle; use one of rad,"),
        ("arms.0.home", "", "missing; arm left has a driver"),
        ("arms.0.home", "1, 2, 3", "3 positions for 6 joints"),
        ("arms.0.limits", "-1, 1; 3", "expected 2 values, got a list of 1"),
        ("arms.0.limits", "-1, 1", "1 ranges for the 6 joints of UR10"),
        ("arms.0.smr_offset", "somewhere", "expected a list or 'unknown', got 'somewhere'"),
        ("arms.0.smr_normal", "0, 0, 2", "normal must be a unit vector"),
        ("arms.0.payload_mass", "-1", "expected at least 0, got -1"),
        ("arms.0.speed", "50 %", "expected a number, got '50 %'"),
        ("tracker.position", "", "missing; it must be given"),
        ("tracker.rpy", "90", "90 rad is more than two turns"),
        ("plan.stops", "010", "expected a whole number, got '010'"),
        ("plan.floor", "low", "expected a length"),
        ("arms.0.name", "", "missing; each arm needs a name"),
        ("arms.1.name", "left", "given twice"),
    ],
)
def test_a_bad_field_is_named_and_explained(field: str, text: str, words: str) -> None:
    problems = check_draft(with_text(draft(), field, text), PROFILES / "new.yaml").problems
    assert any(problem.field == field and words in problem.words for problem in problems), [*map(str, problems)]


def test_a_new_cell_asks_for_what_only_a_person_knows() -> None:
    problems = {problem.field for problem in check_draft(blank_draft(), PROFILES / "new.yaml").problems}
    assert {
        "name",
        "arms.0.host",
        "arms.1.host",
        "arms.0.smr_offset",
        "tracker.address",
        "tracker.position",
    } <= problems


def test_a_profile_that_holds_its_arm_types_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("arms: {left: {type: {model: X}}}\n", "utf-8")
    with pytest.raises(InputError, match=r"arms\.left\.type: the form edits arms whose type is a file"):
        open_profile(path)


# -- editing ----------------------------------------------------------------------------------------------------------


def edit(name: str, **texts: str) -> tuple[list[str], list[str], tuple[str, ...]]:
    """Lines that an edit takes from a shipped profile, lines that it adds, and the comments that it reports lost."""
    path = PROFILES / f"{name}.yaml"
    old = path.read_text("utf-8")
    new = edited_text(old, path, changed(name, **texts))
    lines = list(difflib.ndiff(old.splitlines(), new.text.splitlines()))
    taken, added = ([line[2:].strip() for line in lines if line.startswith(mark)] for mark in "-+")
    return taken, added, new.lost_comments


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_an_edit_of_nothing_changes_nothing(path: Path) -> None:
    text = path.read_text("utf-8")
    assert edited_text(text, path, draft(path.stem)).text == text
    same = with_text(draft(path.stem), "name", f" {draft(path.stem).name} ")
    assert edited_text(text, path, same).text == text, "the YAML is written back as it was read"


def test_an_edit_changes_its_line_only() -> None:
    taken, added, lost = edit("ur10-ur5", arms__0__home="0.0, -80 deg, 0.0, -90 deg, 0.0, 0.0", plan__stops="200")
    assert len(taken) == len(added) == 2
    assert added[0].startswith('home: [0.0, "-80 deg", 0.0, "-90 deg", 0.0, 0.0]   # straight up')
    assert added[1] == "stops: 200"
    assert lost == ()


def test_a_new_key_stands_in_its_section() -> None:
    taken, added, lost = edit("ur10-ur5", arms__0__serial="20153012345", arms__0__smr_offset="unknown")
    assert added[0] == 'serial: "20153012345"'
    assert "offset: unknown, normal: [0, 0, 1], acceptance" in added[1]
    assert (len(taken), lost) == (1, ())


def test_keys_that_the_form_does_not_know_survive_another_driver(tmp_path: Path) -> None:
    texts = {"tracker__kind": "bridge", "tracker__url": "socket://10.0.0.5:50960", "tracker__token_file": "~/token"}
    path = PROFILES / "ur10-ur5.yaml"
    new = edited_text(path.read_text("utf-8"), path, changed("ur10-ur5", **texts))
    shutil.copytree(PROFILES / "arms", tmp_path / "arms")
    (tmp_path / "cell.yaml").write_text(new.text, "utf-8")
    old, profile = load_profile(path), load_profile(tmp_path / "cell.yaml")
    assert profile.tracker.driver.kind == "bridge"
    assert (profile.collection, profile.arms, profile.plan) == (old.collection, old.arms, old.plan)
    assert "CHANGE if it is not the tracker's address as delivered" in new.lost_comments


def test_a_renamed_arm_keeps_its_keys_and_its_hidden_effects(tmp_path: Path) -> None:
    path = PROFILES / "twin.yaml"
    new = edited_text(path.read_text("utf-8"), path, changed("twin", arms__0__name="links"))
    checked = check_draft(changed("twin", arms__0__name="links"), path)
    assert checked.problems == ()
    assert new.lost_comments == ()
    shutil.copytree(PROFILES, tmp_path, dirs_exist_ok=True)
    (tmp_path / "twin.yaml").write_text(new.text, "utf-8")
    profile, old = load_profile(tmp_path / "twin.yaml"), load_profile(path)
    assert [*profile.arms] == ["links", "right"]
    assert profile.arms["links"] == old.arms["left"]
    assert profile.plant is not None
    assert old.plant is not None
    assert profile.plant.effects["links"] == old.plant.effects["left"]


def test_two_arms_can_change_their_names() -> None:
    path = PROFILES / "twin.yaml"
    swapped = changed("twin", arms__0__name="right", arms__1__name="left")
    text = edited_text(path.read_text("utf-8"), path, swapped).text
    profile, old = check_text(text, path, swapped).profile, load_profile(path)
    assert profile is not None
    assert [*profile.arms] == ["right", "left"]
    assert (profile.arms["right"], profile.arms["left"]) == (old.arms["left"], old.arms["right"])
    assert profile.plant is not None
    assert old.plant is not None
    assert profile.plant.effects["left"] == old.plant.effects["right"]


def test_obstacles_of_an_arm_follow_its_name() -> None:
    path = PROFILES / "ur10-ur5.yaml"
    text = path.read_text("utf-8")
    arms = draft("ur10-ur5").arms
    renamed = replace(draft("ur10-ur5"), arms=(replace(arms[0], name="links"), arms[1]))
    profile = check_text(edited_text(text, path, renamed).text, path, renamed).profile
    assert profile is not None
    assert [one.arm for one in profile.obstacles.values()] == [None, "links", "right", None]
    alone = replace(draft("ur10-ur5"), arms=arms[1:])
    profile = check_text(edited_text(text, path, alone).text, path, alone).profile
    assert profile is not None
    assert [*profile.obstacles] == ["table", "right_pedestal", "pillar"]


@pytest.mark.parametrize("name", ["", "right"])
def test_names_that_yaml_cannot_hold_are_not_written(name: str, tmp_path: Path) -> None:
    opened = open_profile(save_new(tmp_path, draft(), "twin.yaml"))
    form = with_text(opened.draft, "arms.0.name", name)
    new = new_text(opened, form)
    assert new.text is None
    with pytest.raises(InputError, match=r"cannot be written: arms\[0\]: (missing|given twice)"):
        save(opened, form, new)
    assert not changed_on_disk(opened)


def test_arms_can_be_removed_and_added() -> None:
    one = replace(draft(), arms=(draft().arms[0], ArmDraft(**{**vars(draft().arms[1]), "name": "third", "source": ""})))
    path = PROFILES / "ur10-ur5.yaml"
    text = edited_text((PROFILES / "twin.yaml").read_text("utf-8"), PROFILES / "twin.yaml", one).text
    again = draft_of(text, path)
    assert check_text(text, path, again).problems == (), "hidden effects of the arm that went are gone, too"
    assert [arm.name for arm in again.arms] == ["left", "third"]
    assert again.arms[1].position == draft().arms[1].position


def test_a_surveyed_base_says_so_until_it_is_typed_again() -> None:
    path = PROFILES / "twin.yaml"
    text = path.read_text("utf-8")
    words = "From tracker points: 4 points fit to 0.10 mm rms."
    surveyed = with_text(changed("twin", arms__1__position="0, -0.9, 0"), "arms.1.note", words)
    noted = edited_text(text, path, surveyed).text
    assert f"\n    # {words}\n    base: {{position: [0.0, -0.9, 0.0]" in noted
    assert noted.count("From tracker points") == 1
    again = edited_text(noted, path, with_text(surveyed, "arms.1.position", "0, -0.8, 0")).text
    assert again.count("From tracker points") == 1
    typed = with_text(draft_of(again, path), "arms.1.position", "0.0, -0.85, 0.0")
    assert edited_text(again, path, typed).text == text


def test_lost_comments_are_reported() -> None:
    taken, _, lost = edit("twin", plan__floor="")
    assert [line.partition(":")[0] for line in taken if line] == ["floor"]
    assert lost == ("both bases stand on plinths 200 mm high; nothing may reach below this height in C (default 0)",)


def test_line_ends_of_windows_stay() -> None:
    path = PROFILES / "twin.yaml"
    text = path.read_text("utf-8").replace("\n", "\r\n")
    new = edited_text(text, path, changed("twin", plan__stops="100")).text
    assert new == text.replace("stops: 400", "stops: 100")


def test_a_layout_that_would_not_survive_is_refused(tmp_path: Path) -> None:
    path = PROFILES / "twin.yaml"
    text = path.read_text("utf-8").replace("plan:\n  stops", "plan:\n      stops").replace("\n  clea", "\n      clea")
    text = text.replace("\n  floor", "\n      floor")
    with pytest.raises(InputError, match="an edit would change the layout of this YAML elsewhere; edit it by hand"):
        edited_text(text, path, changed("twin", plan__stops="100"))


# -- the file ---------------------------------------------------------------------------------------------------------


def test_a_file_that_changed_meanwhile_is_noticed(tmp_path: Path) -> None:
    path = save_new(tmp_path, draft(), "twin.yaml")
    opened = open_profile(path)
    form = with_text(opened.draft, "plan.stops", "100")
    assert not changed_on_disk(opened)
    path.write_text(path.read_text("utf-8") + "# a colleague\n", "utf-8")
    assert changed_on_disk(opened)
    opened = open_profile(path)
    new = new_text(opened, form)
    assert (new.checked.problems, new.lost_comments) == ((), ())
    saved = save(opened, form, new)
    assert not changed_on_disk(saved)
    assert load_profile(path).plan.stops == 100
    assert path.read_text("utf-8").endswith("# a colleague\n")


def test_a_new_profile_brings_its_arm_types_and_overwrites_nothing(tmp_path: Path) -> None:
    save_new(tmp_path, draft(), "cell.yaml")
    assert sorted(path.name for path in (tmp_path / "arms").iterdir()) == ["ur10.yaml", "ur5.yaml"]
    with pytest.raises(InputError, match=r"cell\.yaml exists already; nothing was written"):
        save_new(tmp_path, draft(), "cell.yaml")
    with pytest.raises(InputError, match=r"plan\.stops: expected a whole number, got 'many'"):
        save_new(tmp_path, changed("twin", plan__stops="many"), "other.yaml")
    assert not (tmp_path / "other.yaml").exists()
