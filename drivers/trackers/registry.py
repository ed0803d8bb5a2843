"""The kinds of tracker. A new kind is one module and one line here; profile, cell and doctor use this list."""

from drivers.no_driver import NoDriver
from drivers.trackers.bridge_settings import BridgeSettings
from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.settings import TrackerSettings
from drivers.trackers.simulated_settings import SimulatedTrackerSettings

TRACKERS: tuple[type[TrackerSettings], ...] = (SimulatedTrackerSettings, LmfSettings, BridgeSettings, NoDriver)
