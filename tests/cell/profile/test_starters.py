"""Starter profiles: an empty folder gets a profile that loads; nothing that a person wrote is overwritten."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.files import write_text
from cellapp.cell.profile.starters import starter_profiles, write_starter
from cellapp.ground.errors import InputError
from cellapp.ground.starters import offered_profiles, starters_folder

NAMES = [path.stem for path in offered_profiles(starters_folder())]


def test_the_twin_is_first_and_each_has_a_sentence() -> None:
    starters = starter_profiles()
    assert starters[0].name == "twin"
    assert [starter.name for starter in starters] == NAMES
    assert all(starter.sentence.endswith(".") for starter in starters)
    without_device = {starter.name for starter in starters if not starter.has_device}
    assert without_device == {"ur10-6d", "ur10-real", "ur10-real-d", "ur5-real"}


def test_the_small_twin_is_the_twin_with_fewer_stops() -> None:
    twin, small = (load_profile(starters_folder() / f"{name}.yaml") for name in ("twin", "twin-small"))
    assert small.plan.stops < twin.plan.stops
    assert twin == small.model_copy(update={"name": twin.name, "plan": twin.plan, "splits": twin.splits})
    assert twin.plan == small.plan.model_copy(update={"stops": twin.plan.stops})


def test_an_installed_package_brings_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder ``profiles`` beside an installed package is another package's."""
    for folder in ("cellapp/starters", "profiles"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "twin.yaml").touch()
    monkeypatch.setattr("cellapp.ground.starters.files", lambda package: tmp_path / package)
    assert starters_folder() == tmp_path / "cellapp" / "starters"


def test_an_installation_without_them_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.starters.files", lambda package: tmp_path / package)
    with pytest.raises(InputError, match="lacks its starter profiles; install it again"):
        starters_folder()


def test_a_cell_with_targets_gets_all_example_lists(tmp_path: Path) -> None:
    write_starter("twin", tmp_path)
    for folder in ("targets", "paths"):
        brought = {path.name for path in (starters_folder() / folder).iterdir()}
        assert {path.name for path in (tmp_path / "profiles" / folder).iterdir()} == brought
    write_starter("ur10-real", tmp_path / "other")
    assert not (tmp_path / "other" / "profiles" / "targets").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_starter_loads_where_it_was_written(name: str, tmp_path: Path) -> None:
    path = write_starter(name, tmp_path)
    assert path == tmp_path / "profiles" / f"{name}.yaml"
    profile = load_profile(path)
    assert profile == load_profile(starters_folder() / f"{name}.yaml")
    assert profile.targets is None or (path.parent / profile.targets).is_file()


def test_starters_share_arm_types_but_overwrite_nothing(tmp_path: Path) -> None:
    write_starter("twin", tmp_path)
    write_starter("ur10-ur5", tmp_path)  # the same arm types are there already
    with pytest.raises(InputError, match=r"twin\.yaml exists already; nothing was written"):
        write_starter("twin", tmp_path)
    own = tmp_path / "profiles" / "arms" / "ur5.yaml"
    own.write_text("# mine\n", "utf-8")
    with pytest.raises(InputError, match=r"ur5\.yaml exists already; nothing was written"):
        write_starter("ur5-real", tmp_path)
    assert not (tmp_path / "profiles" / "ur5-real.yaml").exists()
    assert own.read_text("utf-8") == "# mine\n"


def test_an_unknown_starter_is_refused_with_those_that_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'tvin' is no profile that comes with cellapp; there are twin,"):
        write_starter("tvin", tmp_path)


def test_a_folder_that_cannot_be_made_gets_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "profiles").write_text("a file, not a folder", "utf-8")
    with pytest.raises(InputError, match=r"cannot be (written|reached) \(.+\); give a"):
        write_starter("twin", tmp_path)


def test_a_link_stays_a_link_and_permissions_stay(tmp_path: Path) -> None:
    file, link = tmp_path / "cell.yaml", tmp_path / "link.yaml"
    file.write_text("old\n", "utf-8")
    file.chmod(0o640)
    link.symlink_to(file)
    write_text(link, "new\n")
    assert link.is_symlink()
    assert file.read_text("utf-8") == "new\n"
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_full_disk_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("old\n", "utf-8")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        write_text(path, "new\n")
    assert [(entry.name, entry.read_text("utf-8")) for entry in tmp_path.iterdir()] == [("cell.yaml", "old\n")]
