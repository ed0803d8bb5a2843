"""The emulated cell of the program storm: its profiles, its emulators in a process of their own, faults on command."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cellapp.cell.profile import profile_from_json, profile_to_json
from cellapp.commands.emulate import EmulatedTracker, EmulateResult, emulate
from cellapp.ground.errors import CellappError, HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Collection, SlowStart, Suspend, Suspension
from cellapp.ground.progress import JobToken
from drivers.arms.simulated_settings import SimulatedArmSettings
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import Control
from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_settings import BridgeSettings
from drivers.trackers.simulated_settings import SimulatedTrackerSettings
from tests.evidence.skeleton import ROOT
from tests.evidence.wire.polling import can_move, comes_about
from tests.sure import sure
from tests.twin import altered

_PATIENT_S = 60.0
_POLL_S = 0.01
_STOPS_WITHIN_S = 10.0
_SETTLE_S = 0.05
"""Wall time, of which the emulated arms need less: half a second of theirs is 0.02 s at the usual pace."""
_BRIDGE_SILENCE_S = 2.0
"""Longest silence of the bridge that its client accepts: the least it can be set to."""
_QUICK = Suspension(times=1000, wait=20.0, retry=0.1)
"""Waits of the collecting process: its clock is the wall, while the emulated cell is fast."""


def wire_profile(profile: Profile, stops: int) -> Profile:
    """Return the profile of the storm: few waits, and no effect that remembers the way to a stop.

    Readings of a run with interruptions are then those of an undisturbed one: the arms come to a stop from elsewhere.

    Raises
    ------
    InputError
        If an arm is not of the kind ``ur`` on this computer, or the tracker not behind a bridge on it.
    """
    if profile.plant is None:
        raise InputError(f"profile {profile.name}: a storm needs the section 'plant'")
    arms = {}
    for name, arm in profile.arms.items():
        if not isinstance(arm.driver, UrSettings) or arm.driver.moves_hardware:
            raise InputError(f"arms.{name}.driver: a storm needs kind 'ur' at a loopback address, as 127.0.0.2")
        arms[name] = altered(arm, driver={"settle_time": _SETTLE_S})
    driver = profile.tracker.driver
    if not isinstance(driver, BridgeSettings) or driver.emulated_bridge() is None:
        raise InputError("tracker.driver: a storm needs kind 'bridge' at a loopback address")
    collection = Collection(slow_start=SlowStart(stops=0), suspend=Suspend(target=_QUICK, tracker_warm_up=_QUICK))
    few = {"identify": 1, "train": 0, "validate_": 1, "pair_identify": 1, "pair_validate": 1}
    return altered(
        profile,
        arms=arms,
        tracker={"driver": {"timeout": _BRIDGE_SILENCE_S}},
        plan={"stops": stops, "reserve": 0},
        plant={"effects": {}, "repeatability": 0.0},
        splits=few,
        collection=collection,
    )


def undisturbed_profile(profile: Profile) -> Profile:
    """Return the same cell with simulated drivers."""
    arms = {name: arm.model_copy(update={"driver": SimulatedArmSettings()}) for name, arm in profile.arms.items()}
    return altered(profile, arms=arms, tracker={"driver": SimulatedTrackerSettings()})


@dataclass(frozen=True)
class StormCell:
    """The emulated cell as a person at it sees it: pendants, cables, buttons, and the tracker's computer.

    ``pid`` is the process in which all of it lives.
    """

    arms: tuple[str, ...]
    control: Control
    bridge: EmulatedTracker
    pid: int

    def tracker_fault(self, kind: str) -> None:
        """Let the bridge fail at its next measurement; a bridge that restarts at this moment is left alone."""
        try:
            with socket.create_connection((self.bridge.host, self.bridge.port), 1.0) as link:
                link.sendall(wire.encode(1, "fault", {"kind": kind}))
                link.recv(wire.LONGEST_LINE)
        except OSError:
            return

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the status of every controller, by arm."""
        return {name: self.control(name, "status") for name in self.arms}

    def began(self, since_s: float) -> int:
        """Return how many motions began since a time [s] (``time.monotonic``)."""
        return sum(len(self.control(name, "starts", since_s)) for name in self.arms)

    def stop_ms(self, since_s: float, arms: Sequence[str] = ()) -> float:
        """Return the time to the stop command at the last of these controllers, or of all [ms]; infinite if one has
        none."""

        def stops() -> list[list[dict[str, Any]]]:
            return [self.control(name, "stops", since_s) for name in arms or self.arms]

        if not comes_about(lambda: all(stops()), since_s + _STOPS_WITHIN_S):
            return math.inf
        return 1e3 * float(max(its[0]["received_s"] for its in stops()) - since_s)

    def wait_at_rest(self, within_s: float) -> bool:
        """Wait until no arm moves; return whether that came about."""
        deadline_s = time.monotonic() + within_s
        return comes_about(lambda: not any(one["moving"] for one in self.status().values()), deadline_s, _POLL_S)

    def repair(self) -> None:
        """Do what an operator does after a fault: cables, slider, buttons, power, brakes. Raises ``HardwareError``."""
        for name in self.arms:
            self.control(name, "fault", "*", "none")
            self.control(name, "slider", 1.0)
            for command in ("release", "estop-release", "brake-release"):
                self.control(name, command)

        def repaired() -> bool:
            return all(can_move(status) and not status["moving"] for status in self.status().values())

        if not comes_about(repaired, time.monotonic() + _PATIENT_S, _POLL_S):
            raise HardwareError("the emulated arms could not be repaired")

    def clearance_m(self) -> float | None:
        """Return the smallest distance between the arms so far [m]."""
        seen = self.control(self.arms[0], "clearance")
        return None if seen is None else float(seen[0])


