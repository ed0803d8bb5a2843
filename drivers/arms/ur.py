"""A Universal Robots arm, moved through ur_rtde in a process of its own that can be ended at any moment.

Whatever that client does (it hangs, it crashes with the link, it believes stale states), three things hold: every call
here returns in bounded time; on any doubt the worker process is ended, the controller is told to stop over a dashboard
connection of its own and the arm is watched over an RTDE connection of its own; and if even that fails, the watchdog
of the controller stops the program, because nobody keeps it content any more.

After a fault nothing moves until ``connect`` was called anew. A protective stop is never released from here.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import drivers
from drivers.arms.protocol import (
    ArmError,
    ArmIdentity,
    ArmState,
    ArmTimeout,
    EmergencyStop,
    JointLimits,
    LimitExceeded,
    LinkLost,
    NotInRemoteControl,
    ProtectiveStop,
    Tool,
    WrongRobot,
    stale,
)
from drivers.arms.ur_checks import JOINTS, Check, UrExpectation, checks, safety_error, safety_remedy
from drivers.arms.ur_links import stop_program
from drivers.arms.ur_probe import UrProbe, probe_ur
from drivers.arms.ur_rtde_reader import wait_at_rest
from drivers.arms.ur_settings import UrSettings

KINDS: Mapping[str, type[ArmError]] = {
    "protective": ProtectiveStop,
    "emergency": EmergencyStop,
    "local": NotInRemoteControl,
    "link": LinkLost,
    "timeout": ArmTimeout,
    "failed": ArmError,
}
"""What a worker's kinds of refusal are here."""
_REMEDIES = {
    "protective": safety_remedy("PROTECTIVE_STOP"),
    "emergency": safety_remedy("ROBOT_EMERGENCY_STOP"),
}
LONGEST_PROBE_S = 5.0
LONGEST_BRAKING_S = 3.0
"""Several times what a UR arm takes to brake from full speed."""

_HELLO_WITHIN_S = 10.0
_ANSWER_WITHIN_S = 2.0
_STOP_WITHIN_S = 1.0
_MARGIN_S = 1.0
_ROUNDING_RAD = 1e-9
_LIMIT_SLACK = 1e-6


class _Gone(Exception):
    """The worker process ended, or gave no answer in time; a sentence says why."""


