"""The verb ``tracker-bridge``: serve a profile's tracker to a cell PC, over TCP or a serial port."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.cell.driving.cell import build_plant, tracker_driver
from cellapp.cell.profile import load_profile
from cellapp.commands.record import Asked, ProfilePath, Request, Verb, View, Work
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken
from cellapp.ground.results import Result
from drivers.settings import SettingError
from drivers.trackers.bridge_server import TrackerService, is_loopback
from drivers.trackers.bridge_token import read_token
from drivers.trackers.bridge_wire import DEFAULT_PORT
from drivers.trackers.registry import TRACKERS


class TrackerBridgeRequest(Request):
    """Serve the tracker that this computer is wired to, to the cell PC, until interrupted."""

    profile: ProfilePath
    host: Annotated[str, Asked("Address to listen on; one that other machines reach needs a token.")] = "127.0.0.1"
    port: Annotated[int | None, Field(ge=0, le=65535), Asked("TCP port; else 50960, or none beside --serial.")] = None
    serial: Annotated[str | None, Asked("A serial port to serve, as COM3 or /dev/ttyUSB0.", "PORT")] = None
    baud: Annotated[int, Field(ge=300), Asked("Of the serial port.")] = 115200
    token_file: Annotated[Path | None, Asked("The shared token; only you may read the file.", "FILE")] = None
    token_env: Annotated[str | None, Asked("Environment variable that holds the token.", "NAME")] = None

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        """Refuse two sources of the token."""
        if self.token_file is not None and self.token_env is not None:
            raise ValueError("give --token-file or --token-env, not both")
        return self


VERB = Verb("tracker-bridge", TrackerBridgeRequest, chapter="cell")


class TrackerBridgeResult(Result, schema="cellapp-tracker-bridge"):
    """``tracker-bridge``: which kind of tracker is served, where, and whether a token guards it."""

    kind: str
    host: str
    port: int | None
    serial: str | None
    guarded: bool


_STEP_S = 0.2
"""Longest time until a cancel, such as Ctrl-C, is noticed."""


def run(request: TrackerBridgeRequest, work: Work) -> TrackerBridgeResult:
    """Serve the tracker until the work is stopped; announce the address when it listens."""
    return serve_tracker(load_profile(request.profile), request, work.control, work.announce)


def serve_tracker(
    profile: Profile, request: TrackerBridgeRequest, job: JobToken, announce: Callable[[TrackerBridgeResult], None]
) -> TrackerBridgeResult:
    """Serve the profile's tracker until ``cancel``; all ports are free on return.

    ``announce`` is called once, when the service listens. The tracker connects when a client first needs it.

    Raises
    ------
    InputError
        If the profile has no tracker that can be served, or a needed token is missing.
    HardwareError
        If the address is in use or not available.
    """
    settings = profile.tracker.driver
    port = DEFAULT_PORT if request.port is None and request.serial is None else request.port
    _check_kind(profile)
    token = _token(request.token_file, request.token_env)
    _check_ports(request.host, port, guarded=token is not None)
    tracker = tracker_driver(profile, build_plant(profile) if settings.needs_plant else None)
    service = TrackerService(
        tracker, host=request.host, port=port, serial_url=request.serial, baud=request.baud, token=token
    )
    try:
        service.open()
    except OSError as error:
        raise HardwareError(f"tracker-bridge: {error.strerror}; see whether another one runs here") from error
    try:
        served = TrackerBridgeResult(
            kind=settings.kind, host=service.host, port=service.port, serial=request.serial, guarded=token is not None
        )
        announce(served)
        while not job.cancelled:
            service.poll(_STEP_S)
        return served
    finally:
        service.close()


def _check_kind(profile: Profile) -> None:
    settings = profile.tracker.driver
    if not settings.can_be_served:
        kinds = " or ".join(f"'{kind}'" for kind, one in TRACKERS.items() if one.can_be_served)
        raise InputError(
            f"profile {profile.name}: tracker.driver is '{settings.kind}'; to be served it must be one that this"
            f" computer reaches itself: {kinds}"
        )


def _check_ports(host: str, port: int | None, *, guarded: bool) -> None:
    if not guarded and port is not None and not is_loopback(host):
        raise InputError(
            f"tracker-bridge: {host} is reachable from other machines: give a token (--token-file or --token-env), the"
            " same here and on the cell PC, or listen on 127.0.0.1"
        )


def _token(token_file: Path | None, token_env: str | None) -> str | None:
    try:
        return read_token(None if token_file is None else str(token_file), token_env)
    except SettingError as error:
        raise InputError(str(error)) from error


def view(result: TrackerBridgeResult, request: Request | None = None) -> View:
    """Show where the tracker is served."""
    places = [f"{result.host} port {result.port}"] if result.port is not None else []
    places += [result.serial] if result.serial is not None else []
    guard = "with a token" if result.guarded else "without a token"
    return View((f"tracker ({result.kind}) at {' and '.join(places)}, {guard}", "Ctrl-C ends this"))
