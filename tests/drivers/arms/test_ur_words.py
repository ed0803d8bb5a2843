"""Messages about a UR arm, cause by cause of the chapter on faults: which arm, what was seen, what to do, each once."""

from __future__ import annotations

import io
import json
import os
import re
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest

from drivers.arms import ur_control, ur_worker
from drivers.arms.protocol import (
    ArmError,
    EmergencyStop,
    HostStalled,
    JointLimits,
    LimitExceeded,
    LinkLost,
    MotionStopped,
    NotInRemoteControl,
    ProtectiveStop,
)
from drivers.arms.ur import UrArm, UrRecorder, checked_rows
from drivers.arms.ur_checks import UrExpectation, checks
from drivers.arms.ur_control import Refusal, _open_refusal
from drivers.arms.ur_motion import Unrest
from drivers.arms.ur_probe import UrProbe
from drivers.arms.ur_rtde_reader import UrSample
from drivers.arms.ur_settings import UrSettings
from drivers.arms.ur_supervised_link import REFUSALS, FirstFault, StopLine, arm_error, arm_state
from drivers.arms.ur_worker_process import HeartbeatGaps, WorkerGone
from drivers.patience import Patience
from tests.drivers.arms.delayed_client import DelayedClient, Monitor
from tests.drivers.arms.emulated_ur_cell import AWAY, HOME, PATIENT_S, expectation, pause
from tests.loopback import own_address
from tests.sure import sure
from tests.waiting import until

Delayed = tuple[DelayedClient, Monitor]
TO_DO = re.compile(
    r"\b(see w|look at|close |raise |switch |jog |power the|go to the arm|connect again|set it|choose it|correct |check"
    r" |restart |stop it|wait until|leave the|treat it|enable |end that|tighten |find out|move there|clear )"
)
MODES = {
    "REDUCED": (2, ArmError),
    "PROTECTIVE_STOP": (3, ProtectiveStop),
    "RECOVERY": (4, ArmError),
    "SAFEGUARD_STOP": (5, ArmError),
    "SYSTEM_EMERGENCY_STOP": (6, EmergencyStop),
    "ROBOT_EMERGENCY_STOP": (7, EmergencyStop),
    "VIOLATION": (8, ArmError),
    "FAULT": (9, ArmError),
    "UNKNOWN_17": (17, ArmError),
}


def assert_well_said(message: str, name: str = "left") -> None:
    """Assert that a message names the arm first, says what to do, and nothing twice."""
    assert message.startswith(f"arm {name}: "), message
    assert TO_DO.search(message), message
    clauses = [part.strip(" .") for part in re.split(r"[;:]\s", message)]
    assert [part for part, count in Counter(clauses).items() if count > 1] == [], message
    words = re.findall(r"[a-zA-Z']{3,}", message)
    runs = Counter(tuple(words[k : k + 4]) for k in range(len(words) - 3))
    assert [run for run, count in runs.items() if count > 1] == [], message
    assert "?;" not in message
    assert len(re.findall(rf"arm {name}\b", message)) == 1, message


def said(refusal: dict[str, Any]) -> str:
    kind = refusal.get("fault") or refusal["error"]
    return str(arm_error("left", kind, refusal["text"]))


# -- what the worker reports ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_safety_mode_says_what_to_do_in_the_fault_the_error_and_the_state(delayed: Delayed, mode: str) -> None:
    client, monitor = delayed
    client.running = True
    client.safety, error = MODES[mode]
    told, answer = monitor(0.05)[:2]
    assert said(told) == said(answer)
    assert_well_said(said(told))
    assert type(arm_error("left", told["fault"], told["text"])) is error
    state = arm_state(monitor(0.01, {"do": "state"})[-1]["ok"], 0.005)
    assert not state.ready
    assert_well_said(f"arm left: not ready: {state.reason}")
    assert_well_said(said(monitor(0.01, MOVE)[-1]))


