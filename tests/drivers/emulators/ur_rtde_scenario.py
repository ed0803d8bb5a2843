"""Scenarios with the real ur_rtde client, run in a separate process; prints one line of JSON.

The client holds the interpreter's lock while it connects, and may crash when a link breaks.

    python -m tests.drivers.emulators.ur_rtde_scenario SCENARIO CONTROL_PORT HOST...
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from drivers.emulators.ur_controller import Control

PATIENT_S = 10.0
FAST, HARD = 1.0, 2.0


def until(condition: Callable[[], bool], what: str) -> float:
    """Poll; how long it took [s]. Raises ``TimeoutError``."""
    began = time.monotonic()
    pause = threading.Event()
    while not condition():
        if time.monotonic() - began > PATIENT_S:
            raise TimeoutError(what)
        pause.wait(0.002)
    return time.monotonic() - began


def moved(q: list[float], **steps: float) -> list[float]:
    """``q`` with some joints ``j1`` to ``j6`` changed."""
    goal = list(q)
    for joint, step in steps.items():
        goal[int(joint[1:]) - 1] += step
    return goal


def both_arms(control: Control, hosts: list[str]) -> dict[str, Any]:
    """Connect to two arms and move them at once, blocking and asynchronously; use all other functions of a driver."""
    receives = [RTDEReceiveInterface(host) for host in hosts]
    commands = [RTDEControlInterface(host) for host in hosts]
    homes = [receive.getActualQ() for receive in receives]
    goals = [moved(home, j1=0.5, j4=-0.3) for home in homes]
    done = [False, False]
    moving: list[set[str]] = []

    def move(number: int) -> None:
        done[number] = commands[number].moveJ(goals[number], FAST, HARD)

    threads = [threading.Thread(target=move, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    end_s = time.monotonic() + PATIENT_S
    while any(thread.is_alive() for thread in threads):
        if time.monotonic() > end_s:
            raise TimeoutError("the end of both motions")
        moving.append({name for name in ("left", "right") if control(name, "status")["moving"]})
    until(lambda: [receive.getActualQ() for receive in receives] == goals, "the last states")
    command, receive = commands[1], receives[1]
    found: dict[str, Any] = {
        "done": done,
        "together": {"left", "right"} in moving,
        "temperatures": receive.getJointTemperatures(),
        "modes": [receive.getRobotMode(), receive.getSafetyMode(), command.isProgramRunning()],
        "payload": command.setPayload(1.5, [0.0, 0.01, 0.02]),
        "tcp": command.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]),
    }
    until(lambda: command.getStepTime() == 0.002, "the step time; the client reads it without waiting for the answer")
    until(command.isSteady, "steady")
    until(lambda: math.isclose(receive.getPayload(), 1.5), "the payload")
    found["tcp_offset"] = command.getTCPOffset()
    until(lambda: receive.getActualTCPPose() == command.getForwardKinematics(goals[1], found["tcp_offset"]), "the pose")

    before = command.getAsyncOperationProgressEx().operationId()
    found["asynchronous"] = command.moveJ(homes[1], FAST, HARD, True)
    until(lambda: command.getAsyncOperationProgressEx().operationId() != before, "a new operation")
    until(lambda: not command.getAsyncOperationProgressEx().isAsyncOperationRunning(), "its end")
    found["back"] = control("right", "status")["q"] == homes[1]

    command.moveJ(moved(homes[1], j1=2.0), FAST, HARD, True)
    until(lambda: receive.getActualQ()[0] > homes[1][0] + 0.15, "some way")
    command.stopJ(HARD)
    status = control("right", "status")
    found["stopped"] = [status["moving"], status["q"][0] - homes[1][0]]
    return found


def rates(control: Control, hosts: list[str]) -> dict[str, Any]:
    """The usual time between two states, in time of the cell."""
    control("*", "pace", 1)
    steps = []
    for host in hosts:
        receive = RTDEReceiveInterface(host)
        stamps: set[float] = set()
        pause = threading.Event()
        end_s = time.monotonic() + PATIENT_S
        while len(stamps) < 60:
            if time.monotonic() > end_s:
                raise TimeoutError("60 states")
            stamps.add(receive.getTimestamp())
            pause.wait(0.0003)
        gaps = sorted(b - a for a, b in pairwise(sorted(stamps)))
        steps.append(gaps[len(gaps) // 2])
    return {"steps_s": steps}


def protective_stop(control: Control, hosts: list[str]) -> dict[str, Any]:
    """A stop in the middle of a blocking move, the operator's release, and the next move."""
    from dashboard_client import DashboardClient

    receive, command = RTDEReceiveInterface(hosts[0]), RTDEControlInterface(hosts[0])
    home = receive.getActualQ()
    moves = control("left", "status")["moves"]
    control("left", "protective", "travel", 0.2)
    outcome = command.moveJ(moved(home, j1=1.0), FAST, HARD)
    until(lambda: receive.getRuntimeState() == 4, "paused")
    until(lambda: not control("left", "status")["moving"], "rest")
    rest = control("left", "status")
    found: dict[str, Any] = {"outcome": outcome, "mode": rest["safety_mode"], "gone": rest["q"][0] - home[0]}
    found["refused"] = command.moveJ(home, FAST, HARD)
    dashboard = DashboardClient(hosts[0])
    dashboard.connect()
    try:
        dashboard.unlockProtectiveStop()
        found["unlocked_early"] = ""
    except RuntimeError as error:
        found["unlocked_early"] = str(error)
    control("left", "release")
    until(lambda: not receive.isProtectiveStopped(), "released")
    dashboard.stop()
    command.reuploadScript()
    until(command.isProgramRunning, "the script")
    found["still"] = control("left", "status")["q"] == rest["q"]
    found["next"] = command.moveJ(home, FAST, HARD)
    found["moves"] = control("left", "status")["moves"] - moves
    return found


