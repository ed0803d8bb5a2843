"""Messages about a UR arm, cause by cause of the chapter on faults: which arm, what was seen, what to do, each once."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.arms import ur_worker
from drivers.arms.protocol import ArmError, EmergencyStop, HostStalled, LinkLost, NotInRemoteControl, ProtectiveStop
from drivers.arms.ur import UrArm
from drivers.arms.ur_checks import checks
from drivers.arms.ur_control import Refusal, _open_refusal
from drivers.arms.ur_guarded_link import REFUSALS, arm_error, arm_state
from drivers.arms.ur_settings import UrSettings
from drivers.arms.ur_worker_process import last_words
from tests.drivers.arms.delayed_client import DelayedClient, Monitor
from tests.drivers.arms.emulated_ur_cell import AWAY, expectation
from tests.drivers.arms.test_ur_checks import EXPECTED, PROBE
from tests.loopback import own_address

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
    kind = refusal.get("doubt") or refusal["error"]
    return str(arm_error("left", kind, refusal["text"]))


# -- what the worker reports ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_safety_mode_says_what_to_do_in_the_doubt_the_error_and_the_state(delayed: Delayed, mode: str) -> None:
    client, monitor = delayed
    client.running = True
    client.safety, error = MODES[mode]
    doubt, answer = monitor(0.05)[:2]
    assert said(doubt) == said(answer)
    assert_well_said(said(doubt))
    assert type(arm_error("left", doubt["doubt"], doubt["text"])) is error
    state = arm_state(monitor(0.01, {"do": "state"})[-1]["ok"], 0.005)
    assert not state.ready
    assert_well_said(f"arm left: not ready: {state.reason}")
    assert_well_said(said(monitor(0.01, MOVE)[-1]))


def pendant(client: DelayedClient) -> None:
    client.playing = False


def local(client: DelayedClient) -> None:
    client.playing, client.local = False, True


def cut_short(client: DelayedClient) -> None:
    client.running = False


def power(client: DelayedClient) -> None:
    client.mode = 3


WORKER: dict[str, tuple[Callable[[DelayedClient], None], type[ArmError], str]] = {
    "stopped on the pendant": (pendant, ArmError, "its program was stopped on the pendant"),
    "local control": (local, NotInRemoteControl, "the pendant is in local control"),
    "cut short": (cut_short, ArmError, "its motion was cut short"),
    "no power": (power, ArmError, "robot mode POWER_OFF, needed is RUNNING"),
}


@pytest.mark.parametrize("cause", WORKER)
def test_what_ends_a_motion(delayed: Delayed, cause: str) -> None:
    client, monitor = delayed
    client.running = True
    monitor(0.1)
    act, error, words = WORKER[cause]
    act(client)
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


def test_a_motion_that_takes_too_long(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running, client.fraction = True, 0.0
    slow = said(monitor(6.0, {"do": "settled"})[-1])
    assert "it did not come to rest within 5 s; it stands, because the speed slider is at 0 %" in slow
    assert_well_said(slow)


ENDS: dict[str, tuple[Callable[[DelayedClient], object], str, str]] = {
    "broken": (lambda client: setattr(client, "isConnected", lambda: False), "link", "the RTDE link broke"),
    "not a number": (lambda client: setattr(client, "q", [float("nan")] * 6), "nonsense", "that are no numbers"),
    "five joints": (lambda client: setattr(client, "q", [0.0] * 5), "link", "not one of six joints"),
}


@pytest.mark.parametrize("cause", ENDS)
def test_what_ends_the_worker(delayed: Delayed, monkeypatch: pytest.MonkeyPatch, cause: str) -> None:
    client, monitor = delayed
    monkeypatch.setattr(os, "_exit", sys.exit)
    act, kind, words = ENDS[cause]
    act(client)
    with pytest.raises(SystemExit):
        monitor(1.0)
    monkeypatch.setattr(client.supervisor, "stream", lambda: None)
    monkeypatch.setattr(client.supervisor, "monitor", lambda: None)
    doubt, lost = monitor(0.01)
    assert (doubt["doubt"], lost["kind"], lost["lost"]) == (kind, kind, doubt["text"])
    assert words in doubt["text"]
    assert_well_said(said(doubt))


@pytest.mark.parametrize("text", ["enable remote control", "before timeout of 5 seconds", "already in use", "boost: 7"])
def test_a_client_that_does_not_start(text: str) -> None:
    refusal: Refusal = _open_refusal(text)
    assert_well_said(str(arm_error("left", refusal.kind, refusal.text)))


@pytest.mark.parametrize("kind", REFUSALS)
def test_each_kind_without_a_remedy_of_its_own_has_one_in_its_text(kind: str) -> None:
    own = kind in ("protective", "emergency", "local", "advised")
    assert bool(TO_DO.search(str(arm_error("left", kind, "something is wrong")))) is not own


# -- what the application finds ---------------------------------------------------------------------------------------


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
def test_a_link_in_doubt(lonely: UrArm, kind: str) -> None:
    error, why = REASONS[kind]
    heard: list[ArmError] = []
    lonely.watch(heard.append)
    lonely._doubt.report()
    raised = lonely._link_in_doubt(why, kind)
    assert type(raised) is type(heard[0]) is error
    for told in (raised, heard[0]):
        assert why in str(told)
        assert_well_said(str(told))


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
    "it moves": {"sample": replace(PROBE.sample, qd=(1.0,) * 6) if PROBE.sample else None},
    "slider": {"sample": replace(PROBE.sample, speed_fraction=0.0) if PROBE.sample else None},
    "payload": {"sample": replace(PROBE.sample, payload_kg=1.0) if PROBE.sample else None},
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

HUNG = b"""Timeout (0:00:05)!
Thread 0x00007f1 (most recent call first):
  File "/a/ur_worker.py", line 12 in read
  File "/a/threading.py", line 3 in run

Thread 0x00007f2 (most recent call first):
  File "/a/ur_control.py", line 7 in tcp
  File "/a/ur_supervisor.py", line 9 in begin
"""


MAIN_THREAD = 'File "/a/ur_control.py", line 7 in tcp File "/a/ur_supervisor.py", line 9 in begin'


@pytest.mark.parametrize(
    ("written", "words"),
    [
        (b"", ""),
        (b"Traceback:\n  File x\nRuntimeError: getTCPOffset() failed\n\n", ": RuntimeError: getTCPOffset() failed"),
        (b"\xff\x00\n", ": \ufffd?"),
        (
            HUNG,
            ': Timeout (0:00:05)! File "/a/ur_control.py", line 7 in tcp File "/a/ur_supervisor.py", line 9 in begin',
        ),
    ],
)
def test_the_last_words_of_a_process(written: bytes, words: str) -> None:
    assert last_words(written.splitlines(keepends=True)) == words


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
    hello, doubt, lost = map(json.loads, answers.getvalue().splitlines())
    assert "hello" in hello
    reason = "its RTDE client failed (unable to get state data for specified key: robot_status)"
    assert (doubt["text"], lost["lost"], lost["kind"]) == (reason, reason, "link")
    assert_well_said(str(arm_error("left", doubt["doubt"], doubt["text"])))
