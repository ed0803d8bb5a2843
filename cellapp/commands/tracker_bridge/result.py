"""Result of ``tracker-bridge``."""

from __future__ import annotations

from cellapp.ground.results import Result


class TrackerBridgeResult(Result, schema="cellapp-tracker-bridge"):
    """``tracker-bridge``: which kind of tracker is served, where, and whether a token guards it."""

    kind: str
    host: str
    port: int | None
    serial: str | None
    guarded: bool
