"""Running estimates while stops are measured: air temperature, and the model refitted after each stop."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.cell.driving.suspicions import Suspicions
from cellapp.estimation.calibration.online import OnlineFit, online_fit
from cellapp.estimation.calibration.online_model import Residuals
from cellapp.estimation.readings import Reading, Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import AirReport, StopReport, Suspicion
from cellapp.robot.kinematics.transforms import Array
from drivers.sensors.protocol import AirReading, AirSensor, SensorError

Note = Callable[[str, str], None]
"""Callback with a log level ("info", "warning") and a sentence."""


@dataclass
class AirTemperature:
    """Air temperature from the weather station; None while the station fails, which is noted once.

    The tracker's own sensor is no substitute: a change of sensor would look like a change of the air. ``heard`` is
    called with every reading.
    """

    sensor: AirSensor
    note: Note
    heard: Callable[[AirReport], None]
    state: Literal["new", "working", "failed"] = "new"

    def at_stop(self, stop: int) -> float | None:
        """Read the air temperature [degC]; None if the station fails."""
        reading = self._read(stop)
        return None if reading is None else reading.temperature_c

    def _read(self, stop: int) -> AirReading | None:
        try:
            reading = self.sensor.read()
        except SensorError as error:
            if self.state != "failed":
                self.note("warning", f"stop {stop + 1}: readings go without air temperature: {error}")
            self.state = "failed"
            return None
        if self.state != "working":
            self.note("info", f"stop {stop + 1}: {reading}")
        self.state = "working"
        self.heard(AirReport(reading.temperature_c, reading.pressure_hpa, reading.humidity_percent))
        return reading


class LiveModel:
    """Models of all arms, refitted after each stop. An arm whose model cannot be fitted is measured without one."""

    def __init__(
        self, profile: Profile, planned: Mapping[str, Array], stored: Mapping[str, Readings], note: Note
    ) -> None:
        """Start with the ``stored`` readings; ``planned`` has the joint positions (n, N) [rad] of all stops by arm."""
        self._finish = profile.collection.finish
        self._note = note
        self._fits: dict[str, OnlineFit] = {}
        self._latest: dict[str, StopReport] = {}
        for name, q in planned.items():
            try:
                self._fits[name] = online_fit(profile, name, q)
                if name in stored:
                    self._add_stored(name, stored[name])
            except (InputError, np.linalg.LinAlgError) as error:
                self._drop(name, error)
        normals = {name: np.array(arm.smr.normal) / math.hypot(*arm.smr.normal) for name, arm in profile.arms.items()}
        self._suspicions = Suspicions(normals)

    def _add_stored(self, name: str, stored: Readings) -> None:
        report = self._fits[name].add_all(stored.configuration.tolist(), stored.q, stored.p_M, stored.covariance_M)
        if report is not None:
            self._latest[name] = report

    def add(self, stop: int, rows: Mapping[str, Reading]) -> list[StopReport | Suspicion]:
        """Refit with the readings of a stop; return a report for each arm with a model, and suspicions."""
        found: list[StopReport | Suspicion] = []
        innovations = {}
        for name, reading in rows.items():
            fit = self._fits.get(name)
            if fit is None:
                continue
            try:
                report = fit.add(stop, reading.q, reading.p_M, reading.covariance_M)
            except np.linalg.LinAlgError as error:
                self._drop(name, error)
                continue
            innovations[name] = fit.innovation
            if report is not None:
                self._latest[name] = report
                found.append(report)
        return [*found, *self._suspicions.at_stop(stop, innovations)]

    def forget_suspicions(self) -> None:
        """Reset the suspicions after a person has inspected the cell."""
        self._suspicions.forget()

    @property
    def standard_error_mm(self) -> dict[str, float]:
        """Standard uncertainty [mm] of a predicted SMR position due to the parameters, by arm with a model."""
        return {name: report.standard_error_mm for name, report in self._latest.items()}

    def residuals(self) -> dict[str, Residuals]:
        """Return the residuals of all readings in order of arrival, by arm with a model."""
        found = {name: fit.residuals() for name, fit in self._fits.items()}
        return {name: one for name, one in found.items() if one is not None}

    def lengths_m(self, name: str, readings: Readings) -> list[float | None]:
        """Return the residual lengths [m] of readings that were not used in the fit; None without a model."""
        fit = self._fits.get(name)
        lengths = None if fit is None or not len(readings) else fit.lengths_m(readings.q, readings.p_M)
        return [None] * len(readings) if lengths is None else list(lengths.tolist())

    def accurate_enough(self, stops_done: int) -> bool:
        """Return whether every arm has the requested standard error, after the minimum number of stops."""
        asked = self._finish.standard_error
        if asked is None or stops_done < self._finish.least_stops or set(self._latest) != set(self._fits):
            return False
        return bool(self._fits) and all(error <= asked * 1e3 for error in self.standard_error_mm.values())

    def _drop(self, name: str, error: Exception) -> None:
        self._fits.pop(name, None)
        self._latest.pop(name, None)
        self._note("info", f"arm {name}: measured without a running model: {error}")
