"""Measurements through an emulated tracker bridge over TCP, a random fault in each group of them: none may be lost,
delivered twice or mixed up."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from drivers.emulators.tracker_bridge import FAULTS, TrackerBridgeEmulator
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import Preparation, TargetLost, TrackerError, TrackerRefused
from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Limit

TITLE = "Tracker bridge"
ALONE = True
SECOND_CLIENT = "second-client"
ALL_FAULTS = (*FAULTS, SECOND_CLIENT)

_SILENCE_S = 0.3
"""Time without an answer after which the client reconnects: short, so that many faults fit into a trial."""
_AVERAGING_S = 1.0
_NEAR_M = 1e-3
"""A point within this distance belongs to the nest: nests are decimetres apart, noise is below 0.1 mm."""
OPTIONS = {"measurements": 1000, "every": 20, "seed": 0}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"bridge": {key: getattr(asked, key) for key in OPTIONS}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Measure nests through an emulated bridge; what became of the measurements."""
    profile = load_profile(TWIN)
    nests, fault_at, log = _nests(profile), _sampled_faults(**case), _Log()
    with ExitStack() as stack:
        emulator = stack.enter_context(
            TrackerBridgeEmulator(build_plant(profile), nests=nests, reboot_s=0.3, slow_s=1.6 * _SILENCE_S)
        )
        tracker = BridgeTracker(emulator.url, timeout_s=_SILENCE_S, preparation=Preparation())
        stack.callback(tracker.disconnect)
        tracker.connect()
        for number in range(case["measurements"]):
            fault = fault_at.get(number, "")
            nest = list(nests)[number % len(nests)]
            began_s = time.monotonic()
            if fault == SECOND_CLIENT:
                _second_client(emulator.url)
            elif fault:
                emulator.fault(fault)
            _measure(tracker, nests[nest], fault, began_s, log)
        made = emulator.tracker.measured
    return log.result(case["measurements"], made)


@dataclass
class _Log:
    """What is recorded during a trial: time of each measurement [s] by fault, and the time stamps of the points [s]."""

    took_s: dict[str, list[float]] = field(default_factory=lambda: {fault: [] for fault in ("", *ALL_FAULTS)})
    stamps_s: list[float] = field(default_factory=list)
    strange: int = 0
    lost: int = 0

    def result(self, asked: int, made: int) -> dict[str, Any]:
        """Measurements that were delivered, lost, delivered or made twice, or belong to another nest; and times [s].

        ``made`` is the number of measurements that the tracker made.
        """
        delivered, took_s = len(self.stamps_s), self.took_s
        forgotten = len(took_s["reboot"])  # made, and lost with the bridge's memory before delivery
        doubled = delivered - len(set(self.stamps_s)) + max(0, made - forgotten - delivered)
        return {
            "asked": asked,
            "delivered": delivered,
            "wrong": {"lost": self.lost, "doubled": doubled, "of another nest": self.strange},
            "longest_s": max((max(took_s[fault]) for fault in ALL_FAULTS if took_s[fault]), default=0.0),
            "undisturbed_s": float(np.median(took_s[""])) if took_s[""] else None,
        }


def _sampled_faults(measurements: int, every: int, seed: int) -> dict[int, str]:
    """One fault in each group of ``every`` measurements, by its number; each about equally often."""
    rng = np.random.default_rng([seed, 0xB41D])
    drawn = rng.permutation(np.resize(np.array(ALL_FAULTS), measurements // every))
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
    middle = float(np.mean(profile.tracker.azimuth))
    elevation = float(np.mean(profile.tracker.elevation))
    distance = max(1.2 * profile.tracker.distance[0], 1.0)
    level = distance * np.cos(elevation)
    return {
        name: np.array([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)])
        for name, azimuth in (("a", middle - 0.3), ("b", middle), ("c", middle + 0.3))
    }


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = results[0]
    delivered, undisturbed_s = f"{result['delivered']} of {result['asked']}", result["undisturbed_s"]
    said = "" if undisturbed_s is None else f"Median without a fault: {1e3 * undisturbed_s:.0f} ms; "
    return Evidence(
        {"delivered": delivered},
        (),
        [Limit(what, count, 0) for what, count in result["wrong"].items()],
        [
            f"{delivered} measurements delivered, beside {len(ALL_FAULTS)} kinds of faults."
            f" {said}longest time of a measurement: {result['longest_s']:.2f} s."
        ],
    )
