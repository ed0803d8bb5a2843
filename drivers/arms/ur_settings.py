"""The kind ``ur``: an arm with a controller of Universal Robots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from drivers.arms.protocol import Arm, ArmError
from drivers.arms.settings import ArmContext, ArmSettings, EmulatedController, Package
from drivers.findings import Finding
from drivers.quantities import Angle, AngularSpeed, ArmLength, Mass, Time, Turn
from drivers.settings import SettingError, loopback_ipv4

if TYPE_CHECKING:
    from drivers.arms.ur_checks import UrExpectation


_SAFETY_LIMITS = (
    "not asked: planes and other limits of the safety configuration are known to a running program only; before the"
    " first motion the controller is asked about every planned stop"
)


class UrSettings(ArmSettings):
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

    repeatable_probe: ClassVar[bool] = True

    def emulated_controller(self) -> EmulatedController | None:
        """Return the loopback address of the controller; None if it is on another machine."""
        host = loopback_ipv4(self.host)
        return None if host is None else EmulatedController(host, self.serial)

    def expectation(self, arm: ArmContext) -> UrExpectation:
        """Return what the controller must report before the arm may move.

        Raises
        ------
        SettingError
            If the arm type does not have six joints.
        """
        import numpy as np

        from drivers.arms.ur_checks import JOINTS, UrExpectation

        if arm.joints != JOINTS:
            raise SettingError(f"type: {arm.model} has {arm.joints} joints, a UR arm has {JOINTS}")
        return UrExpectation(
            model=arm.model,
            serial=self.serial,
            checksum=self.checksum,
            limits=arm.limits,
            payload_kg=arm.payload_kg,
            payload_center_m=arm.payload_center_m,
            tcp=None if self.tcp is None else np.array(self.tcp),
            payload_slack_kg=self.payload_tolerance,
            payload_slack_m=self.payload_center_tolerance,
        )

    def open(self, arm: ArmContext) -> Arm:
        """Return the driver, not connected yet. Raises ``SettingError``."""
        from drivers.arms.ur_path import UrPathArm

        return UrPathArm(arm.name, self, self.expectation(arm))

    def probe(self, arm: ArmContext, patience_s: float) -> list[Finding]:
        """Query the controller over plain sockets and compare its answers with the profile."""
        from drivers.arms import ur_checks, ur_probe

        try:
            answers = ur_probe.probe_ur(self.host, min(self.timeout, patience_s))
        except ArmError as error:
            return [Finding("link", "failed", str(error))]
        try:
            found = ur_checks.checks(self.expectation(arm), answers)
        except SettingError as error:
            return [Finding("type", "failed", f"arms.{arm.name}.{error}")]
        where = f"{answers.series} controller at {answers.host}, PolyScope {answers.software}"
        failed = ", ".join(check.subject for check in found if check.status == "failed")
        motion = Finding("motion", "ok", "no check failed; no motion was tried")
        if failed:
            motion = Finding("motion", "failed", f"would be refused because of {failed}; no motion was tried")
        checked = [Finding(check.subject, check.status, check.text) for check in found]
        link = Finding("link", "ok", where, answers.report())
        return [link, *checked, Finding("safety limits", "ok", _SAFETY_LIMITS), motion]
