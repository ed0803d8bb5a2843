"""Profiles that come with the program: the simulated twin and others, to start from in an empty folder.

Points that determine the pose of a base: each is known in the tracker frame M and at the arm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Self

from pydantic import model_validator

from cellapp.cell.profile.loader import load_profile, read_document
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import path_exists, write_new
from cellapp.ground.profile.sections import ArmPoint, CellPoint
from cellapp.ground.starters import offered_profiles, starters_folder
from drivers.quantities import Turn
from drivers.settings import Section

TWIN_SMALL = "twin-small"
"""The twin with fewer stops."""
FOLDER = "profiles"
"""Name of the folder of a person's profiles, below their working folder."""
READINGS = "readings"
"""Name of the folder, beside that one, of readings that come with a profile."""
_SENTENCE_END = re.compile(r"(?<=\.)\s+(?=[A-Z])")


@dataclass(frozen=True)
class Starter:
    """A profile that comes with the program: its name, what it is in one sentence, whether it has arms to move."""

    name: str
    sentence: str
    has_device: bool


def starter_profiles() -> tuple[Starter, ...]:
    """Return all starter profiles, the twin first."""
    return tuple(_starter(path) for path in offered_profiles(starters_folder()))


def arm_type_files() -> tuple[Path, ...]:
    """Return the files of the arm types that come with the program."""
    return tuple(sorted((starters_folder() / "arms").glob("*.yaml")))


def write_starter(name: str, folder: Path) -> Path:
    """Copy a starter profile into ``folder/profiles``; as ``copy_starter``."""
    return copy_starter(name, folder / FOLDER)


def copy_starter(name: str, profiles: Path, file: str = "") -> Path:
    """Copy a starter profile, as ``file`` if given, and the arm types that it names into a folder; return its path.

    If it names targets, all example lists of targets and paths are copied, too. A measured series brings its readings
    and their licence, in ``readings`` beside the folder of profiles.

    Raises
    ------
    InputError
        If there is no such starter, a file with another text exists already, or one cannot be written.
    """
    known = [starter.name for starter in starter_profiles()]
    if name not in known:
        raise InputError(f"'{name}' is no profile that comes with cellapp; there are {', '.join(known)}")
    source, target = starters_folder() / f"{name}.yaml", profiles / (file or f"{name}.yaml")
    if path_exists(target):
        raise InputError(f"{target} exists already; nothing was written. Give another folder, or move it away")
    text = source.read_text("utf-8")
    measured = {readings_of(name, profiles).parent / file.name: file.read_text("utf-8") for file in _series_files(name)}
    write_new({**copies(_named_files(text, source), profiles), **measured, target: text})
    return target


def readings_of(name: str, profiles: Path) -> Path:
    """Return where the readings of a measured series are, if it was copied beside the folder ``profiles``."""
    return profiles.parent / READINGS / name / "readings.csv"


def _series_files(name: str) -> tuple[Path, ...]:
    """Return the files of a measured series: readings, licence, description; empty for any other profile."""
    package = Path(str(files("cellapp")))
    for folder in (package / "starters" / READINGS, package.parent / "tests" / "fixtures"):
        if (folder / name / "readings.csv").is_file():
            return tuple(sorted(path for path in (folder / name).iterdir() if path.is_file()))
    return ()


def copies(names: list[str], folder: Path) -> dict[Path, str]:
    """Return the files below ``folder`` with the texts of the starter files of the same relative ``names``."""
    return {folder / name: (starters_folder() / name).read_text("utf-8") for name in names}


def _named_files(text: str, source: Path) -> list[str]:
    data = read_document(text, source).data
    types = [arm["type"] for arm in data["arms"].values() if isinstance(arm["type"], str)]
    folders = ("targets", "paths") if "targets" in data else ()
    examples = [f"{name}/{file.name}" for name in folders for file in sorted((source.parent / name).iterdir())]
    return [*dict.fromkeys(types), *examples]


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


class SurveyPoint(Section):
    """One point: ``tracker`` in M, and either ``base`` in the base frame B or the ``joints`` with the SMR there."""

    tracker: CellPoint
    base: ArmPoint | None = None
    joints: tuple[Turn, ...] | None = None

    @model_validator(mode="after")
    def _known_at_the_arm(self) -> Self:
        if (self.base is None) == (self.joints is None):
            raise ValueError(
                "give 'base' (coordinates in the base frame) or 'joints' (joint positions), one of the two"
            )
        return self