WORKER: dict[str, tuple[dict[str, Any], type[ArmError], str]] = {
    "stopped on the pendant": (
        {"playing": False}, ArmError, "its program ended; possible: it was stopped on the pendant"
    ),
    "local control": ({"playing": False, "local": True}, NotInRemoteControl, "the pendant is in local control"),
    "cut short": ({"running": False}, ArmError, "its motion was cut short: it rests 20.05 deg from its goal"),
    "no power": ({"mode": 3}, ArmError, "robot mode POWER_OFF, needed is RUNNING; power the arm on"),
    "guided by hand": ({"mode": 6}, ArmError, "robot mode BACKDRIVE, needed is RUNNING; it is guided by hand"),
}  # fmt: skip


@pytest.mark.parametrize("cause", WORKER)
def test_what_ends_a_motion(delayed: Delayed, cause: str) -> None:
    client, monitor = delayed
    client.running = True
    monitor(0.1)
    changes, error, words = WORKER[cause]
    vars(client).update(changes)
    answers = monitor(1.5)
    assert words in said(answers[-1])
    assert type(arm_error("left", answers[-1]["error"], answers[-1]["text"])) is error
    for answer in answers:
        assert_well_said(said(answer))


MOVE = {"do": "move", "q": list(AWAY), "speed": [1.0] * 6, "acceleration": [1.0] * 6}
PATH = {"do": "path", "q": [list(AWAY)] * 2, "period_s": 0.008, "lookahead_s": 0.1, "gain": 300}


