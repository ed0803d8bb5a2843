"""The kinds of weather station. A new kind is one module and one line here; profile, cell and doctor use this list."""

from drivers.sensors.serial_settings import SerialStationSettings
from drivers.sensors.settings import AirSensorSettings
from drivers.sensors.simulated_settings import SimulatedAirSensorSettings

AIR_SENSORS: tuple[type[AirSensorSettings], ...] = (SimulatedAirSensorSettings, SerialStationSettings)
