"""The kind ``bridge``: a tracker served by ``cellapp tracker-bridge`` on another computer; see BRIDGE.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.findings import Finding
from drivers.quantities import Time
from drivers.settings import SettingError, loopback_ipv4
from drivers.trackers.settings import EmulatedBridge, TrackerContext, TrackerSettings, probed

if TYPE_CHECKING:
    from drivers.trackers.protocol import Tracker

_SOCKET_URL = re.compile(r"socket://(\[[0-9A-Fa-f:.]+\]|[^\s:/@?#\[\]]+):([0-9]{1,5})")
_SCHEMES = ("socket", "rfc2217", "spy", "alt", "hwgrep")
"""Schemes of pyserial that reach another computer or a device."""


class BridgeSettings(TrackerSettings):
    """A link to a tracker bridge.

    ``url`` is what pyserial takes: ``socket://host:port``, ``rfc2217://host:port``, ``/dev/ttyUSB0``, ``COM3``. The
    shared token is in the file ``token_file`` or in the environment variable ``token_env``, never in the profile.
    """

    kind: Literal["bridge"] = "bridge"
    can_be_served: ClassVar[bool] = False

    url: Annotated[str, Field(min_length=1)]
    baud: Annotated[int, Field(strict=True, ge=300, le=4_000_000)] = 115200
    token_file: str | None = None
    token_env: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=100)] | None = None
    timeout: Annotated[Time, Field(ge=2.0, le=60.0)] = 5.0
    """A bridge that is silent for this long counts as dead; while it works it reports each 0.2 s."""
    reflector: Annotated[str, Field(max_length=60)] = ""
    """The reflector type as the tracker's software names it; empty: what is selected there."""
    accuracy: Literal["fast", "standard", "precise"] = "standard"

    @field_validator("url")
    @classmethod
    def _known_scheme(cls, value: str) -> str:
        scheme, found, _ = value.partition("://")
        if found and scheme not in _SCHEMES:
            raise ValueError(f"pyserial has no {scheme}; write socket://host:port, rfc2217://host:port, or a device")
        if scheme == "socket" and found:
            match = _SOCKET_URL.fullmatch(value)
            if match is None or not 0 < int(match.group(2)) < 65536:
                raise ValueError("expected socket://host:port, as socket://192.168.0.20:50960")
        return value

    @field_validator("token_file")
    @classmethod
    def _absolute_path(cls, value: str | None) -> str | None:
        if value is not None and not (value.startswith("~") or Path(value).is_absolute()):
            raise ValueError(
                "write an absolute path, or one that begins with ~: a run stores the profile, not its folder"
            )
        return value

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        if self.token_file is not None and self.token_env is not None:
            raise ValueError("token_env: token_file gives the token already; keep one of them")
        return self

    def emulated_bridge(self) -> EmulatedBridge | None:
        """Return the loopback address of the URL; None for another machine or a serial port."""
        match = _SOCKET_URL.fullmatch(self.url)
        host = None if match is None else loopback_ipv4(match.group(1))
        return None if match is None or host is None else EmulatedBridge(host, int(match.group(2)))

    def token(self) -> str | None:
        """Read the token. Raises ``SettingError``."""
        from drivers.trackers.bridge_token import read_token

        return read_token(self.token_file, self.token_env)

    def open(self, tracker: TrackerContext) -> Tracker:
        """Create the driver, not connected yet; it prepares the tracker at every connect. Raises ``SettingError``."""
        from drivers.trackers.bridge import BridgeTracker
        from drivers.trackers.protocol import Preparation

        return BridgeTracker(
            self.url,
            token=self.token(),
            timeout_s=self.timeout,
            baud=self.baud,
            preparation=Preparation(self.reflector, self.accuracy),
        )

    def probe(self, tracker: TrackerContext, patience_s: float) -> list[Finding]:
        """Query the tracker behind the bridge."""
        from drivers.trackers.bridge import BridgeTracker
        from drivers.trackers.protocol import TrackerError

        timeout_s, baud = min(self.timeout, patience_s), self.baud
        try:
            device = BridgeTracker(self.url, token=self.token(), timeout_s=timeout_s, baud=baud, patience_s=patience_s)
            return probed(device, f", behind the bridge at {self.url}")
        except (SettingError, TrackerError) as error:
            return [Finding("", "failed", str(error))]
