"""Result of ``doctor``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import field_serializer

from cellapp.cell.driving.records import ControllerCalibration
from cellapp.ground.results import Record, Result
from drivers.findings import Finding


class ProfileValue(Record):
    """A value of the profile in force, as JSON, and its ``origin``: file and line, or "default"."""

    key: str
    value: str
    origin: str


class DoctorResult(Result, schema="cellapp-doctor"):
    """``doctor``: what was checked."""

    findings: tuple[Finding, ...]
    controllers: Mapping[str, ControllerCalibration] | None = None
    """Arm -> calibration that its controller reports; None if none does."""
    written: tuple[Path, ...] | None = None
    profile: tuple[ProfileValue, ...] | None = None
    omitted_when_none = frozenset({"controllers", "written", "profile"})

    @field_serializer("findings")
    def _reported(self, findings: tuple[Finding, ...]) -> list[dict[str, Any]]:
        """Leave out what a device does not report."""
        return [asdict(one, dict_factory=lambda rows: {k: v for k, v in rows if v is not None}) for one in findings]

    @property
    def failed(self) -> tuple[Finding, ...]:
        """What would keep a job from starting."""
        return tuple(finding for finding in self.findings if finding.status == "failed")