def test_requests_that_are_refused(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running = True
    assert_well_said(said(monitor(0.01, MOVE)[-1]))
    client.running, client.q = False, list(AWAY)
    monitor(0.5)
    client.fraction = 0.0
    assert_well_said(said(monitor(0.01, MOVE)[-1]))
    assert_well_said(said(monitor(0.01, PATH)[-1]))
    client.fraction, client.q = 1.0, [0.0] * 6
    assert_well_said(said(monitor(0.01, PATH)[-1]))


def refuse(*_: object) -> bool:
    raise RuntimeError("servoJ: the client said no")


ON_A_PATH: dict[str, tuple[Callable[[DelayedClient], object], str]] = {
    "late": (lambda client: client.now.__setitem__(0, client.now[0] + 0.2), "late by 0.20 s with the next position"),
    "refused": (lambda client: setattr(client, "servoJ", refuse), "the RTDE client refused a position of the path"),
    "not taken": (lambda client: setattr(client, "servoJ", lambda *_: False), "did not take a position of the path"),
    "not ended": (lambda client: setattr(client, "servoStop", lambda *_: False), "did not take a position of the path"),
    "slider": (lambda client: setattr(client, "fraction", 0.5), "its speed slider was moved while it followed a path"),
    "left behind": (lambda client: setattr(client, "q", [0.0] * 6), "rad away from the path that it was to follow"),
    "protective": (lambda client: setattr(client, "safety", 3), "protective stop"),
    "ended": (lambda client: setattr(client, "servoJ", client.end_program), "its program ended"),
}


@pytest.mark.parametrize("cause", ON_A_PATH)
def test_what_ends_a_path(delayed: Delayed, cause: str) -> None:
    client, monitor = delayed
    client.running, client.q = False, list(AWAY)
    monitor(0.5)
    assert "ok" in monitor(0.1, {**PATH, "q": [list(AWAY)] * 60})[-1]
    known = len(monitor(0.0, {"do": "settled"}))
    act, words = ON_A_PATH[cause]
    act(client)
    told, answer = monitor(2.0)[known:]
    assert said(told) == said(answer)
    assert words in said(answer)
    assert_well_said(said(answer))


NOT_STARTED: dict[str, tuple[Callable[[DelayedClient], object], str]] = {
    "local": (lambda client: setattr(client, "local", True), "the pendant is in local control"),
    "not uploaded": (lambda client: setattr(client, "setCustomScriptFile", refuse), "could not be uploaded"),
    "not started": (lambda client: setattr(client, "setCustomScriptFile", lambda _: None), "did not start within"),
    "not ended": (lambda client: setattr(client, "isProgramRunning", lambda: True), "was stopped but still runs"),
    "no watchdog": (lambda client: setattr(client, "setWatchdog", lambda _: False), "it refused the watchdog"),
}


@pytest.mark.parametrize("cause", NOT_STARTED)
def test_a_program_that_does_not_start_again(delayed: Delayed, monkeypatch: Any, cause: str) -> None:
    client, monitor = delayed
    monkeypatch.setattr(ur_control, "_PROGRAM_WITHIN_S", 0.1)
    monkeypatch.setattr(ur_control, "in_local_control", lambda host, within_s: client.local)
    client.running, client.q = False, list(AWAY)
    monitor(0.5)
    monitor(0.3, {"brake": True})
    client.playing = False
    monitor(0.1, {"do": "release"})
    act, words = NOT_STARTED[cause]
    act(client)
    answer = monitor(0.01, MOVE)[-1]
    assert words in said(answer)
    assert_well_said(said(answer))


def test_a_motion_that_takes_too_long(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running, client.fraction = True, 0.0
    slow = said(monitor(6.0, {"do": "settled"})[-1])
    assert "it did not come to rest within 5 s; it stands, because the speed slider is at 0 %" in slow
    assert_well_said(slow)


ENDS: dict[str, tuple[Callable[[DelayedClient], object], str, str]] = {
    "broken": (lambda client: setattr(client, "isConnected", lambda: False), "link", "the RTDE link broke"),
    "broken on a path": (lambda client: setattr(client, "servoJ", client.break_link), "link", "the RTDE link broke"),
    "broken in a motion": (lambda client: setattr(client, "moveJ", client.break_link), "link", "the RTDE link broke"),
    "not a number": (lambda client: setattr(client, "q", [float("nan")] * 6), "nonsense", "that are no numbers"),
    "malformed": (lambda client: setattr(client, "safety", 0), "nonsense", "its state has no safety mode"),
    "five joints": (lambda client: setattr(client, "q", [0.0] * 5), "link", "not one of six joints"),
}


@pytest.mark.parametrize("cause", ENDS)
def test_what_ends_the_worker(delayed: Delayed, monkeypatch: pytest.MonkeyPatch, cause: str) -> None:
    client, monitor = delayed
    monkeypatch.setattr(os, "_exit", sys.exit)
    client.q = list(AWAY)
    monitor(0.5)
    act, kind, words = ENDS[cause]
    act(client)
    with pytest.raises(SystemExit):
        monitor(1.0, MOVE if "motion" in cause else {**PATH, "q": [list(AWAY)] * 60})
    monkeypatch.setattr(client.supervisor, "stream", lambda: None)
    monkeypatch.setattr(client.supervisor, "monitor", lambda: None)
    told, lost = (answer for answer in monitor(0.01) if "ok" not in answer)
    assert (told["fault"], lost["kind"], lost["lost"]) == (kind, kind, told["text"])
    assert words in told["text"]
    assert_well_said(said(told))


@pytest.mark.parametrize("text", ["enable remote control", "already in use", "boost: 7"])
def test_a_client_that_does_not_start(text: str) -> None:
    refusal: Refusal = _open_refusal(text)
    assert_well_said(str(arm_error("left", refusal.kind, refusal.text)))


@pytest.mark.parametrize("kind", REFUSALS)
def test_each_kind_without_a_remedy_of_its_own_has_one_in_its_text(kind: str) -> None:
    own = kind in ("protective", "emergency", "local", "advised", "occupied")
    assert bool(TO_DO.search(str(arm_error("left", kind, "something is wrong")))) is not own


# -- what the application finds ---------------------------------------------------------------------------------------

EXPECTED = UrExpectation(
    "UR10",
    None,
    JointLimits(np.tile([-6.0, 6.0], (6, 1)), np.full(6, 2.0), np.full(6, 8.0)),
    payload_kg=0.35,
    payload_center_m=np.array([0.0, 0.0, 0.03]),
    tcp=np.array([0.0, 0.0, 0.06, 0.0, 0.0, 0.0]),
)
SAMPLE = UrSample(1.0, (0.0,) * 6, (0.0,) * 6, "RUNNING", "NORMAL", "STOPPED", 1.0, 0.35, (0.0, 0.0, 0.03))
PROBE = UrProbe(
    host="192.168.0.10",
    software="3.15.8",
    series="CB3",
    model="UR10",
    serial=None,
    robot_mode="RUNNING",
    safety_mode="NORMAL",
    safety_status=None,
    remote_control=None,
    program_running=False,
    ports={},
    kinematics=None,
    kinematics_note="",
    tcp=(0.0, 0.0, 0.06, 0.0, 0.0, 0.0),
    sample=SAMPLE,
)


@pytest.fixture
def lonely() -> UrArm:
    """An arm whose controller has gone, with a program that may run."""
    arm = UrArm("left", UrSettings(host=own_address(47)), expectation("left"), rest_s=0.1)
    arm._program.started()
    return arm


def test_a_stop_that_is_not_confirmed_is_said_once(lonely: UrArm) -> None:
    for stop in (lonely.brake, lonely.stop, lonely.disconnect):
        with pytest.raises(LinkLost, match="treat it as moving until you see it at rest") as raised:
            stop()
        assert "its stop was not confirmed" in str(raised.value)
        assert_well_said(str(raised.value))


REASONS = {
    "link": (LinkLost, "no state came for 0.3 s"),
    "driver": (LinkLost, "its driver process ended (signal 9)"),
    "nonsense": (LinkLost, "the controller reports positions or speeds of its joints that are no numbers"),
    "stalled": (HostStalled, "this computer was silent for 3.1 s (suspended, or too busy): the RTDE link broke"),
}


@pytest.mark.parametrize("kind", REASONS)
def test_a_link_of_unknown_state(lonely: UrArm, kind: str) -> None:
    error, why = REASONS[kind]
    heard: list[ArmError] = []
    lonely.watch(heard.append)
    lonely._first_fault.report()
    raised = lonely._link_fault(why, kind)
    assert type(raised) is type(heard[0]) is error
    for told in (raised, heard[0]):
        assert why in str(told)
        assert_well_said(str(told))


FAULT = {"kind": "failed", "text": "it left its rest without being asked"}


def worker_that(answers: Callable[..., dict[str, Any]]) -> Any:
    """A worker process that lives and answers requests like this."""
    alive = {"has_ended": False, "brake": lambda *_: True, "kill": lambda: None, "gaps": HeartbeatGaps()}
    return SimpleNamespace(call=answers, **alive)


def test_a_worker_that_does_not_release_its_arm_is_killed(lonely: UrArm, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> NoReturn:
        raise WorkerGone("its driver process ended (signal 9)")

    monkeypatch.setattr(lonely._stop_line, "stop", lambda: None)
    monkeypatch.setattr(lonely._program, "wait_at_rest", lambda: None)
    lonely._worker = worker_that(gone)
    with pytest.raises(LinkLost, match="the stop failed: its driver process ended") as raised:
        lonely.stop()
    assert_well_said(str(raised.value))
    assert lonely._worker is None


def test_a_fault_is_told_rather_than_the_stop_that_followed(lonely: UrArm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lonely._stop_line, "confirm", lambda patience: None)
    lonely._worker = worker_that(lambda *_: {"fault": FAULT})
    with pytest.raises(ArmError, match="it left its rest"):
        lonely.confirm()
    lonely._report_fault("protective", "protective stop: go to the arm, see what stopped it")
    told = lonely._fault_or(MotionStopped("arm left: it was stopped"))
    assert "it left its rest" in str(told)
    lonely._worker = worker_that(lambda *_: {"fault": None})
    assert isinstance(lonely._fault_or(MotionStopped("arm left: it was stopped")), ProtectiveStop)


def test_joints_that_cannot_be_recorded() -> None:
    with pytest.raises(LinkLost, match=r"arm left: its joints are not recorded: .* no RTDE connection"):
        UrRecorder("left", own_address(47), 0.008)


def test_a_dashboard_that_is_lost(lonely: UrArm) -> None:
    with pytest.raises(LinkLost) as raised:
        lonely.connect()
    assert str(raised.value).startswith("arm left: ")
    assert_well_said(str(lonely._dashboard_lost("127.0.0.2:29999: no connection to the UR dashboard (refused)")))


CHANGES: dict[str, dict[str, Any]] = {
    **{mode: {"safety_mode": mode} for mode in MODES},
    "robot mode": {"robot_mode": "POWER_OFF"},
    "local": {"series": "e-Series", "remote_control": False},
    "a program runs": {"program_running": True},
    "a port": {"ports": {30004: False}},
    "no state": {"sample": None, "sample_note": "192.168.0.10:30004: no RTDE connection (refused)"},
    "it moves": {"sample": replace(SAMPLE, qd=(1.0,) * 6)},
    "slider": {"sample": replace(SAMPLE, speed_fraction=0.0)},
    "payload": {"sample": replace(SAMPLE, payload_kg=1.0)},
    "TCP": {"tcp": (0.0,) * 6},
    "model": {"model": "UR3"},
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_keeps_an_arm_from_being_connected(lonely: UrArm, change: str) -> None:
    found = checks(EXPECTED, replace(PROBE, **CHANGES[change]))
    assert any(check.status == "failed" for check in found)
    with pytest.raises(ArmError) as raised:
        lonely._raise_failed(found)
    assert_well_said(str(raised.value))


# -- why a process ended ----------------------------------------------------------------------------------------------


def test_a_client_that_fails_ends_its_process_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it would end with exit code 1, and the cause with it."""

    class Failing:
        patience_s = 0.0

        def stream(self) -> None:
            raise RuntimeError("unable to get state data for specified key: robot_status")

    def end(code: int) -> None:
        raise SystemExit(code)

    answers = io.BytesIO()
    worker = ur_worker.Worker(answers)
    monkeypatch.setattr(worker, "_supervisor", Failing())
    monkeypatch.setattr(os, "_exit", end)
    with pytest.raises(SystemExit, match="3"):
        worker.run()
    hello, told, lost = map(json.loads, answers.getvalue().splitlines())
    assert "hello" in hello
    reason = "its RTDE client failed (unable to get state data for specified key: robot_status)"
    assert (told["text"], lost["lost"], lost["kind"]) == (reason, reason, "link")
    assert_well_said(str(arm_error("left", told["fault"], told["text"])))


# -- Doubts about a UR arm: none is lost before somebody listens, and a later one of another kind is reported too ------


def test_a_fault_that_came_before_anybody_listened_is_delivered() -> None:
    told, heard = FirstFault(), list[ArmError]()
    told.report()
    told.note(LinkLost("silent"), "silent")
    told.watch(heard.append)
    assert [str(error) for error in heard] == ["silent"]
    told.note(ProtectiveStop("stopped"), "stopped")
    assert [str(error) for error in heard] == ["silent", "stopped"]


def test_doubts_while_connecting_are_reported_when_connected() -> None:
    told, heard = FirstFault(), list[ArmError]()
    told.watch(heard.append)
    told.note(HostStalled("stalled"), "stalled")
    told.note(ProtectiveStop("stopped"), "stopped")
    assert heard == []
    told.report()
    told.report()
    assert [str(error) for error in heard] == ["stalled", "stopped"]
    assert isinstance(told.error, HostStalled)


def test_one_of_each_kind_until_it_is_cleared() -> None:
    told, heard = FirstFault(), list[ArmError]()
    told.report()
    told.watch(heard.append)
    for _ in range(3):
        told.note(LinkLost("silent"), "silent")
    assert len(heard) == 1
    told.clear()
    assert told.error is None
    told.note(LinkLost("silent again"), "silent again")
    assert [str(error) for error in heard] == ["silent", "silent again"]
    told.mute()
    told.note(ProtectiveStop("stopped"), "stopped")
    assert len(heard) == 2


# -- The dashboard connection for stops, against dashboards that behave badly: what is taken for a loss, and how soon --

HOST = "127.0.0.1"
GREETING = b"Connected: Universal Robots Dashboard Server\n"
Answer = Callable[[socket.socket, str], bool]
"""Answers one line; whether to serve on."""


def well(link: socket.socket, line: str) -> bool:
    link.sendall(b"Stopped\n" if line == "stop" else b"Program running: false\n")
    return True


def slow(link: socket.socket, line: str) -> bool:
    pause(0.02)
    return well(link, line)


def hang_up(link: socket.socket, line: str) -> bool:
    return False


def chatter(link: socket.socket, line: str) -> bool:
    link.sendall(b"Program running: false\nand nobody asked for this\n")
    return True


@contextmanager
def dashboard(answer: Answer) -> Iterator[int]:
    """A dashboard on a port of its own; ends with its clients."""
    server = socket.create_server((HOST, 0))
    links: list[socket.socket] = []

    def serve(link: socket.socket) -> None:
        with link, suppress(OSError):
            link.sendall(GREETING)
            for line in link.makefile(encoding="ascii"):
                if not answer(link, line.strip()):
                    link.shutdown(socket.SHUT_RDWR)
                    return

    def accept() -> None:
        with suppress(OSError):
            while True:
                links.append(server.accept()[0])
                threading.Thread(target=serve, args=(links[-1],), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield server.getsockname()[1]
    finally:
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join(PATIENT_S)
        for link in links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            link.close()


@contextmanager
def opened(port: int) -> Iterator[tuple[StopLine, list[str]]]:
    lost: list[str] = []
    line = StopLine(HOST, lost.append, port=port)
    line.open()
    try:
        yield line, lost
    finally:
        line.close()


def test_a_dashboard_that_answers_is_no_loss_and_stops() -> None:
    with dashboard(well) as port, opened(port) as (line, lost):
        for _ in range(10):
            line.confirm(Patience(0.3))
            line.stop()
            pause(0.03)
        assert lost == []


def test_answers_reach_those_who_asked_in_order() -> None:
    """Stops of many threads among questions: none gets the answer to another line."""
    with dashboard(slow) as port, opened(port) as (line, lost):
        sent = sure(line._line)
        waiting = [(text, sent.send(text)) for text in ("running", "stop", "running", "stop", "stop")]
        for text, answer in waiting:
            assert answer.get(timeout=PATIENT_S) == ("Stopped" if text == "stop" else "Program running: false")
        assert lost == []


@pytest.mark.parametrize("answer", [hang_up, chatter])
def test_a_peer_that_ends_every_connection_is_lost_and_not_asked_without_pause(answer: Answer) -> None:
    asked: list[float] = []

    def counted(link: socket.socket, line: str) -> bool:
        asked.append(time.monotonic())
        return answer(link, line)

    with dashboard(counted) as port, opened(port) as (_, lost):
        until(lambda: answer is chatter or bool(lost), "it is lost")
        pause(0.5)
        assert len(asked) < 25


# -- Nobody who asks a UR arm gets "at rest" from it while it moves or has accepted a motion, even if its client lags --

STATE = {"do": "state"}
LOOP = [list(HOME)] * 5
PATH_OF_REST = {"do": "path", "q": LOOP, "period_s": 0.008, "lookahead_s": 0.1, "gain": 300}


def moving(answers: list[dict[str, Any]]) -> bool:
    return bool(answers[-1]["ok"]["moving"])


def brake(client: DelayedClient, monitor: Monitor) -> None:
    monitor(0.01, {"brake": True})


def protective_stop(client: DelayedClient, monitor: Monitor) -> None:
    client.safety = 3
    monitor(0.01)


def end(client: DelayedClient, monitor: Monitor) -> None:
    client.running, client.q = False, list(AWAY)
    monitor(0.01)


@pytest.mark.parametrize("stop", [brake, protective_stop, end])
def test_an_arm_whose_motion_has_just_ended_may_still_move(
    delayed: Delayed, stop: Callable[[DelayedClient, Monitor], None]
) -> None:
    """Its states are older than what was done, and show the rest of before."""
    client, monitor = delayed
    client.running = True
    assert moving(monitor(0.1, STATE))
    stop(client, monitor)
    assert moving(monitor(0.01, STATE))
    monitor(0.2)
    assert not moving(monitor(0.01, STATE))


def test_an_arm_that_brakes_for_long_moves_until_it_rests(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running, client.speed = True, 0.5
    brake(client, monitor)
    client.speed = 0.004  # below what counts as motion, for less than the dwell
    monitor(0.03)
    client.speed = 0.5
    monitor(0.3)
    client.speed = 0.0
    assert moving(monitor(0.01, STATE))
    monitor(0.2)
    assert not moving(monitor(0.01, STATE))


def test_another_motion_is_refused_until_the_arm_was_seen_at_rest(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running = True
    assert "still moving" in monitor(0.01, MOVE)[-1]["text"]
    client.running, client.speed = False, 0.5  # its program reports the end, but it moves
    monitor(0.3)
    assert "still moving" in monitor(0.01, MOVE)[-1]["text"]
    assert "still moving" in monitor(0.01, PATH_OF_REST)[-1]["text"]


def test_old_positions_at_the_end_of_a_closed_path_do_not_end_it(
    delayed: Delayed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends where it began, and the states come late: those of before look like those of the end."""
    client, monitor = delayed
    end(client, monitor)
    monitor(1.2)
    monkeypatch.setattr(client, "tick", lambda seconds: setattr(client, "stamp", client.stamp + 1e-6))
    monitor(0.01, {**PATH_OF_REST, "q": [client.q] * 5})
    stood = client.stamp
    monitor(0.2)
    assert client.stamp - stood < 0.01
    assert moving(monitor(0.01, STATE))


def sample(time_s: float, speed: float) -> UrSample:
    zeros = (0.0,) * 6
    return UrSample(time_s, zeros, (speed, *zeros[1:]), "RUNNING", "NORMAL", "PLAYING", 1.0, None, None, zeros)


def test_rest_counts_only_from_states_after_the_end_and_for_a_while() -> None:
    unrest = Unrest()
    assert not unrest.may_move
    unrest.begin()
    for k in range(100):  # it stands, but a motion runs
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=True)
    assert unrest.may_move
    unrest.end(1.0)
    for k in range(100, 105):  # states of these 0.05 s may be from before the end
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=False)
    assert unrest.may_move
    for k in range(105, 112):
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=False)
    assert not unrest.may_move


# -- Payload, TCP and speed slider, checked again once the control program runs; and requests that are refused unsent --


@pytest.mark.parametrize("rows", [np.zeros(6), np.zeros((2, 5)), np.array([[0.0] * 6, [np.nan] * 6])])
def test_rows_that_are_no_joint_positions_are_not_asked(rows: np.ndarray) -> None:
    with pytest.raises(LimitExceeded, match="arm left: "):
        checked_rows("left", rows)
