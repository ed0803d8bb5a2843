"""Files of arm types that plug-ins bring, by name; those that come with the program are in ``starters``."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from types import ModuleType

from drivers.plugins import Registry


def _file(name: str, found: object) -> Path:
    """The file ``name`` of a package. Raises ``ValueError`` if it has none."""
    if not isinstance(found, ModuleType):
        raise ValueError(f"expected a package that holds the file {name}, got {found!r}")
    if Path(name).name != name or Path(name).suffix != ".yaml":
        raise ValueError(f"'{name}' must be the name of a file, such as lift3.yaml")
    path = Path(str(files(found) / name))
    if not path.is_file():
        raise ValueError(f"package {found.__name__} holds no file {name}; it must be listed as package data")
    return path


ARM_TYPES: Registry[Path] = Registry("cellapp.arm_types", "arm type", {}, _file)
