"""Profile options of an arm of the kind ``ur``: all settings that its driver reads."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.arms.settings import ArmSettings, EmulatedController, Package
from drivers.quantities import Angle, AngularSpeed, ArmLength, Mass, Time, Turn
from drivers.settings import loopback_ipv4


class UrOptions(ArmSettings):
    """A UR controller. ``serial``, ``tcp`` and ``checksum``, where given, are checked before the first motion."""

    kind: Literal["ur"] = "ur"
    packages: ClassVar[tuple[Package, ...]] = (Package("ur-rtde", ("rtde_control", "rtde_receive"), "UR arms"),)

    host: str
    serial: str | None = None
    timeout: Annotated[Time, Field(gt=0.0, le=60.0)] = 5.0
    """A controller that is silent for this long counts as dead (5 s at most)."""
    startup_timeout: Annotated[Time, Field(ge=1.0, le=120.0)] = 15.0
    """Time for the client to connect and its program to start on the controller."""
    watchdog_hz: Annotated[float, Field(strict=True, ge=1.0, le=25.0)] = 5.0
    """The controller stops its program when this computer is silent for the inverse of this rate."""
    tcp: tuple[ArmLength, ArmLength, ArmLength, Turn, Turn, Turn] | None = None
    """Tool centre point set on the controller: position and rotation vector, as the pendant shows them."""
    checksum: str | None = None
    """Checksum of the controller's calibrated D-H at the last calibration, as ``doctor`` shows it; a change warns."""
    payload_tolerance: Annotated[Mass, Field(gt=0.0, le=10.0)] = 0.05
    payload_center_tolerance: Annotated[ArmLength, Field(gt=0.0, le=0.5)] = 0.01
    settle_time: Annotated[Time, Field(ge=0.02, le=60.0)] = 0.2
    """The arm is at rest if for this time no joint exceeded ``settle_speed`` or left ``settle_window``."""
    settle_speed: Annotated[AngularSpeed, Field(gt=0.0, le=0.1)] = 0.005
    settle_window: Annotated[Angle, Field(gt=0.0, le=0.01)] = 2e-4

    servo_lookahead: Annotated[Time, Field(ge=0.03, le=0.2)] = 0.03
    """Look-ahead time of ``servoj`` on paths. They are smooth already: a longer one only adds lag."""
    servo_gain: Annotated[float, Field(strict=True, ge=100.0, le=2000.0)] = 300.0
    """Gain of ``servoj`` on paths; a higher one lags less and may shake the arm."""

    @property
    def controller_address(self) -> str:
        """The host, as written."""
        return self.host

    def emulated_controller(self) -> EmulatedController | None:
        """Return the loopback address of the controller; None if it is on another machine."""
        host = loopback_ipv4(self.host)
        return None if host is None else EmulatedController(host, self.serial)
