"""The kind ``simulated``: the weather station of the simulated cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from drivers.findings import Finding
from drivers.sensors.settings import AirSensorSettings
from drivers.settings import simulated_cell

if TYPE_CHECKING:
    from drivers.plant import Plant
    from drivers.sensors.protocol import AirSensor


class SimulatedAirSensorSettings(AirSensorSettings):
    """The weather station of the simulated cell."""

    kind: Literal["simulated"] = "simulated"
    needs_plant: ClassVar[bool] = True

    def open(self, plant: Plant | None) -> AirSensor:
        """Return the station of the plant."""
        from drivers.sensors.simulated import SimulatedAirSensor

        return SimulatedAirSensor(simulated_cell(plant))

    def probe(self) -> list[Finding]:
        """Report that there is nothing to check."""
        return [Finding("", "ok", "simulated; no hardware is touched")]
