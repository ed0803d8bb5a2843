"""Where the profiles are that come with the program, and which profiles of a folder are offered; reads none of them."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from cellapp.ground.errors import InputError

TWIN = "twin"
"""The simulated cell that needs nothing but this program."""


def starters_folder() -> Path:
    """Folder of the starter profiles: ``starters`` in the installed package, ``profiles`` beside it in the source tree.

    Raises
    ------
    InputError
        If this installation lacks them.
    """
    package = Path(str(files("cellapp")))
    for folder in (package / "starters", package.parent / "profiles"):
        if (folder / f"{TWIN}.yaml").is_file():
            return folder
    raise InputError("this installation of cellapp lacks its starter profiles; install it again with pip")


def offered_profiles(folder: Path) -> list[Path]:
    """The profiles of a folder as they are offered: a person's own ones by name, then the starters, the twin first."""
    starters = {path.stem for path in starters_folder().glob("*.yaml")}
    return sorted(folder.glob("*.yaml"), key=lambda path: (path.stem in starters, path.stem != TWIN, path.stem))
