"""Profiles that come with the program: the simulated twin and others, to start from in an empty folder."""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path

from cellapp.errors import InputError
from cellapp.profile.files import path_exists, write_new
from cellapp.profile.loader import load_profile, read_document

TWIN = "twin"
"""The simulated cell that needs nothing but this program."""
FOLDER = "profiles"
"""Folder of a person's profiles, below the folder where they work."""
_SENTENCE_END = re.compile(r"(?<=\.)\s+(?=[A-Z])")


@dataclass(frozen=True)
class Starter:
    """A profile that comes with the program: its name, what it is in one sentence, whether it has arms to move."""

    name: str
    sentence: str
    has_device: bool


def starters_folder() -> Path:
    """Folder of the starter profiles: beside the package where its source is used, else where they were installed.

    Raises
    ------
    InputError
        If this installation lacks them.
    """
    beside = Path(str(files("cellapp"))).parent / "profiles"
    if (beside / f"{TWIN}.yaml").is_file():
        return beside
    with contextlib.suppress(PackageNotFoundError):
        for file in distribution("cellapp").files or ():
            if file.match(f"share/cellapp/profiles/{TWIN}.yaml"):
                return Path(str(file.locate())).resolve().parent
    raise InputError("this installation of cellapp lacks its starter profiles; install it again with pip")


def starter_profiles() -> tuple[Starter, ...]:
    """Return all starter profiles, the twin first."""
    paths = sorted(starters_folder().glob("*.yaml"), key=lambda path: (path.stem != TWIN, path.stem))
    return tuple(_starter(path) for path in paths)


def arm_type_files() -> tuple[Path, ...]:
    """Return the files of the arm types that come with the program."""
    return tuple(sorted((starters_folder() / "arms").glob("*.yaml")))


def write_starter(name: str, folder: Path) -> Path:
    """Copy a starter profile into ``folder/profiles``; as ``copy_starter``."""
    return copy_starter(name, folder / FOLDER)


def copy_starter(name: str, profiles: Path) -> Path:
    """Copy a starter profile, the arm types and the targets that it names into a folder; return its path.

    Raises
    ------
    InputError
        If there is no such starter, a file exists already with another text, or one cannot be written.
    """
    known = [starter.name for starter in starter_profiles()]
    if name not in known:
        raise InputError(f"'{name}' is no profile that comes with cellapp; there are {', '.join(known)}")
    source, target = starters_folder() / f"{name}.yaml", profiles / f"{name}.yaml"
    if path_exists(target):
        raise InputError(f"{target} exists already; nothing was written. Give another folder, or move it away")
    text = source.read_text("utf-8")
    write_new({**copies(_named_files(text, source), profiles), target: text})
    return target


def copies(names: list[str], folder: Path) -> dict[Path, str]:
    """Return the files below ``folder`` with the texts of the starter files of the same relative ``names``."""
    return {folder / name: (starters_folder() / name).read_text("utf-8") for name in names}


def _named_files(text: str, source: Path) -> list[str]:
    data = read_document(text, source).data
    types = [arm["type"] for arm in data["arms"].values() if isinstance(arm["type"], str)]
    return [*dict.fromkeys(types), *([data["targets"]] if "targets" in data else [])]


def _starter(path: Path) -> Starter:
    """Read a starter; the first sentence of the comment at its top says what it is."""
    comment: list[str] = []
    for line in path.read_text("utf-8").splitlines():
        if not line.startswith("# "):
            break
        comment.append(line[2:].strip())
    profile = load_profile(path)
    sentence = _SENTENCE_END.split(" ".join(comment))[0]
    return Starter(path.stem, sentence, any(arm.driver.has_device for arm in profile.arms.values()))