class _Worker:
    """The worker process as seen from here. Calls may come from several threads."""

    def __init__(self, name: str) -> None:
        root = str(Path(drivers.__file__).parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.arms.ur_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # a Ctrl-C in the terminal does not reach it
        )
        self._lock = threading.Lock()
        self._number = 0
        self._pending: dict[int, queue.SimpleQueue[dict[str, Any] | None]] = {}
        self._hello: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._ended = ""
        self._reader = threading.Thread(target=self._read, name=f"UR worker of {name}", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def ended(self) -> str:
        """Why the process is no more; empty while it lives."""
        return self._ended

    def wait_hello(self, timeout_s: float) -> None:
        """Wait until it serves. Raises ``_Gone``."""
        try:
            self._hello.get(timeout=timeout_s)
        except queue.Empty:
            raise _Gone(f"its driver process did not start within {timeout_s:g} s") from None
        if self._ended:
            raise _Gone(self._ended)

    def call(self, do: str, within_s: float, **arguments: Any) -> dict[str, Any]:
        """The answer to one request. Raises ``_Gone``, or ``_Refused`` with the worker's words."""
        answered: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        with self._lock:
            if self._ended:
                raise _Gone(self._ended)
            self._number += 1
            number = self._number
            self._pending[number] = answered
            try:
                assert self._process.stdin is not None
                self._process.stdin.write(json.dumps({"id": number, "do": do, **arguments}).encode("ascii") + b"\n")
                self._process.stdin.flush()
            except OSError as error:
                raise _Gone(f"its driver process takes no requests ({error})") from error
        try:
            answer = answered.get(timeout=within_s)
        except queue.Empty:
            raise _Gone(f"no answer to '{do}' within {within_s:g} s") from None
        finally:
            with self._lock:
                self._pending.pop(number, None)
        if answer is None:
            raise _Gone(self._ended)
        if "error" in answer:
            raise _Refused(str(answer["error"]), str(answer["text"]))
        return dict(answer["ok"])

    def kill(self) -> None:
        """End the process now; harmless when it has ended."""
        self._process.kill()
        self._finish()

    def let_go(self, timeout_s: float) -> None:
        """Let it end by itself: it stops the program if it can. Killed if it does not end in time."""
        with self._lock, suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        self.kill()

    def _finish(self) -> None:
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()

    def _read(self) -> None:
        why = ""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.endswith(b"\n"):  # it was ended in the middle of a line
                break
            answer = json.loads(line)
            if "hello" in answer:
                self._hello.put(None)
            elif "lost" in answer:
                why = str(answer["lost"])
            else:
                with self._lock:
                    waiting = self._pending.get(int(answer["id"]))
                if waiting is not None:
                    waiting.put(answer)
        code = self._process.wait()
        with self._lock:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            self._ended = why or f"its driver process ended ({how})"
            for waiting in self._pending.values():
                waiting.put(None)
        self._hello.put(None)


class _Refused(Exception):
    """The worker answered that it will not, or that the arm did not."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


class UrArm:
    """One UR arm. ``stop`` may be called from any thread, the rest from one at a time."""

    def __init__(
        self, name: str, settings: UrSettings, expected: UrExpectation, *, rest_s: float = LONGEST_BRAKING_S
    ) -> None:
        """Nothing is opened yet. ``rest_s`` is how long an arm in doubt is watched until it is at rest [s]."""
        self._name = name
        self._host = settings.host
        self._expected = expected
        self._settings = settings
        self._rest_s = rest_s
        self._worker: _Worker | None = None
        self._fault: ArmError | None = None
        self._ours = False
        """Whether a program of ours may be on the controller, and so a motion of ours under way."""
        self._said: UrProbe | None = None
        self._serial = ""
        self._checksum: str | None = expected.checksum
        self._warnings: tuple[str, ...] = ()
        self._limits = expected.limits

    # -- the protocol --------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """The arm's name in the profile."""
        return self._name

    def connect(self) -> None:
        """Look at the controller over plain sockets, refuse what is not as it should be, then start the client.

        Called after a fault it does all of this anew; what was left of our program is stopped first. Harmless when
        connected and well. See the protocol for what it raises.
        """
        if self._well():
            return
        self._drop_worker()
        said = self._probe()
        self._refuse([check for check in checks(self._expected, said) if check.subject not in ("program", "state")])
        program = "" if said.sample is None else said.sample.program
        if program != "STOPPED" and (self._ours or program in ("PAUSED", "PAUSING")):
            self._bring_to_rest()
            said = self._probe()
        found = checks(self._expected, said)
        self._refuse(found)
        self._same_controller(said)
        self._start_client(said)
        self._said = said
        self._limits = _tighter(self._expected.limits, said.limits)
        self._note(found, said)

    def identify(self) -> ArmIdentity:
        """Who the controller said it is when it was connected."""
        said = self._connected()
        kinematics = said.kinematics
        return ArmIdentity(
            model=said.full_model or "",
            serial=said.serial or "",
            software=said.software,
            dh_rows=None if kinematics is None else kinematics.rows,
            dh_checksum="" if kinematics is None else kinematics.checksum,
        )

    def limits(self) -> JointLimits:
        """The narrower of what the controller allows and what was asked for."""
        self._connected()
        return self._limits

    def tool(self) -> Tool:
        """What the controller reckoned with when it was connected."""
        said = self._connected()
        sample = said.sample
        center = None if sample is None else sample.payload_center_m
        return Tool(
            payload_kg=None if sample is None else sample.payload_kg,
            payload_center_m=None if center is None else np.array(center),
            tcp=None if said.tcp is None else np.array(said.tcp),
        )

    def warnings(self) -> tuple[str, ...]:
        """What the last ``connect`` found that does not keep the arm from moving."""
        return self._warnings

    def state(self) -> ArmState:
        """The first state that the controller sends after this call."""
        return self._arm_state(self._call("state", _ANSWER_WITHIN_S))

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (6,), all joints together; no joint exceeds its speed or acceleration (6,).

        Raises ``LimitExceeded`` before anything is sent, else as the protocol says.
        """
        goal = self._within_limits(q)
        speeds = self._rates("speed", "rad/s", speed, self._limits.speed)
        accelerations = self._rates("acceleration", "rad/s^2", acceleration, self._limits.acceleration)
        self._connected()
        timeout = self._settings.startup_timeout
        self._ours = True
        self._call(
            "move",
            timeout,
            q=goal.tolist(),
            speed=speeds.tolist(),
            acceleration=accelerations.tolist(),
            timeout_s=timeout + _MARGIN_S,
        )

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the motion has ended and the arm rests at its end, or what stopped it is known.

        Raises ``ArmTimeout`` (the motion goes on), or what stopped the arm: then nothing moves until ``connect``.
        """
        timeout = max(timeout_s, 0.0)
        try:
            answer = self._call("settled", timeout + _ANSWER_WITHIN_S, timeout_s=timeout)
        except ArmTimeout:
            raise ArmTimeout(f"arm {self._name} did not come to rest within {timeout_s:g} s") from None
        return self._arm_state(answer)

    def stop(self) -> None:
        """Stop the controller's program and see the arm at rest; harmless when nothing of ours runs.

        Raises ``LinkLost`` if the arm could not be told or seen; its watchdog then stops it.
        """
        if not self._ours:
            return
        worker = self._worker
        if worker is None or worker.ended or isinstance(self._fault, LinkLost):
            self._drop_worker()
            self._bring_to_rest()
            return
        try:
            stop_program(self._host, _STOP_WITHIN_S)
            worker.call("halt", _ANSWER_WITHIN_S)
            wait_at_rest(self._host, self._rest_s)
        except (LinkLost, _Gone, _Refused) as error:
            raise self._doubt(f"it could not be told to stop: {error}") from error

    def disconnect(self) -> None:
        """Stop the arm and its program, and let go: nothing of ours stays on the controller. Harmless when closed."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.let_go(3.0 * _STOP_WITHIN_S)
        self._said, self._fault = None, None
        if self._ours:
            self._bring_to_rest()

    @property
    def worker_pid(self) -> int | None:
        """The process that holds the client, for those who test what happens when it dies; None without one."""
        return None if self._worker is None else self._worker.pid

    # -- connecting ----------------------------------------------------------------------------------------------------

    def _well(self) -> bool:
        """Whether the client is there and remembers no fault."""
        if self._worker is None or self._said is None:
            return False
        with suppress(_Gone, _Refused):
            return self._worker.call("state", _ANSWER_WITHIN_S)["fault"] is None
        return False

    def _probe(self) -> UrProbe:
        try:
            return probe_ur(self._host, min(self._settings.timeout, LONGEST_PROBE_S))
        except LinkLost as error:
            raise LinkLost(f"arm {self._name}: {error}") from error

    def _refuse(self, found: list[Check]) -> None:
        failed = [check for check in found if check.status == "failed"]
        if failed:
            reasons = "; ".join(f"{check.subject}: {check.text}" for check in failed)
            raise failed[0].error(f"arm {self._name}: not moved: {reasons}")

    def _same_controller(self, said: UrProbe) -> None:
        """After a fault, the controller that answers is the one from before."""
        if self._serial and said.serial and said.serial != self._serial:
            raise WrongRobot(
                f"arm {self._name}: the controller at {self._host} is now {said.serial}, it was {self._serial} before"
            )
        self._serial = said.serial or self._serial

    def _start_client(self, said: UrProbe) -> None:
        worker = _Worker(self._name)
        self._worker = worker
        self._fault = None
        timeout = self._settings.startup_timeout
        payload = said.sample is not None and said.sample.payload_kg is not None
        try:
            worker.wait_hello(_HELLO_WITHIN_S)
            self._ours = True
            worker.call(
                "open",
                timeout,
                host=self._host,
                payload=payload,
                watchdog_hz=self._settings.watchdog_hz,
                settle_s=self._settings.settle_time,
                settle_speed=self._settings.settle_speed,
                settle_position=self._settings.settle_window,
                timeout_s=timeout + _MARGIN_S,
            )
        except _Refused as error:
            self._drop_worker()
            with suppress(LinkLost):
                self._bring_to_rest()
            self._ours = True  # a program that was sent may yet start
            raise self._error(error) from error
        except _Gone as error:
            doubt = self._doubt(f"the client did not start: {error}")
            self._ours = True
            raise doubt from error
        except BaseException:
            self._drop_worker()
            raise

    def _note(self, found: list[Check], said: UrProbe) -> None:
        now = "" if said.kinematics is None else said.kinematics.checksum
        notes = [f"arm {self._name}: {check.subject}: {check.text}" for check in found if check.status == "warning"]
        if self._checksum is not None and self._checksum != now and self._expected.checksum is None:
            notes.append(f"arm {self._name}: {stale(self._checksum, now)}")
        self._checksum = now
        self._warnings = tuple(notes)

    def _connected(self) -> UrProbe:
        if self._said is None:
            raise LinkLost(f"arm {self._name}: not connected; connect first")
        return self._said

    # -- calls, and what follows from their failing --------------------------------------------------------------------

    def _call(self, do: str, within_s: float, **arguments: Any) -> dict[str, Any]:
        self._connected()
        worker = self._worker
        if worker is None:
            if self._fault is not None:
                raise type(self._fault)(*self._fault.args)
            raise LinkLost(f"arm {self._name}: not connected; connect first")
        try:
            return worker.call(do, within_s, **arguments)
        except _Refused as error:
            raise self._error(error) from error
        except _Gone as error:
            raise self._doubt(str(error)) from error

    def _error(self, refused: _Refused) -> ArmError:
        """The worker's refusal as the protocol's error."""
        remedy = _REMEDIES.get(refused.kind, "")
        text = f"arm {self._name}: {refused.text}" + (f"; {remedy}" if remedy else "")
        return KINDS[refused.kind](text)

    def _doubt(self, why: str) -> LinkLost:
        """Kill the client, tell the arm to stop, see it at rest if it can be seen. What to raise."""
        self._drop_worker()
        try:
            self._bring_to_rest()
            seen = "it was told to stop and seen at rest"
        except LinkLost as error:
            period = 1.0 / self._settings.watchdog_hz
            seen = (
                f"it could not be seen at rest ({error}); its controller stops it {period:.1f} s after this computer"
                " fell silent, but treat it as moving until you see it"
            )
        self._fault = LinkLost(f"arm {self._name}: link lost: {why}; {seen}")
        return self._fault

    def _drop_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.kill()

    def _bring_to_rest(self) -> None:
        """Stop what may be ours on the controller and watch the arm until it rests. Raises ``LinkLost``."""
        told: LinkLost | None = None
        try:
            stop_program(self._host, _STOP_WITHIN_S)
        except LinkLost as error:
            told = error
        try:
            sample = wait_at_rest(self._host, self._rest_s)
        except LinkLost as error:
            raise LinkLost(f"{told}; {error}" if told else str(error)) from error
        if told is not None and sample.program == "PLAYING":
            raise told
        self._ours = False

    def _arm_state(self, answer: Mapping[str, Any]) -> ArmState:
        mode, safety, fault = str(answer["robot_mode"]), str(answer["safety_mode"]), answer["fault"]
        reason = ""
        if safety != "NORMAL":
            kind = {ProtectiveStop: "protective stop", EmergencyStop: "emergency stop"}.get(safety_error(safety))
            reason = f"{kind or safety}: {safety_remedy(safety)}"
        elif mode != "RUNNING":
            reason = f"robot mode {mode}; power the arm on and release its brakes on the pendant"
        elif fault is not None:
            reason = f"{fault['text']}; connect anew when the arm may move again"
        qd = np.array(answer["qd"], dtype=np.float64)
        temperatures = answer["temperatures"]
        return ArmState(
            q=np.array(answer["q"], dtype=np.float64),
            time_s=float(answer["time_s"]),
            moving=bool(answer["under_way"]) or float(np.abs(qd).max()) > self._settings.settle_speed,
            ready=not reason,
            reason=reason,
            payload_kg=answer["payload_kg"],
            joint_temperature_c=np.array(temperatures, dtype=np.float64) if len(temperatures) == JOINTS else None,
            robot_mode=mode,
            safety_mode=safety,
            program=str(answer["program"]),
        )

    # -- what may be asked of the arm ----------------------------------------------------------------------------------

    def _per_joint(self, what: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise LimitExceeded(f"arm {self._name}: {what}: expected {JOINTS} numbers") from None
        if array.shape != (JOINTS,):
            raise LimitExceeded(
                f"arm {self._name}: {what} has shape {array.shape}, expected one number for each of {JOINTS} joints"
            )
        if not np.isfinite(array).all():
            joint = int(np.argmin(np.isfinite(array))) + 1
            raise LimitExceeded(f"arm {self._name}: {what} of joint {joint} is not a finite number")
        return array

    def _within_limits(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        goal = self._per_joint("position", q)
        low, high = self._limits.position.T
        for joint in np.flatnonzero((goal < low - _ROUNDING_RAD) | (goal > high + _ROUNDING_RAD)):
            raise LimitExceeded(
                f"arm {self._name}: position {goal[joint]:.4f} rad of joint {joint + 1} is outside"
                f" [{low[joint]:.4f}, {high[joint]:.4f}] rad"
            )
        return goal

    def _rates(
        self, what: str, unit: str, value: NDArray[np.float64], most: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        rate = self._per_joint(what, value)
        for joint in np.flatnonzero((rate <= 0.0) | (rate > most * (1.0 + _LIMIT_SLACK))):
            raise LimitExceeded(
                f"arm {self._name}: {what} {rate[joint]:g} {unit} of joint {joint + 1} is not above 0 and at most"
                f" {most[joint]:g} {unit}"
            )
        return rate


def _tighter(asked: JointLimits, allowed: JointLimits | None) -> JointLimits:
    """Where the controller allows less than was asked for (by a rounding, else it would have been refused)."""
    if allowed is None:
        return asked
    position = np.column_stack(
        [
            np.maximum(asked.position[:, 0], allowed.position[:, 0]),
            np.minimum(asked.position[:, 1], allowed.position[:, 1]),
        ]
    )
    return replace(asked, position=position, speed=np.minimum(asked.speed, allowed.speed))
