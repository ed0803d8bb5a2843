"""Identity and configuration of an emulated controller: series, software, arm, kinematics, limits of the drives."""

from __future__ import annotations

import ipaddress
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drivers.emulators.ur_controller.motion import Braking

Series = Literal["CB3", "e-Series", "PolyScope X"]
PortName = Literal["dashboard", "primary", "script", "rtde"]
Rows = tuple[tuple[float, float, float, float], ...]

STANDARD_PORTS: Mapping[PortName, int] = {"dashboard": 29999, "primary": 30001, "script": 30003, "rtde": 30004}
FREE_PORTS: Mapping[PortName, int] = dict.fromkeys(STANDARD_PORTS, 0)

_SOFTWARE = {  # the format matters, the dates do not
    "CB3": ((3, 15, 8, 106339), "Jun 20 2022"),
    "e-Series": ((5, 11, 1, 1108318), "Nov 11 2021"),
    "PolyScope X": ((10, 7, 0, 1), "Nov 11 2024"),
}
_RATE_HZ = {"CB3": 125.0, "e-Series": 500.0, "PolyScope X": 500.0}


def _rows(d: tuple[float, ...], a2: float, a3: float) -> Rows:
    """Return nominal rows theta, d, a, alpha of a UR arm: the twists are the same for all of them."""
    a = (0.0, a2, a3, 0.0, 0.0, 0.0)
    alpha = (math.pi / 2.0, 0.0, 0.0, math.pi / 2.0, -math.pi / 2.0, 0.0)
    return tuple((0.0, d[i], a[i], alpha[i]) for i in range(6))


_PUBLISHED: dict[tuple[str, str], Rows] = {
    ("CB3", "UR5"): _rows((0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823), -0.425, -0.39225),
    ("CB3", "UR10"): _rows((0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922), -0.612, -0.5723),
    ("e-Series", "UR5"): _rows((0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), -0.425, -0.3922),
    ("e-Series", "UR10"): _rows((0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), -0.6127, -0.57155),
}


@dataclass(frozen=True)
class Personality:
    """Identity of the emulated controller.

    Attributes
    ----------
    model : str
        As reported by controllers: "UR10" in both series.
    serial : str
        Digits.
    rows : tuple
        D-H rows theta, d, a, alpha of the six joints [rad, m, m, rad] that the controller uses.
    checksums, calibration_status : tuple of int, int
        As in the kinematics information; the defaults mean: no calibration.
    """

    series: Series
    model: str
    serial: str
    rows: Rows
    checksums: tuple[int, ...] = (0xFFFFFFFF,) * 6
    calibration_status: int = 0

    def __post_init__(self) -> None:
        if len(self.rows) != 6 or len(self.checksums) != 6:
            raise ValueError(f"a UR arm has six joints; got {len(self.rows)} rows and {len(self.checksums)} checksums")

    @property
    def version(self) -> tuple[int, int, int, int]:
        """Major, minor, bugfix, build of the controller's software."""
        return _SOFTWARE[self.series][0]

    @property
    def software(self) -> str:
        """The answer to ``PolyscopeVersion``."""
        version, date = _SOFTWARE[self.series]
        return f"URSoftware {'.'.join(map(str, version))} ({date})"

    @property
    def rate_hz(self) -> float:
        """Control rate, which is also the highest rate of RTDE [Hz]."""
        return _RATE_HZ[self.series]


def personality(series: Series, model: str, serial: str) -> Personality:
    """Return a UR5 or UR10 with published kinematics. Raises ``ValueError`` for other models."""
    rows = _PUBLISHED.get((series, model))
    if rows is None:
        known = sorted({name for _, name in _PUBLISHED})
        raise ValueError(f"no published D-H for '{model}' of series {series} here; known are {', '.join(known)}")
    return Personality(series=series, model=model, serial=serial, rows=rows)


@dataclass(frozen=True)
class ControllerConfig:
    """One controller: identity, addresses, limits of the drives, initial state.

    Attributes
    ----------
    name : str
        Name of the arm, in the plant and on the control channel.
    host : str
        IPv4 address to listen on; other than loopback only with ``beyond_loopback``.
    ports : mapping
        Ports of dashboard, primary, script and rtde; 0 takes a free one. The ur_rtde client knows only standard ones.
    limits, speed, acceleration : tuples of 6
        Joint ranges [rad] and limits of each joint [rad/s, rad/s^2]; faster commands are executed at these.
    home : tuple of 6
        Initial joint angles without a plant [rad].
    robot_mode : str
        Initial mode: "RUNNING" or "POWER_OFF".
    remote_control : bool
        Whether commands over the network are accepted; CB3 has no such switch and always accepts them.
    simulation : bool
        Whether its primary interface reports that the real robot is not enabled, as in simulation mode.
    payload_mass, payload_center, tcp : float, tuple of 3, tuple of 6
        Settings of the controller's installation [kg, m; m and rotation vector in rad].
    boot_s, brake_release_s, unlock_after_s : float
        Cell time: power on to idle, idle to running, protective stop to the earliest unlocking [s].
    start_delay_s : float
        Wall time from an uploaded program to its start [s].
    braking : Braking
        Latency and deceleration of stops.
    """

    name: str
    host: str
    personality: Personality
    ports: Mapping[PortName, int] = field(default_factory=lambda: dict(STANDARD_PORTS))
    limits: tuple[tuple[float, float], ...] = ((-2.0 * math.pi, 2.0 * math.pi),) * 6
    speed: tuple[float, ...] = (math.pi,) * 6
    acceleration: tuple[float, ...] = (10.0,) * 6
    home: tuple[float, ...] = (0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0)
    robot_mode: Literal["RUNNING", "POWER_OFF"] = "RUNNING"
    remote_control: bool = True
    simulation: bool = False
    payload_mass: float = 0.0
    payload_center: tuple[float, ...] = (0.0, 0.0, 0.0)
    tcp: tuple[float, ...] = (0.0,) * 6
    boot_s: float = 4.0
    brake_release_s: float = 1.5
    unlock_after_s: float = 5.0
    start_delay_s: float = 0.05
    braking: Braking = field(default_factory=Braking)
    beyond_loopback: bool = False

    def __post_init__(self) -> None:
        if set(self.ports) != set(STANDARD_PORTS):
            raise ValueError(f"arm {self.name}: ports are {', '.join(STANDARD_PORTS)}; got {', '.join(self.ports)}")
        for name in ("limits", "speed", "acceleration", "home", "payload_center", "tcp"):
            count, expected = len(getattr(self, name)), 3 if name == "payload_center" else 6
            if count != expected:
                raise ValueError(f"arm {self.name}: {name} has {count} entries, expected {expected}")
        if not (self.beyond_loopback or ipaddress.IPv4Address(self.host).is_loopback):
            raise ValueError(
                f"arm {self.name}: {self.host} is not a loopback address; an emulator open to the network needs"
                " beyond_loopback"
            )
