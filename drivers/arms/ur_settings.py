"""The kind ``ur``: an arm with a controller of Universal Robots."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from itertools import islice
from typing import TYPE_CHECKING

from drivers.arms.protocol import Arm, ArmError, LinkLost
from drivers.arms.settings import ArmContext
from drivers.arms.ur_options import UrOptions
from drivers.findings import Finding
from drivers.patience import Patience
from drivers.settings import SettingError

if TYPE_CHECKING:
    from drivers.arms.ur_checks import UrExpectation


_PROGRAM_WITHIN_S = 2.0
_EXCERPT = 50
"""Number of states in an excerpt: 0.1 s of an e-Series controller, 0.4 s of a CB3."""
_LONGEST_S = 5.0
"""A controller that is silent for this long [s] counts as dead, even if the profile allows it more time."""
_SAFETY_LIMITS = (
    "not asked: planes and other limits of the safety configuration are known to a running program only; before the"
    " first motion the controller is asked about every planned stop"
)


class UrSettings(UrOptions):
    """The options of a UR arm, and how it is opened and probed."""

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
            simulation=arm.simulation,
        )

    def open(self, arm: ArmContext) -> Arm:
        """Return the driver, not connected yet. Raises ``SettingError``."""
        from drivers.arms.ur import UrArm

        return UrArm(arm.name, self, self.expectation(arm), user=arm.user)

    def probe(self, arm: ArmContext, patience_s: float) -> list[Finding]:
        """Query the controller over plain sockets and compare its answers with the profile."""
        from drivers.arms import ur_checks, ur_probe
        from drivers.arms.ur_links import RTDE_PORT, Connection
        from drivers.arms.ur_rtde_reader import inputs_taken

        try:
            answers = ur_probe.probe_ur(self.host, min(self.timeout, patience_s))
        except ArmError as error:
            return [Finding("link", "failed", str(error))]
        try:
            found = ur_checks.checks(self.expectation(arm), answers)
        except SettingError as error:
            return [Finding("type", "failed", f"arms.{arm.name}.{error}")]
        patience = Patience(min(self.timeout, patience_s))
        if answers.ports.get(RTDE_PORT):
            with suppress(LinkLost), Connection.to(self.host, RTDE_PORT, patience) as rtde:
                found.append(ur_checks.inputs(inputs_taken(rtde, patience)))
        where = f"{answers.series} controller at {answers.host}, PolyScope {answers.software}"
        failed = ", ".join(check.subject for check in found if check.status == "failed")
        motion = Finding("motion", "ok", "no check failed; no motion was tried")
        if failed:
            motion = Finding("motion", "failed", f"would be refused because of {failed}; no motion was tried")
        checked = [Finding(check.subject, check.status, check.text) for check in found]
        link = Finding("link", "ok", where, answers.report())
        return [link, *checked, Finding("safety limits", "ok", _SAFETY_LIMITS), motion]

    def link(self, arm: ArmContext, look: Callable[[], None]) -> list[Finding]:
        """Compare round trips and silences of 2 s with the watchdog's period; twice if they exceed it."""
        from drivers.arms import ur_probe
        from drivers.arms.ur_motion import KICKED_AFTER

        period_s, timeout_s = 1.0 / self.watchdog_hz, min(self.timeout, _LONGEST_S)
        try:
            late_s, figures = ur_probe.time_link(self.host, timeout_s, look)
            if late_s > (1.0 - KICKED_AFTER) * period_s:  # once, this computer may be the cause
                late_s, figures = ur_probe.time_link(self.host, timeout_s, look)
        except ArmError as error:
            return [Finding("timing", "failed", str(error))]
        if late_s <= (1.0 - KICKED_AFTER) * period_s:
            return [Finding("timing", "ok", figures)]
        hertz = int(10.0 * (1.0 - KICKED_AFTER) / late_s) / 10.0
        way = f"or set arms.{arm.name}.driver.watchdog_hz to {hertz:g}" if hertz >= 1.0 else "no setting helps"
        text = (
            f"{figures}: too slow for the watchdog, which stops the arm after {period_s:.2f} s of silence; see to"
            f" the network and close other programs on this computer; {way}"
        )
        return [Finding("timing", "failed", text)]

    def left_program(self) -> str:
        """Return which cellapp started the program that runs on the controller; empty if none did."""
        from drivers.arms.ur_links import other_user, running_program

        return other_user(running_program(self.host, _PROGRAM_WITHIN_S))

    def end_program(self) -> None:
        """End the program that runs on the controller, whoever started it. Raises ``LinkLost``."""
        from drivers.arms.ur_links import stop_program

        stop_program(self.host, _PROGRAM_WITHIN_S)

    def excerpt(self, patience_s: float) -> list[dict[str, object]]:
        """Return the next states over RTDE; if the controller stops sending, fewer ones, and the reason at the end."""
        from drivers.arms.ur_links import RTDE_PORT, Connection
        from drivers.arms.ur_rtde_reader import samples

        patience, found = Patience(min(self.timeout, patience_s)), list[dict[str, object]]()
        began_s = time.monotonic()
        try:
            with Connection.to(self.host, RTDE_PORT, patience) as link:
                for sample in islice(samples(link, patience), _EXCERPT):
                    found.append({"received_s": round(time.monotonic() - began_s, 6), **asdict(sample)})
        except ArmError as error:
            found.append({"received_s": round(time.monotonic() - began_s, 6), "error": str(error)})
        return found
