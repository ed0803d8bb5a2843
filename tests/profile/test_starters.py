"""Starter profiles: an empty folder gets a profile that loads; nothing that a person wrote is overwritten."""

from __future__ import annotations

import os
from importlib.metadata import Distribution
from pathlib import Path
from types import SimpleNamespace

import pytest

from cellapp.errors import InputError
from cellapp.profile import load_profile
from cellapp.profile.files import write_text
from cellapp.profile.starters import starter_profiles, starters_folder, write_starter

pytestmark = pytest.mark.fast

NAMES = [starter.name for starter in starter_profiles()]


def test_the_twin_is_first_and_each_has_a_sentence() -> None:
    starters = starter_profiles()
    assert starters[0].name == "twin"
    assert all(starter.sentence.endswith(".") for starter in starters)
    assert {starter.name for starter in starters if not starter.has_device} == {"ur10-real", "ur10-real-d", "ur5-real"}


class Installed(Distribution):
    """What pip recorded of an installation: starter profiles, and another package's file of the same name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def read_text(self, filename: str) -> str | None:
        names = ("other/twin.yaml", "../share/cellapp/profiles/twin.yaml")
        return "\n".join(f"{name},," for name in names) if filename == "RECORD" else None

    def locate_file(self, path: str | os.PathLike[str]) -> Path:
        return self.folder / path


def test_an_installed_package_brings_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no folder ``profiles`` beside an installed package; pip put its files elsewhere and recorded where."""
    monkeypatch.setattr("cellapp.profile.starters.files", lambda package: tmp_path / "site" / package)
    monkeypatch.setattr("cellapp.profile.starters.distribution", lambda package: Installed(tmp_path / "site"))
    assert starters_folder() == tmp_path / "share" / "cellapp" / "profiles"


def test_an_installation_without_them_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.profile.starters.files", lambda package: tmp_path / package)
    monkeypatch.setattr("cellapp.profile.starters.distribution", lambda package: SimpleNamespace(files=None))
    with pytest.raises(InputError, match="lacks its starter profiles; install it again"):
        starters_folder()


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
