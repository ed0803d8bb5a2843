"""Result of ``tracker-bridge``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class TrackerBridgeResult(Result):
    """``tracker-bridge``: which kind of tracker is served, where, and whether a token guards it."""

    schema_: Literal["cellapp-tracker-bridge"] = "cellapp-tracker-bridge"
    version: Literal[1] = 1
    kind: str
    host: str
    port: int | None
    serial: str | None
    guarded: bool
