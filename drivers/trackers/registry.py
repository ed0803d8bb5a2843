"""All kinds of tracker; profile, cell and doctor use this list.

A new kind is one module and one line here, or a plug-in.
"""

from drivers.no_driver import NoDriver
from drivers.settings import device_kinds
from drivers.trackers.bridge_settings import BridgeSettings
from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.settings import TrackerSettings
from drivers.trackers.simulated_settings import SimulatedTrackerSettings

TRACKERS = device_kinds(
    "cellapp.drivers.trackers",
    "kind of tracker",
    TrackerSettings,  # type: ignore[type-abstract]  # the base is compared, never made
    (SimulatedTrackerSettings, LmfSettings, BridgeSettings, NoDriver),
)
