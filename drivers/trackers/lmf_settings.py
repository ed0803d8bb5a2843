"""Settings of the LMF driver and the accuracy of the tracker, which LMF does not report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

MEASURING_S: Mapping[str, float] = MappingProxyType({"fast": 2.0, "standard": 12.0, "precise": 12.0})
"""Time limits of a stationary measurement on the AT9x0 that Leica recommends, by accuracy [s]."""
_SIMULATOR = re.compile(r"(AT930|AT960|AT40[123]|AT500|ATS600)[A-Z]{0,3}Simulator(#\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class ErrorLaw:
    """Maximum permissible errors ``constant + proportional * distance`` [m, m/m], across the beam and along it.

    Half of a maximum permissible error is taken as one standard deviation: the maker calls half of it typical.
    """

    transverse: tuple[float, float] = (15e-6, 6e-6)
    range: tuple[float, float] = (10e-6, 0.3e-6)

    def covariance(self, p_M: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) [m^2] of a point (3,) [m] in the axes of M."""
        distance = float(np.linalg.norm(p_M))
        across = 0.5 * (self.transverse[0] + self.transverse[1] * distance)
        along = 0.5 * (self.range[0] + self.range[1] * distance)
        beam = np.outer(p_M, p_M) / distance**2
        return across**2 * (np.eye(3) - beam) + along**2 * beam


@dataclass(frozen=True)
class LmfSettings:
    """How the driver uses LMF.

    Attributes
    ----------
    address : str
        The tracker's IP address or host name, or a simulator of LMF such as ``AT960LRSimulator#1``.
    serial : str
        Required serial number of the tracker; empty: any.
    library : str
        Path of LMF.Tracker.Connection.dll, or its bare name if it is on Python's path.
    stationary : {"accuracy", "time"}
        What sets the averaging time: the accuracy profiles of the tracker, or ``averaging_s`` of each call.
    power_lock : bool
        Search with the camera; otherwise in a spiral around the prediction, which is slower and stays closer to it.
    search_radius_m : float or None
        Radius of a search [m]; None keeps LMF's.
    wrong_target_m : float
        Greatest accepted distance of an SMR from its prediction [m].
    shaking_m : float
        Precision reported by the tracker above which the SMR counts as moving [m].
    gravity : bool
        Level the tracker: M's z axis is vertical, and tilt is monitored. Otherwise M is fixed to the tracker.
    command_s : float
        Time limit of all commands without a limit by Leica, pointing and searching included [s].
    law : ErrorLaw
        Accuracy of the tracker; LMF reports no covariance.
    target_words : tuple of str
        Words in a precondition of LMF which say that no target is locked. Before pointing this is no obstacle.
    lost_numbers : tuple of int
        Error numbers of LMF that mean a lost target, if its state does not show it. Leica publishes no list; the
        default is from the log of another program.
    measuring_s : mapping of str to float
        Time limits by accuracy [s].
    """

    address: str
    serial: str = ""
    library: str = "LMF.Tracker.Connection"
    stationary: Literal["accuracy", "time"] = "accuracy"
    power_lock: bool = True
    search_radius_m: float | None = None
    wrong_target_m: float = 0.05
    shaking_m: float = 100e-6
    gravity: bool = False
    command_s: float = 15.0
    law: ErrorLaw = ErrorLaw()
    target_words: tuple[str, ...] = ("target", "reflector")
    lost_numbers: tuple[int, ...] = (840702,)
    measuring_s: Mapping[str, float] = field(default_factory=lambda: MEASURING_S)

    def __post_init__(self) -> None:
        if "simulator" in self.address.casefold() and _SIMULATOR.fullmatch(self.address) is None:
            raise ValueError(
                f"address: '{self.address}' is not a simulator of LMF; their names are like AT960LRSimulator or"
                " AT960Simulator#506432"
            )

    @property
    def simulated(self) -> bool:
        """Whether the address is one of LMF's simulators."""
        return _SIMULATOR.fullmatch(self.address) is not None
