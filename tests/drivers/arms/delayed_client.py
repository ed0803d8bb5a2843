"""A UR arm's worker in this process, with a client that reports what a test wants, and a clock of its own."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arms import ur_path_supervisor, ur_supervisor, ur_worker
from drivers.arms.ur_control import UrControl
from drivers.arms.ur_motion import Motion, RestCriterion
from drivers.arms.ur_path_supervisor import PathSupervisor
from tests.drivers.arms.emulated_ur_cell import AWAY, HOME

Monitor = Callable[..., list[dict[str, Any]]]
"""Sends a message, runs the worker for some seconds and returns all its answers so far."""


class DelayedClient:
    """A client that reports the end of a motion at once, while its positions come late."""

    supervisor: PathSupervisor
    now: list[float]
    """The clock of its worker [s]."""

    def __init__(self) -> None:
        self.q, self.stamp = list(HOME), 0.0
        self.playing, self.running, self.local = True, False, False
        self.fraction, self.safety, self.mode, self.speed = 1.0, 1, 7, 0.0

    def tick(self, _: float) -> None:
        self.stamp += 0.16  # a cell at twenty times the pace

    def getTimestamp(self) -> float:
        return self.stamp

    def getActualQ(self) -> list[float]:
        return self.q

    def getActualQd(self) -> list[float]:
        return [self.speed] * 6

    def getJointTemperatures(self) -> list[float]:
        return [30.0] * 6

    def getRobotMode(self) -> int:
        return self.mode

    def getSafetyMode(self) -> int:
        return self.safety

    def getRuntimeState(self) -> int:
        return 2 if self.playing else 1

    def isProgramRunning(self) -> bool:
        return self.playing

    def getAsyncOperationProgressEx(self) -> DelayedClient:
        return self

    def operationId(self) -> int:
        return 2

    def isAsyncOperationRunning(self) -> bool:
        return self.running

    def getTargetSpeedFraction(self) -> float:
        return self.fraction

    def getTCPOffset(self) -> list[float]:
        return [0.0] * 6

    def stopJ(self, deceleration: float, asynchronous: bool) -> None:
        self.running = False

    def _done(self, *_: object) -> bool:
        return True

    isConnected = kickWatchdog = setWatchdog = moveJ = isJointsWithinSafetyLimits = servoJ = servoStop = _done

    def setCustomScriptFile(self, _: str) -> None:
        self.playing = True

    def end_program(self, *_: object) -> bool:
        """A command that is not served, because the program ended."""
        self.playing = False
        return False

    def break_link(self, *_: object) -> bool:
        """A command during which the link breaks: the client raises what its socket says."""
        vars(self)["isConnected"] = lambda: False
        raise RuntimeError("Operation canceled")


def delayed_worker(monkeypatch: pytest.MonkeyPatch) -> tuple[DelayedClient, Monitor]:
    """Return the client, which is in a motion from HOME to AWAY, and what runs its worker."""
    client, answers, now = DelayedClient(), io.BytesIO(), [1000.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=client.tick)
    monkeypatch.setattr(ur_path_supervisor, "time", clock)
    for module in (ur_worker, ur_supervisor):
        monkeypatch.setattr(module, "time", clock)
        monkeypatch.setattr(module, "stop_program", lambda host, within_s: None)
    monkeypatch.setattr(ur_supervisor, "in_local_control", lambda host, within_s: client.local)
    worker = ur_worker.Worker(answers)
    control = UrControl("127.0.0.1", client, client, ("target_speed_fraction",))
    supervisor = PathSupervisor(worker, control, 5.0, RestCriterion(dwell_s=0.1, speed=0.005, position=2e-4))
    supervisor.begin()
    client.supervisor, client.now = supervisor, now
    supervisor._unrest.begin()
    supervisor._motion = Motion(list(AWAY), number_before=1, began_s=now[0])
    supervisor.wait_settled(7, 60.0)
    worker._supervisor = supervisor
    worker._host = "127.0.0.1"
    answers.truncate(0)

    def monitor(for_s: float, message: dict[str, Any] | None = None, beats: bool = True) -> list[dict[str, Any]]:
        if message:
            worker.received({"id": 8, "timeout_s": 5.0, **message})
        end_s = now[0] + for_s
        while now[0] < end_s:
            now[0] += 0.008
            client.tick(0.008)
            if beats:
                worker.received({"beat": True})
            while not worker._requests.empty():
                request = worker._requests.get()
                if request is not None:
                    worker._serve(request)
            supervisor.stream()
            supervisor.monitor()
        said = [json.loads(line) for line in answers.getvalue().splitlines()]
        return [message for message in said if "beat" not in message]

    return client, monitor
