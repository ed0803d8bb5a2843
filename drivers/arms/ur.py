"""A Universal Robots arm, moved through ur_rtde in a separate process that can be killed at any moment.

Three properties hold even if that client hangs, crashes with the link or reports old states. Every call returns in
bounded time. On any doubt the worker process is killed, a stop is requested over a separate dashboard connection, and
the arm is monitored over a separate RTDE connection until it rests. If even that fails, the controller's watchdog
expires and stops the program.

After a fault nothing moves until ``connect`` is called again. The driver never releases a protective stop.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from drivers.arms.ur_worker_process import WorkerGone, WorkerProcess, WorkerRefusal

REFUSALS: Mapping[str, type[ArmError]] = {
    "protective": ProtectiveStop,
    "emergency": EmergencyStop,
    "local": NotInRemoteControl,
    "link": LinkLost,
    "timeout": ArmTimeout,
    "failed": ArmError,
}
"""Exception for each kind of refusal of the worker."""
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
"""Relative excess of a rate that counts as rounding."""


class UrArm:
    """One UR arm. ``stop`` may be called from any thread, the rest from one at a time."""

    def __init__(
        self, name: str, settings: UrSettings, expected: UrExpectation, *, rest_s: float = LONGEST_BRAKING_S
    ) -> None:
        """Nothing is opened yet. An arm in doubt is monitored for at most ``rest_s`` [s] until it rests."""
        self._name = name
        self._host = settings.host
        self._expected = expected
        self._settings = settings
        self._rest_s = rest_s
        self._worker: WorkerProcess | None = None
        self._fault: ArmError | None = None
        self._may_run_program = False
        """Whether a program of this driver may run on the controller, and with it a motion."""
        self._probed: UrProbe | None = None
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
        """Probe the controller over plain sockets, check it against the expectation, then start the RTDE client.

        After a fault it does all of this again; a program of this driver that may still run is stopped first. Harmless
        when connected and without a fault. Raises as the protocol specifies.
        """
        if self._is_well():
            return
        self._drop_worker()
        probe = self._probe()
        self._raise_failed(
            [check for check in checks(self._expected, probe) if check.subject not in ("program", "state")]
        )
        program = "" if probe.sample is None else probe.sample.program
        if program != "STOPPED" and (self._may_run_program or program in ("PAUSED", "PAUSING")):
            self._bring_to_rest()
            probe = self._probe()
        results = checks(self._expected, probe)
        self._raise_failed(results)
        self._check_same_controller(probe)
        self._start_client(probe)
        self._probed = probe
        self._limits = _narrower(self._expected.limits, probe.limits)
        self._keep_warnings(results, probe)

    def identify(self) -> ArmIdentity:
        """Return the identity that the controller reported at ``connect``."""
        probe = self._connected()
        kinematics = probe.kinematics
        return ArmIdentity(
            model=probe.full_model or "",
            serial=probe.serial or "",
            software=probe.software,
            dh_rows=None if kinematics is None else kinematics.rows,
            dh_checksum="" if kinematics is None else kinematics.checksum,
        )

    def limits(self) -> JointLimits:
        """Return the narrower of the controller's limits and the expected ones."""
        self._connected()
        return self._limits

    def tool(self) -> Tool:
        """Return payload and TCP as configured in the controller at ``connect``."""
        probe = self._connected()
        sample = probe.sample
        center = None if sample is None else sample.payload_center_m
        return Tool(
            payload_kg=None if sample is None else sample.payload_kg,
            payload_center_m=None if center is None else np.array(center),
            tcp=None if probe.tcp is None else np.array(probe.tcp),
        )

    def warnings(self) -> tuple[str, ...]:
        """Return the findings of the last ``connect`` that do not keep the arm from moving."""
        return self._warnings

    def state(self) -> ArmState:
        """Return the first state that the controller sends after this call."""
        return self._arm_state(self._call("state", _ANSWER_WITHIN_S))

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (6,), all joints together; no joint exceeds its speed or acceleration (6,).

        Raises ``LimitExceeded`` before anything is sent, otherwise as the protocol specifies.
        """
        goal = self._checked_goal(q)
        speeds = self._checked_rates("speed", "rad/s", speed, self._limits.speed)
        accelerations = self._checked_rates("acceleration", "rad/s^2", acceleration, self._limits.acceleration)
        self._connected()
        timeout = self._settings.startup_timeout
        self._may_run_program = True
        self._call(
            "move",
            timeout,
            q=goal.tolist(),
            speed=speeds.tolist(),
            acceleration=accelerations.tolist(),
            timeout_s=timeout + _MARGIN_S,
        )

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the motion has ended and the arm rests at its goal.

        Raises ``ArmTimeout`` (the motion continues), or the cause of the stop: then nothing moves until ``connect``.
        """
        timeout = max(timeout_s, 0.0)
        try:
            answer = self._call("settled", timeout + _ANSWER_WITHIN_S, timeout_s=timeout)
        except ArmTimeout:
            raise ArmTimeout(f"arm {self._name} did not come to rest within {timeout_s:g} s") from None
        return self._arm_state(answer)

    def stop(self) -> None:
        """Stop the controller's program and wait until the arm rests; harmless if no program of this driver runs.

        Raises ``LinkLost`` if the arm could not be reached or seen; its watchdog then stops it.
        """
        if not self._may_run_program:
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
        except (LinkLost, WorkerGone, WorkerRefusal) as error:
            raise self._link_in_doubt(f"the stop could not be requested: {error}") from error

    def disconnect(self) -> None:
        """Stop the arm, its program and the client; nothing stays on the controller. Harmless when closed."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.end(3.0 * _STOP_WITHIN_S)
        self._probed, self._fault = None, None
        if self._may_run_program:
            self._bring_to_rest()

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker, for tests that kill it; None without one."""
        return None if self._worker is None else self._worker.pid

    # -- connecting ----------------------------------------------------------------------------------------------------

    def _is_well(self) -> bool:
        """Return whether the client runs and has recorded no fault."""
        if self._worker is None or self._probed is None:
            return False
        with suppress(WorkerGone, WorkerRefusal):
            return self._worker.call("state", _ANSWER_WITHIN_S)["fault"] is None
        return False

    def _probe(self) -> UrProbe:
        try:
            return probe_ur(self._host, min(self._settings.timeout, LONGEST_PROBE_S))
        except LinkLost as error:
            raise LinkLost(f"arm {self._name}: {error}") from error

    def _raise_failed(self, results: list[Check]) -> None:
        failed = [check for check in results if check.status == "failed"]
        if failed:
            reasons = "; ".join(f"{check.subject}: {check.text}" for check in failed)
            raise failed[0].error(f"arm {self._name}: not moved: {reasons}")

    def _check_same_controller(self, probe: UrProbe) -> None:
        """Refuse a controller other than the one connected before a fault."""
        if self._serial and probe.serial and probe.serial != self._serial:
            raise WrongRobot(
                f"arm {self._name}: the controller at {self._host} is now {probe.serial}, it was {self._serial} before"
            )
        self._serial = probe.serial or self._serial

    def _start_client(self, probe: UrProbe) -> None:
        worker = WorkerProcess(self._name)
        self._worker = worker
        self._fault = None
        timeout = self._settings.startup_timeout
        payload = probe.sample is not None and probe.sample.payload_kg is not None
        try:
            worker.wait_hello(_HELLO_WITHIN_S)
            self._may_run_program = True
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
        except WorkerRefusal as error:
            self._drop_worker()
            with suppress(LinkLost):
                self._bring_to_rest()
            self._may_run_program = True  # an uploaded program may still start
            raise self._as_arm_error(error) from error
        except WorkerGone as error:
            doubt = self._link_in_doubt(f"the client did not start: {error}")
            self._may_run_program = True
            raise doubt from error
        except BaseException:
            self._drop_worker()
            raise

    def _keep_warnings(self, results: list[Check], probe: UrProbe) -> None:
        now = "" if probe.kinematics is None else probe.kinematics.checksum
        notes = [f"arm {self._name}: {check.subject}: {check.text}" for check in results if check.status == "warning"]
        if self._checksum is not None and self._checksum != now and self._expected.checksum is None:
            notes.append(f"arm {self._name}: {stale(self._checksum, now)}")
        self._checksum = now
        self._warnings = tuple(notes)

    def _connected(self) -> UrProbe:
        if self._probed is None:
            raise LinkLost(f"arm {self._name}: not connected; connect first")
        return self._probed

    # -- calls and their failures --------------------------------------------------------------------------------------

    def _call(self, request: str, within_s: float, **arguments: Any) -> dict[str, Any]:
        self._connected()
        worker = self._worker
        if worker is None:
            if self._fault is not None:
                raise type(self._fault)(*self._fault.args)
            raise LinkLost(f"arm {self._name}: not connected; connect first")
        try:
            return worker.call(request, within_s, **arguments)
        except WorkerRefusal as error:
            raise self._as_arm_error(error) from error
        except WorkerGone as error:
            raise self._link_in_doubt(str(error)) from error

    def _as_arm_error(self, refusal: WorkerRefusal) -> ArmError:
        """Return the protocol's exception for a refusal of the worker."""
        remedy = _REMEDIES.get(refusal.kind, "")
        text = f"arm {self._name}: {refusal.text}" + (f"; {remedy}" if remedy else "")
        return REFUSALS[refusal.kind](text)

    def _link_in_doubt(self, why: str) -> LinkLost:
        """Kill the client, stop the arm, monitor it until it rests if possible; return the exception to raise."""
        self._drop_worker()
        try:
            self._bring_to_rest()
            outcome = "a stop was requested and the arm was seen at rest"
        except LinkLost as error:
            period = 1.0 / self._settings.watchdog_hz
            outcome = (
                f"it could not be seen at rest ({error}); its controller stops it {period:.1f} s after the last"
                " message of this computer, but treat it as moving until you see it at rest"
            )
        self._fault = LinkLost(f"arm {self._name}: link lost: {why}; {outcome}")
        return self._fault

    def _drop_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.kill()

    def _bring_to_rest(self) -> None:
        """Stop the controller's program and monitor the arm until it rests. Raises ``LinkLost``."""
        not_stopped: LinkLost | None = None
        try:
            stop_program(self._host, _STOP_WITHIN_S)
        except LinkLost as error:
            not_stopped = error
        try:
            sample = wait_at_rest(self._host, self._rest_s)
        except LinkLost as error:
            raise LinkLost(f"{not_stopped}; {error}" if not_stopped else str(error)) from error
        if not_stopped is not None and sample.program == "PLAYING":
            raise not_stopped
        self._may_run_program = False

    def _arm_state(self, answer: Mapping[str, Any]) -> ArmState:
        mode, safety, fault = str(answer["robot_mode"]), str(answer["safety_mode"]), answer["fault"]
        reason = ""
        if safety != "NORMAL":
            kind = {ProtectiveStop: "protective stop", EmergencyStop: "emergency stop"}.get(safety_error(safety))
            reason = f"{kind or safety}: {safety_remedy(safety)}"
        elif mode != "RUNNING":
            reason = f"robot mode {mode}; power the arm on and release its brakes on the pendant"
        elif fault is not None:
            reason = f"{fault['text']}; connect again when the arm may move"
        qd = np.array(answer["qd"], dtype=np.float64)
        temperatures = answer["temperatures"]
        return ArmState(
            q=np.array(answer["q"], dtype=np.float64),
            time_s=float(answer["time_s"]),
            moving=bool(answer["moving"]) or float(np.abs(qd).max()) > self._settings.settle_speed,
            ready=not reason,
            reason=reason,
            payload_kg=answer["payload_kg"],
            joint_temperature_c=np.array(temperatures, dtype=np.float64) if len(temperatures) == JOINTS else None,
            robot_mode=mode,
            safety_mode=safety,
            program=str(answer["program"]),
        )

    # -- checked arguments ---------------------------------------------------------------------------------------------

    def _checked_vector(self, what: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
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

    def _checked_goal(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        goal = self._checked_vector("position", q)
        low, high = self._limits.position.T
        for joint in np.flatnonzero((goal < low - _ROUNDING_RAD) | (goal > high + _ROUNDING_RAD)):
            raise LimitExceeded(
                f"arm {self._name}: position {goal[joint]:.4f} rad of joint {joint + 1} is outside"
                f" [{low[joint]:.4f}, {high[joint]:.4f}] rad"
            )
        return goal

    def _checked_rates(
        self, what: str, unit: str, value: NDArray[np.float64], limit: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        rate = self._checked_vector(what, value)
        for joint in np.flatnonzero((rate <= 0.0) | (rate > limit * (1.0 + _LIMIT_SLACK))):
            raise LimitExceeded(
                f"arm {self._name}: {what} {rate[joint]:g} {unit} of joint {joint + 1} is not above 0 and at most"
                f" {limit[joint]:g} {unit}"
            )
        return rate


def _narrower(asked: JointLimits, allowed: JointLimits | None) -> JointLimits:
    """Return the controller's limits where they are narrower; by rounding only, as ``checks`` refuses more."""
    if allowed is None:
        return asked
    position = np.column_stack(
        [
            np.maximum(asked.position[:, 0], allowed.position[:, 0]),
            np.minimum(asked.position[:, 1], allowed.position[:, 1]),
        ]
    )
    return replace(asked, position=position, speed=np.minimum(asked.speed, allowed.speed))
