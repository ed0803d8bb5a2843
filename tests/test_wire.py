"""The twin through the wire: arms over ur_rtde, tracker over the bridge; its readings are the in-process ones."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from cellapp.collection.collect import collect_run
from cellapp.emulate import EmulatedTracker, emulate, emulated_arms
from cellapp.profile import BridgeTrackerDriver, Profile, UrArmDriver, profile_from_json, profile_to_json
from cellapp.progress import CancelToken
from cellapp.whole import new_planned_run
from tests.twin import small_twin

PATIENT_S = 60.0
PACE = 20.0
STOPS = 8
HOSTS = {"left": "127.0.81.2", "right": "127.0.81.3"}  # the ports are fixed, so nobody else's addresses


def _serve(profile_text: str, pipe: Connection) -> None:
    """The emulators, in a process of their own because the real client holds the interpreter while it connects."""
    profile = profile_from_json(profile_text)
    arms = [replace(arm, host=HOSTS[arm.arm]) for arm in emulated_arms(profile)]
    cancel = CancelToken()

    def until_told() -> None:
        pipe.poll(None)  # or until the other end is gone
        cancel.cancel()

    threading.Thread(target=until_told, daemon=True).start()
    ports: list[int] = []
    emulate(
        profile,
        cancel,
        lambda _: pipe.send(ports[0]),
        arms,
        pace=PACE,
        tracker=EmulatedTracker("127.0.0.1", 0),
        announce_tracker=lambda where: ports.append(where.port),
    )


@contextmanager
def emulated(profile: Profile) -> Iterator[int]:
    """The emulators of a profile; gives the port of the tracker's bridge."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(profile_to_json(profile), theirs), daemon=True)
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
            process.join()
    assert process.exitcode == 0


def readings_of(profile: Profile, folder: Path):
    with new_planned_run(profile, folder) as run:
        collect_run(run)
        return {name: run.readings(name) for name in run.arms()}


def test_the_twin_over_the_wire_gives_the_readings_of_the_twin(tmp_path: Path) -> None:
    twin = small_twin(STOPS)
    direct = readings_of(twin, tmp_path / "direct")
    served = twin.model_copy(
        update={
            "tracker": twin.tracker.model_copy(
                update={"driver": BridgeTrackerDriver(kind="bridge", url="socket://127.0.0.1:50960")}
            )
        }
    )
    with emulated(served) as port:
        arms = {
            name: arm.model_copy(update={"driver": UrArmDriver(kind="ur", host=HOSTS[name])})
            for name, arm in twin.arms.items()
        }
        bridge = BridgeTrackerDriver(kind="bridge", url=f"socket://127.0.0.1:{port}")
        tracker = twin.tracker.model_copy(update={"driver": bridge})
        wired = readings_of(twin.model_copy(update={"arms": arms, "tracker": tracker}), tmp_path / "wired")
    assert list(wired) == list(direct) == ["left", "right"]
    for name in direct:
        assert len(wired[name].q) == STOPS
        assert np.abs(wired[name].q - direct[name].q).max() < 1e-9
        assert np.abs(wired[name].p_M - direct[name].p_M).max() < 1e-9
        assert np.array_equal(wired[name].approach, direct[name].approach)
        assert wired[name].covariance_M == pytest.approx(direct[name].covariance_M, rel=1e-6)
        assert (np.diff(wired[name].time_s) > 0.0).all()
