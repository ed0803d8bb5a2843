"""The kind ``line`` of arms: what a profile says of it. Loading a profile imports this module, so it stays light."""

from __future__ import annotations

import socket
from typing import Annotated, Literal

from pydantic import Field

from drivers.arms.protocol import Arm
from drivers.arms.settings import ArmContext, ArmSettings
from drivers.findings import Finding


class LineSettings(ArmSettings):
    """An arm whose controller takes and sends lines of text over TCP.

    ``moves_hardware`` stays as it is: a motion of this arm is asked for, or allowed with ``--allow-motion``.
    """

    kind: Literal["line"] = "line"
    host: str
    port: Annotated[int, Field(ge=1, le=65535)]

    @property
    def controller_address(self) -> str:
        """Two arms with the same controller are a mistake that the doctor reports."""
        return f"{self.host}:{self.port}"

    def open(self, arm: ArmContext) -> Arm:
        """Return the driver, not connected yet."""
        from .line_arm import LineArm

        return LineArm(arm, self.host, self.port)

    def probe(self, arm: ArmContext, patience_s: float) -> list[Finding]:
        """Check whether the controller answers; nothing moves."""
        try:
            socket.create_connection((self.host, self.port), patience_s).close()
        except OSError as error:
            text = f"{self.controller_address} does not answer ({error}); check power, cable and address"
            return [Finding("", "failed", text)]
        return [Finding("", "ok", f"the controller at {self.controller_address} answers")]
