"""The weather station of the simulated cell."""

from __future__ import annotations

from drivers.plant import Plant
from drivers.sensors.protocol import AirReading, SensorLinkLost

_PRESSURE_HPA = 1013.25
_HUMIDITY_PERCENT = 50.0


class SimulatedAirSensor:
    """Reads the air temperature of a ``Plant``; pressure and humidity stay at standard values."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._connected = False

    def connect(self) -> None:
        """Open the link."""
        self._connected = True

    def read(self) -> AirReading:
        """Return the current air. Raises ``SensorLinkLost`` when not connected."""
        if not self._connected:
            raise SensorLinkLost("air sensor: the simulated link is not open; connect first")
        return AirReading(
            time_s=self._plant.clock_s,
            temperature_c=self._plant.air_c,
            pressure_hpa=_PRESSURE_HPA,
            humidity_percent=_HUMIDITY_PERCENT,
        )

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        self._connected = False
