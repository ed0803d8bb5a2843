"""The kind ``none`` of arms and trackers: no device; the readings come from a file."""

from __future__ import annotations

from typing import ClassVar, Literal, NoReturn

from drivers.arms.settings import ArmSettings
from drivers.findings import Finding
from drivers.settings import SettingError
from drivers.trackers.settings import TrackerSettings


class NoDriver(ArmSettings, TrackerSettings):
    """No device: the readings come from a file."""

    kind: Literal["none"] = "none"
    has_device: ClassVar[bool] = False
    can_be_served: ClassVar[bool] = False

    def emulated_controller(self) -> None:
        """Return None: there is nothing to replace."""

    def open(self, context: object) -> NoReturn:
        """Raise ``SettingError``."""
        raise SettingError(
            "driver: 'none' has no device; readings of this profile come from 'cellapp import PROFILE CSV --run NEW'"
        )

    def probe(self, context: object, patience_s: float) -> list[Finding]:
        """Report that there is nothing to check."""
        return [Finding("", "ok", "no device: readings come from a file")]