def emergency_stop(control: Control, hosts: list[str]) -> dict[str, Any]:
    """An emergency stop during a move, and recovery through the dashboard."""
    from dashboard_client import DashboardClient

    receive, command = RTDEReceiveInterface(hosts[0]), RTDEControlInterface(hosts[0])
    home = receive.getActualQ()
    command.moveJ(moved(home, j1=1.0), FAST, HARD, True)
    until(lambda: receive.getActualQ()[0] > home[0] + 0.2, "some way")
    control("left", "estop")
    until(receive.isEmergencyStopped, "the stop")
    found: dict[str, Any] = {"refused": command.moveJ(home, FAST, HARD)}
    control("left", "estop-release")
    dashboard = DashboardClient(hosts[0])
    dashboard.connect()
    dashboard.powerOn()
    until(lambda: receive.getRobotMode() == 5, "idle")
    dashboard.brakeRelease()
    until(lambda: receive.getRobotMode() == 7, "running")
    rest = control("left", "status")["q"]
    command.reuploadScript()
    until(command.isProgramRunning, "the script")
    found["still"] = control("left", "status")["q"] == rest
    found["next"] = command.moveJ(home, FAST, HARD)
    return found


def watchdog(control: Control, hosts: list[str]) -> dict[str, Any]:
    """A client that feeds the watchdog for longer than its period, then falls silent while its arm moves."""
    control("*", "pace", 1)
    receive, command = RTDEReceiveInterface(hosts[0]), RTDEControlInterface(hosts[0])
    home = receive.getActualQ()
    command.setWatchdog(2.0)
    command.moveJ(moved(home, j1=2.5), 0.5, HARD, True)
    pause = threading.Event()
    for _ in range(35):
        command.kickWatchdog()
        pause.wait(0.02)
    fed = control("left", "status")["moving"]
    until(lambda: control("left", "status")["runtime_state"] == "STOPPED", "the program's end")
    status = control("left", "status")
    return {"fed": fed, "moving": status["moving"], "gone": status["q"][0] - home[0]}


def dropped(control: Control, hosts: list[str]) -> dict[str, Any]:
    """A link that is cut and refused in the middle of a move; the client is not asked anything afterwards."""
    receive, command = RTDEReceiveInterface(hosts[0]), RTDEControlInterface(hosts[0])
    home = receive.getActualQ()
    command.moveJ(moved(home, j1=0.5), FAST, HARD, True)
    until(lambda: receive.getActualQ()[0] > home[0] + 0.1, "some way")
    control("left", "drop", "rtde", "rst", 30)
    seen = until(lambda: not receive.isConnected(), "the loss")
    until(lambda: not control("left", "status")["moving"], "rest")
    return {"seen": seen < PATIENT_S, "gone": control("left", "status")["q"][0] - home[0]}


def late_start(control: Control, hosts: list[str]) -> dict[str, Any]:
    """A program that takes longer to start than the client waits."""
    control("left", "start-delay", 7)
    try:
        RTDEControlInterface(hosts[0])
    except RuntimeError as error:
        return {"error": str(error)}
    return {"error": ""}


def local_control(control: Control, hosts: list[str]) -> dict[str, Any]:
    """An e-Series arm whose switch is on local."""
    control("right", "remote", "off")
    try:
        RTDEControlInterface(hosts[1])
    except RuntimeError as error:
        return {"error": str(error)}
    return {"error": ""}


def second_client(control: Control, hosts: list[str]) -> dict[str, Any]:
    """Two control interfaces for one arm."""
    first = RTDEControlInterface(hosts[0])
    try:
        RTDEControlInterface(hosts[0])
    except RuntimeError as error:
        return {"error": str(error), "first": first.isProgramRunning()}
    return {"error": "", "first": first.isProgramRunning()}


SCENARIOS: Mapping[str, Callable[[Control, list[str]], dict[str, Any]]] = {
    scenario.__name__: scenario
    for scenario in (
        both_arms,
        rates,
        protective_stop,
        emergency_stop,
        watchdog,
        dropped,
        late_start,
        local_control,
        second_client,
    )
}


def main() -> None:
    """Run one scenario and end at once: the client's destructors would wait half a second each."""
    name, port, *hosts = sys.argv[1:]
    found = SCENARIOS[name](Control(("127.0.0.1", int(port))), hosts)
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
