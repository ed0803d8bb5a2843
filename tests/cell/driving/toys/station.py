"""The kind ``toy`` of weather stations: the temperature is a setting."""

from __future__ import annotations

from typing import Literal

from drivers.findings import Finding
from drivers.plant import Plant
from drivers.quantities import Temperature
from drivers.sensors.protocol import AirReading
from drivers.sensors.settings import AirSensorSettings


class ToyStationSettings(AirSensorSettings):
    """A station in front of a window that is always shut."""

    kind: Literal["toy"] = "toy"
    temperature: Temperature

    def open(self, plant: Plant | None) -> ToyStation:
        """Return the driver."""
        return ToyStation(self.temperature)

    def probe(self) -> list[Finding]:
        """Report the temperature."""
        return [Finding("", "ok", str(self.open(None).read()))]


class ToyStation:
    """Always reads the same."""

    def __init__(self, temperature_c: float) -> None:
        self._temperature_c = temperature_c

    def connect(self) -> None: ...

    def disconnect(self) -> None: ...

    def read(self) -> AirReading:
        return AirReading(0.0, self._temperature_c, None, None)
