"""All kinds of weather station; profile, cell and doctor use this list.

A new kind is one module and one line here, or a plug-in.
"""

from drivers.sensors.serial_settings import SerialStationSettings
from drivers.sensors.settings import AirSensorSettings
from drivers.sensors.simulated_settings import SimulatedAirSensorSettings
from drivers.settings import device_kinds

AIR_SENSORS = device_kinds(
    "cellapp.drivers.sensors",
    "kind of weather station",
    AirSensorSettings,  # type: ignore[type-abstract]  # the base is compared, never made
    (SimulatedAirSensorSettings, SerialStationSettings),
)
