"""Measurements over the tracker bridge with random faults: none may be lost, delivered twice or mixed up."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import Result
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


class BridgeResult(Result, schema="cellapp-trials-bridge"):
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
    job: JobToken = UNATTENDED,
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
    nests = _nests(profile)
    fault_at = _sampled_faults(measurements, every, seed, ALL_FAULTS if serial is None else FAULTS)
    with ExitStack() as stack:
        emulator = stack.enter_context(
            TrackerBridgeEmulator(
                build_plant(profile),
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
        log = _Log()
        for number in range(measurements):
            job.check()
            fault = fault_at.get(number, "")
            job.tell("bridge", number, measurements, fault)
            nest = list(nests)[number % len(nests)]
            began_s = time.monotonic()
            if fault == SECOND_CLIENT:
                _second_client(url)
            elif fault:
                emulator.fault(fault)
            _measure(tracker, nests[nest], fault, began_s, log)
        made = emulator.tracker.measured
    job.tell("bridge", measurements, measurements, "done")
    return log.result(measurements, made)


@dataclass
class _Log:
    """What is recorded during a trial: time of each measurement [s] by fault, and the time stamps of the points [s]."""

    took_s: dict[str, list[float]] = field(default_factory=lambda: {fault: [] for fault in ("", *ALL_FAULTS)})
    stamps_s: list[float] = field(default_factory=list)
    strange: int = 0
    lost: int = 0

    def result(self, asked: int, made: int) -> BridgeResult:
        """The summary; ``made`` is the number of measurements that the tracker made."""
        delivered, took_s = len(self.stamps_s), self.took_s
        forgotten = len(took_s["reboot"])  # made, and lost with the bridge's memory before delivery
        return BridgeResult(
            asked=asked,
            delivered=delivered,
            lost=self.lost,
            doubled=delivered - len(set(self.stamps_s)) + max(0, made - forgotten - delivered),
            strange=self.strange,
            faults={fault: len(took_s[fault]) for fault in ALL_FAULTS},
            recovery_s={fault: max(took_s[fault]) for fault in ALL_FAULTS if took_s[fault]},
            undisturbed_s=float(np.median(took_s[""])) if took_s[""] else None,
        )


def _sampled_faults(measurements: int, every: int, seed: int, faults: Sequence[str]) -> dict[int, str]:
    """One fault in each group of ``every`` measurements: number of the measurement -> fault, each about equally often.

    Over a serial cable there is no second client, so ``faults`` lacks that one.
    """
    rng = np.random.default_rng([seed, 0xB41D])
    drawn = rng.permutation(np.resize(np.array(faults), measurements // every))
    return {group * every + int(rng.integers(every)): str(fault) for group, fault in enumerate(drawn)}


def _measure(tracker: BridgeTracker, nest_M: np.ndarray, fault: str, began_s: float, log: _Log) -> None:
    """Measure one nest (3,) [m] and record what became of it; its time counts from ``began_s``."""
    try:
        point = tracker.measure(nest_M, _AVERAGING_S)
    except TargetLost:
        if fault != "beam":
            log.lost += 1
            return
        point = tracker.measure(nest_M, _AVERAGING_S)  # as collection does after a broken beam
    except TrackerError:
        log.lost += 1
        return
    log.took_s[fault].append(time.monotonic() - began_s)
    log.stamps_s.append(point.time_s)
    log.strange += bool(np.linalg.norm(point.p_M - nest_M) > _NEAR_M)


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
