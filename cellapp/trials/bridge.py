"""Measurements over the tracker bridge with random faults: none may be lost, delivered twice or mixed up."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Literal

import numpy as np

from cellapp.collection.cell import build_plant
from cellapp.errors import HardwareError, InputError
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Result
from drivers.emulators.tracker_bridge import FAULTS, TrackerBridgeEmulator
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import Preparation, TargetLost, TrackerError, TrackerRefused

SECOND_CLIENT = "second-client"
ALL_FAULTS = (*FAULTS, SECOND_CLIENT)

_SILENCE_S = 0.3
"""Time without an answer after which the client reconnects: short, so that many faults fit into a trial."""
_AVERAGING_S = 1.0
_NEAR_M = 1e-3
"""A point within this distance belongs to the nest: nests are decimetres apart, noise is below 0.1 mm."""


class BridgeResult(Result):
    """``trials bridge``: what became of the measurements.

    Attributes
    ----------
    asked, delivered : int
        Requested and delivered measurements.
    lost, doubled, strange : int
        Measurements that were never delivered; that were delivered or made twice; that belong to another nest.
    faults : mapping
        Fault -> how often it was caused.
    recovery_s : mapping
        Fault -> longest time of a measurement with it [s].
    undisturbed_s : float or None
        Median time of a measurement without a fault [s].
    """

    schema_: Literal["cellapp-trials-bridge"] = "cellapp-trials-bridge"
    version: Literal[1] = 1
    asked: int
    delivered: int
    lost: int
    doubled: int
    strange: int
    faults: Mapping[str, int]
    recovery_s: Mapping[str, float]
    undisturbed_s: float | None


def bridge_trial(
    profile: Profile,
    measurements: int = 1000,
    every: int = 20,
    seed: int = 0,
    serial: tuple[str, str] | None = None,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> BridgeResult:
    """Measure nests through an emulated bridge over TCP, with a random fault in each group of ``every`` measurements.

    ``serial`` names the two ends of a serial cable, the bridge's and the client's, to go over that instead.

    Raises
    ------
    InputError
        If the profile has no simulated cell.
    HardwareError
        If the bridge cannot be connected at all.
    Cancelled
    """
    if measurements < every or every < 1:
        raise InputError("trials bridge: there must be at least one group of measurements, of at least one each")
    cancel = cancel or CancelToken()
    rng = np.random.default_rng([seed, 0xB41D])
    plant = build_plant(profile)
    nests = _nests(profile)
    names = list(nests)
    possible = np.array(ALL_FAULTS if serial is None else FAULTS)  # on one cable there is no second client
    kinds = rng.permutation(np.resize(possible, measurements // every))  # each kind about equally often
    fault_at = {group * every + int(rng.integers(every)): str(kind) for group, kind in enumerate(kinds)}
    took: dict[str, list[float]] = {kind: [] for kind in ("", *ALL_FAULTS)}
    times: list[float] = []
    strange = lost = 0
    with ExitStack() as stack:
        emulator = stack.enter_context(
            TrackerBridgeEmulator(
                plant,
                nests=nests,
                reboot_s=0.3,
                slow_s=1.6 * _SILENCE_S,
                port=0 if serial is None else None,
                serial_url=None if serial is None else serial[0],
            )
        )
        url = emulator.url if serial is None else serial[1]
        tracker = BridgeTracker(url, timeout_s=_SILENCE_S, preparation=Preparation())
        stack.callback(tracker.disconnect)
        try:
            tracker.connect()
        except TrackerError as error:
            raise HardwareError(str(error)) from error
        for number in range(measurements):
            cancel.check()
            listener(Progress("bridge", number, measurements, fault_at.get(number, "")))
            nest = names[number % len(names)]
            kind = fault_at.get(number, "")
            began_s = time.monotonic()
            if kind == SECOND_CLIENT:
                _second_client(url)
            elif kind:
                emulator.fault(kind)
            try:
                point = tracker.measure(nests[nest], _AVERAGING_S)
            except TargetLost:
                if kind != "beam":
                    lost += 1
                    continue
                point = tracker.measure(nests[nest], _AVERAGING_S)  # as collection does after a broken beam
            except TrackerError:
                lost += 1
                continue
            took[kind].append(time.monotonic() - began_s)
            times.append(point.time_s)
            strange += bool(np.linalg.norm(point.p_M - nests[nest]) > _NEAR_M)
        forgotten = len(took["reboot"])  # made, and lost with the bridge's memory before delivery
        doubled = len(times) - len(set(times)) + max(0, emulator.tracker.measured - forgotten - len(times))
    listener(Progress("bridge", measurements, measurements, "done"))
    return BridgeResult(
        asked=measurements,
        delivered=len(times),
        lost=lost,
        doubled=doubled,
        strange=strange,
        faults={kind: len(took[kind]) for kind in ALL_FAULTS},
        recovery_s={kind: max(took[kind]) for kind in ALL_FAULTS if took[kind]},
        undisturbed_s=float(np.median(took[""])) if took[""] else None,
    )


def _second_client(url: str) -> None:
    """Try to take the tracker while another client holds it. Raises ``HardwareError`` if that succeeds."""
    other = BridgeTracker(url, timeout_s=_SILENCE_S)
    try:
        other.connect()
    except TrackerRefused:
        return
    other.disconnect()
    raise HardwareError(f"{url}: a second client was let in while the first one held the tracker")


def _nests(profile: Profile) -> dict[str, np.ndarray]:
    """Three nests in the tracker's field, nearer to it than the arms."""
    low, high = profile.tracker.azimuth
    middle = 0.5 * (low + high)
    elevation = float(np.mean(profile.tracker.elevation))
    distance = max(1.2 * profile.tracker.distance[0], 1.0)
    nests = {}
    for name, azimuth in (("a", middle - 0.3), ("b", middle), ("c", middle + 0.3)):
        level = distance * np.cos(elevation)
        nests[name] = np.array([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)])
    return nests
