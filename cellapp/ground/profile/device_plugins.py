"""Which devices and arm types come from plug-ins."""

from __future__ import annotations

from cellapp.ground.profile.arm_types import ARM_TYPES
from cellapp.ground.profile.schema import Profile
from drivers.arms.registry import ARMS
from drivers.plugins import Plugin
from drivers.sensors.registry import AIR_SENSORS
from drivers.trackers.registry import TRACKERS


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
