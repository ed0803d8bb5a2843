"""All kinds of arm; profile, cell and doctor use this list.

A new kind is one module and one line here, or a plug-in.
"""

from drivers.arms.settings import ArmSettings
from drivers.arms.simulated_settings import SimulatedArmSettings
from drivers.arms.ur_settings import UrSettings
from drivers.no_driver import NoDriver
from drivers.settings import device_kinds

ARMS = device_kinds(
    "cellapp.drivers.arms",
    "kind of arm",
    ArmSettings,  # type: ignore[type-abstract]  # the base is compared, never made
    (SimulatedArmSettings, UrSettings, NoDriver),
)