def cellapp_process(
    folder: Path, *words: str, program: Sequence[str] = ("-m", "cellapp"), **streams: Any
) -> subprocess.Popen[Any]:
    """Start a command in a folder, in a session of its own; nobody reads what it says but through ``streams``."""
    silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    return subprocess.Popen(
        [sys.executable, *program, *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True, **(silent | streams),
    )  # fmt: skip


@contextmanager
def emulated_cell(profile: Profile, pace: float, *, watch_clearance: bool = True) -> Iterator[StormCell]:
    """Emulate the cell of a profile in another process: the real client holds the interpreter while it connects.

    Watching the clearance takes time that the controllers then do not have: some 10 ms now and then.

    Raises ``HardwareError`` if it does not start.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(
        target=_serve, args=(profile_to_json(profile), pace, watch_clearance, theirs), daemon=True
    )
    process.start()
    theirs.close()
    try:
        try:
            answer = ours.recv() if ours.poll(_PATIENT_S) else "no answer"
        except EOFError:
            answer = "it ended"
        if isinstance(answer, str):
            raise HardwareError(f"the emulated cell does not start: {answer}")
        control = Control(("127.0.0.1", answer[0]))
        try:
            yield StormCell(tuple(profile.arms), control, answer[1], sure(process.pid))
        finally:
            control.close()
    finally:
        ours.close()
        process.join(_PATIENT_S)
        if process.is_alive():
            process.kill()
            process.join()


def _serve(profile_text: str, pace: float, watch_clearance: bool, pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends when the parent closes the pipe
    logging.disable(logging.WARNING)  # clients that hang up are what this trial is about
    profile = profile_from_json(profile_text)
    cancel = JobToken()

    def until_told() -> None:
        try:
            pipe.poll(None)  # or until the other end is gone
        finally:
            cancel.cancel()

    def announce(served: EmulateResult) -> None:
        pipe.send((served.arms[0].control_port, served.tracker))

    threading.Thread(target=until_told, daemon=True).start()
    try:
        emulate(profile, cancel, announce, pace=pace, watch_clearance=watch_clearance)
    except CellappError as error:
        pipe.send(str(error))
    os._exit(0)  # whatever threads still wait
