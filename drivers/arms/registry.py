"""The kinds of arm. A new kind is one module and one line here; profile, cell and doctor use this list."""

from drivers.arms.settings import ArmSettings
from drivers.arms.simulated_settings import SimulatedArmSettings
from drivers.arms.ur_settings import UrSettings
from drivers.no_driver import NoDriver

ARMS: tuple[type[ArmSettings], ...] = (SimulatedArmSettings, UrSettings, NoDriver)
