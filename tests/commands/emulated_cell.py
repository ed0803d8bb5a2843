"""The emulated cell of a profile in a process of its own, for tests over the wire; work where nobody looks on."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import pytest

from cellapp.cell.profile import profile_from_json, profile_to_json
from cellapp.commands.emulate import EmulatedArm, EmulatedTracker, emulate, emulated_arms
from cellapp.commands.record import Work
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.outputs import NEW_ONLY
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken, ignore_words
from drivers.trackers.bridge_settings import BridgeSettings
from tests import latency
from tests.twin import altered
from tests.waiting import WAIT_S

PATIENT_S = WAIT_S
_STALLED = (
    "this program was silent",
    "this computer was",
    "its driver process was silent",
    "its driver process did not answer",
    "no answer from the tracker within",
    "no state came for",
    "its controller has not answered a command",
)
"""What stops the arms where other programs take the processor for some tenths of a second; bridge and emulated
controllers are on it, too."""
T = TypeVar("T")


def patiently(act: Callable[[int], T]) -> T:
    """Do something, which is told how often it was tried before; a computer that stalls stops the arms, and a person
    begins again."""
    return latency.patiently(act, HardwareError, lambda error: stalled(str(error)))


def stalled(text: str) -> bool:
    """Whether a message, in lines of any width, blames this computer."""
    return any(words in " ".join(text.split()) for words in _STALLED)


def behind_bridge(profile: Profile, url: str = "socket://127.0.0.1:50960", **settings: Any) -> Profile:
    """The profile with its tracker behind a bridge."""
    driver = BridgeSettings(url=url, **settings)
    return altered(profile, tracker={"driver": driver})


def _serve(
    profile_text: str, hosts: Mapping[str, str], pace: float, lost_beams: float, simulation: bool, pipe: Connection
) -> None:
    """The emulators, in a process of their own because the real client holds the interpreter while it connects."""
    profile = profile_from_json(profile_text)
    arms = [arm.model_copy(update={"host": hosts[arm.arm]}) for arm in emulated_arms(profile)]
    cancel = JobToken()

    def until_told() -> None:
        pipe.poll(None)  # or until the other end is gone
        cancel.cancel()

    threading.Thread(target=until_told, daemon=True).start()
    emulate(
        profile,
        cancel,
        lambda served: pipe.send(0 if served.tracker is None else served.tracker.port),
        arms,
        pace=pace,
        tracker=EmulatedTracker(host="127.0.0.1", port=0),
        lost_beams=lost_beams,
        simulation=simulation,
    )


@contextmanager
def emulated(
    profile: Profile, hosts: Mapping[str, str], pace: float, lost_beams: float = 0.0, *, simulation: bool = False
) -> Iterator[int]:
    """The emulators of a profile at ``hosts``, arm -> address; gives the port of the tracker's bridge, 0 without.

    ``lost_beams`` is how often the beam to a moving SMR breaks [1/min]; in ``simulation`` mode no arm moves.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    args = (profile_to_json(profile), dict(hosts), pace, lost_beams, simulation, theirs)
    process = context.Process(target=_serve, args=args, daemon=True)
    process.start()
    theirs.close()
    try:
        assert ours.poll(PATIENT_S), "the emulators did not come up"
        try:
            port = ours.recv()
        except EOFError:
            pytest.fail("the emulators could not listen; is another test at their addresses?")
        yield port
    finally:
        ours.close()
        process.join(PATIENT_S)
        if process.is_alive():
            process.kill()
            process.join(PATIENT_S)
    assert process.exitcode == 0


def on_free_ports(profile: Profile) -> list[EmulatedArm]:
    """The emulated arms of a profile on ports that the operating system chooses."""
    free = dict.fromkeys(("dashboard_port", "primary_port", "script_port", "rtde_port"), 0)
    return [arm.model_copy(update=free) for arm in emulated_arms(profile)]


def quiet_work(say: Callable[[str], None] = ignore_words) -> Work:
    """What a job has whose progress nobody follows: nobody can be asked, no file is replaced."""
    return Work(JobControl(), lambda _: None, NEW_ONLY, say=say)
