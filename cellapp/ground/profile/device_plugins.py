"""Which devices and arm types come from plug-ins."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from types import ModuleType

from cellapp.ground.profile.schema import Profile
from drivers.arms.registry import ARMS
from drivers.plugins import Plugin, Registry
from drivers.sensors.registry import AIR_SENSORS
from drivers.trackers.registry import TRACKERS

# -- Files of arm types that plug-ins bring, by name; those that come with the program are in ``starters`` ------------


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


def device_plugins() -> tuple[Plugin, ...]:
    """All entry points for kinds of devices and for arm types, also those that are not used."""
    return tuple(one for registry in (ARMS, TRACKERS, AIR_SENSORS, ARM_TYPES) for one in registry.plugins)


def plugins_of_devices(profile: Profile) -> tuple[Plugin, ...]:
    """The plug-ins whose drivers a profile names, each once."""
    air = profile.sensors.air
    found = (
        *(ARMS.plugin(arm.driver.kind) for arm in profile.arms.values()),
        TRACKERS.plugin(profile.tracker.driver.kind),
        None if air is None else AIR_SENSORS.plugin(air.kind),
    )
    return tuple(dict.fromkeys(one for one in found if one is not None))
