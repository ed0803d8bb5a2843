"""What ``tracker-bridge`` serves, as sentences."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.tracker_bridge.result import TrackerBridgeResult


def view(result: TrackerBridgeResult, request: Request | None = None) -> View:
    """Show where the tracker is served."""
    places = [f"{result.host} port {result.port}"] if result.port is not None else []
    places += [result.serial] if result.serial is not None else []
    guard = "with a token" if result.guarded else "without a token, for this machine alone"
    if result.serial is not None and not result.guarded:
        guard = "without a token"
    return View((f"tracker ({result.kind}) at {' and '.join(places)}, {guard}", "Ctrl-C ends this"))
