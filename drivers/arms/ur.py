"""A Universal Robots arm, moved through ur_rtde in a separate process that can be killed at any moment.

Three properties hold even if that client hangs, crashes with the link or reports old states. First, every call returns
in bounded time. Second, any fault triggers at once all that ``drivers.arms.ur_supervised_link`` describes. Third, if
even that fails, the controller's watchdog expires and stops the program.

``brake`` stops the arm in three ways. The worker decelerates the motion through the control program. At most 20 ms
later the program is ended by a line on an open dashboard connection, and by the worker on another one. The worker also
no longer kicks the watchdog.

After a fault or a brake nothing moves until ``connect`` is called again. The driver never releases a protective stop.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.arms.path_checks import checked_move, checked_path
from drivers.arms.protocol import ArmState, JointLimits, LimitExceeded, LinkLost, MotionStopped, Tool, WrongRobot, stale
from drivers.arms.recording import JointRecord
from drivers.arms.ur_checks import JOINTS, Check, UrExpectation, checks, held_by, load_checks
from drivers.arms.ur_control import Refusal
from drivers.arms.ur_links import RTDE_PORT, Connection, cause, program_name, running_program
from drivers.arms.ur_motion import OPTIONAL_VARIABLES, STILL_MOVING
from drivers.arms.ur_options import UrOptions
from drivers.arms.ur_probe import UrProbe, probe_ur
from drivers.arms.ur_rtde_reader import RtdeOutputs
from drivers.arms.ur_supervised_link import ANSWER_WITHIN_S, CONFIRM_WITHIN_S, SupervisedLink, arm_error, arm_state
from drivers.arms.ur_worker_process import HeartbeatGaps, WorkerGone, WorkerProcess
from drivers.findings import ArmIdentity
from drivers.patience import Patience

LONGEST_PROBE_S = 5.0
LONGEST_BRAKING_S = 3.0
"""Upper bound of the braking time: several times what a UR arm takes to brake from full speed."""

_HELLO_WITHIN_S = 10.0
_QUICK_END_S = 0.3
"""Time limit for the end of an interrupted ``connect``, whose program has begun no motion."""
_KNOWN_WITHIN_S, _ASK_AGAIN_S = 1.5, 0.1
"""Time limit for the name of the program of who holds the controller: programs start within a second."""
_ENDS_WITHIN_S = 3.0
_MARGIN_S = 1.0
_CB3_PERIOD_S, _PERIOD_S = 0.008, 0.002
"""Control cycles of the CB3 series (125 Hz) and of all later ones (500 Hz)."""
_ROWS_AT_ONCE = 20
"""Joint positions per request to the worker, which needs 8 to 20 ms for each to ask the controller."""
_ROWS_WITHIN_S = 10.0

GoingOn = Callable[[], None]
"""Callback that raises ``MotionStopped`` if motions were refused since a connection began."""


class UrArm(SupervisedLink):
    """One UR arm. Any thread may call ``live`` and the stopping methods, one thread at a time the others."""

    def __init__(
        self,
        name: str,
        settings: UrOptions,
        expected: UrExpectation,
        *,
        rest_s: float = LONGEST_BRAKING_S,
        user: str = "",
    ) -> None:
        """Open nothing yet. An arm with a fault is monitored for at most ``rest_s`` [s] until it rests.

        ``user``, a job's run, becomes a part of the name of the control program.
        """
        super().__init__(name, settings, rest_s)
        self._expected = expected
        self._rest_s = rest_s
        self._user = user
        self._probed: UrProbe | None = None
        self._serial = ""
        self._checksum: str | None = expected.checksum
        self._warnings: tuple[str, ...] = ()
        self._limits = expected.limits
        self._recorder: UrRecorder | None = None

    def connect(self) -> None:
        """Probe the controller over plain sockets, check it against the expectation, then start the RTDE client.

        After a fault it does all of this again, and first stops a program of this driver that may still run. After
        ``brake`` alone it starts the control program again and checks readiness, payload, TCP and speed slider.
        Harmless when connected, without a fault and not braked. Raises as the protocol specifies, and ``MotionStopped``
        if motions are refused meanwhile: then it kills the client and stops a program that the client has started.
        """
        brakes = self._latch.brakes

        def going_on() -> None:
            if self._latch.brakes != brakes:
                raise arm_error(self._name, "stopped", "it was stopped while it was being connected")

        self._latch.wait_for_stops(brakes, self._rest_s + _MARGIN_S)
        try:
            going_on()
            if not self._is_well(going_on):
                self._connect_anew(going_on)
            self._latch.release(brakes)
            self._require_not_braked()
        except MotionStopped:
            self._give_up()
            raise
        finally:
            self._connecting = None
        self._first_fault.report()

    def _give_up(self) -> None:
        """Kill the client and end the program that it may have started; ``disconnect`` waits for one that starts late.

        Takes half a second: nothing has moved yet.
        """
        self._drop_worker()
        with suppress(LinkLost):
            if self._program.awaited:
                self._program.end_late_start(_QUICK_END_S)
            elif self._program.may_run:
                self._program.bring_to_rest()

    def _connect_anew(self, going_on: GoingOn) -> None:
        self._drop_worker()
        self._first_fault.clear()
        probe = self._probe(going_on)
        self._raise_failed(
            [check for check in checks(self._expected, probe) if check.subject not in ("program", "state")]
        )
        stopped = probe.sample is not None and probe.sample.program == "STOPPED" and not probe.program_running
        if not stopped and self._program.may_run:  # the two may differ: the watchdog may have just ended the program
            self._require_rest(look=going_on)
            probe = self._probe(going_on)
        results = checks(self._expected, probe)
        self._raise_failed(results)
        self._check_same_controller(probe)
        try:
            self._stop_line.open(going_on)
        except LinkLost as error:
            raise LinkLost(f"arm {self._name}: {error}") from error
        self._start_client(probe, going_on)
        self._probed = probe
        self._limits = narrower(self._expected.limits, probe.limits)
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
        """Return the findings of the last ``connect`` that do not prevent motion, and late heartbeats."""
        gaps = self.heartbeat_gaps()
        if not gaps.late:
            return self._warnings
        period = 1.0 / self._settings.watchdog_hz
        text = (
            f"arm {self._name}: heartbeats: this computer was late {gaps.late} times, by up to {gaps.longest_s:.2f} s;"
            f" after {period:.2f} s the controller stops the arm: close other programs"
        )
        return (*self._warnings, text)

    def heartbeat_gaps(self) -> HeartbeatGaps:
        """Return how regularly this computer has kicked the controller's watchdog, over all connections."""
        worker = self._worker
        return self._gaps if worker is None else self._gaps.joined(worker.gaps)

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the joint positions (n, 6) [rad] that the controller's safety configuration forbids.

        Takes about 20 ms for each on a CB3 controller, 8 ms on an e-Series one. Raises as ``start_move`` does.
        """
        rows = checked_rows(self._name, q)
        refused: list[bool] = []
        for first in range(0, len(rows), _ROWS_AT_ONCE):
            part = rows[first : first + _ROWS_AT_ONCE].tolist()
            answer = self._call("allowed", _ROWS_WITHIN_S, self._require_not_braked, q=part)
            refused += [not allowed for allowed in answer["allowed"]]
        return np.array(refused, dtype=np.bool_)

    def state(self) -> ArmState:
        """Return the first state that the controller sends after this call."""
        return arm_state(self._call("state", ANSWER_WITHIN_S), self._settings.settle_speed)

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (6,), all joints together; no joint exceeds its speed or acceleration (6,).

        Raises ``LimitExceeded`` before anything is sent, otherwise as the protocol specifies.
        """
        goal, speeds, accelerations = checked_move(self._name, q, speed, acceleration, self._limits)
        self._connected()
        self._program.started()
        self._call(
            "move",
            self._settings.startup_timeout,
            self._require_not_braked,
            q=goal.tolist(),
            speed=speeds.tolist(),
            acceleration=accelerations.tolist(),
        )

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the motion has ended and the arm rests at its goal.

        Raises ``ArmTimeout`` (the motion continues), or the cause of the stop: then nothing moves until ``connect``.
        """
        timeout = max(timeout_s, 0.0)
        answer = self._call("settled", timeout + ANSWER_WITHIN_S, self._require_not_braked, timeout_s=timeout)
        return arm_state(answer, self._settings.settle_speed)

    def disconnect(self) -> None:
        """Stop the arm, its program and all connections; leave nothing on the controller. Harmless when closed.

        Wait for a program that was uploaded and has not started yet, at most ``startup_timeout``, to end it. Raises
        ``LinkLost`` if the arm was not seen at rest, or that program was not seen.
        """
        self._end_recorder()
        worker, self._worker = self._worker, None
        self._first_fault.mute()
        if worker is not None:
            worker.end(_ENDS_WITHIN_S)
            self._gaps = self._gaps.joined(worker.gaps)
        self._stop_line.close()
        self._probed, self._fault = None, None
        try:
            self._program.end_late_start(self._settings.startup_timeout)
        except LinkLost as error:
            raise LinkLost(f"arm {self._name}: {error}") from error
        if self._program.may_run:
            self._require_rest()

    # -- paths: the worker receives the whole path and sends it by its own clock --------------------------------------

    @property
    def path_period_s(self) -> float:
        """Control cycle of the connected controller [s]."""
        return _CB3_PERIOD_S if self._connected().series == "CB3" else _PERIOD_S

    def start_path(self, q: NDArray[np.float64], period_s: float) -> None:
        """Stream joint positions ``q`` (m, 6) [rad]. The arm must rest at the first one; the worker checks this again.

        Raises ``LimitExceeded`` before anything is sent, otherwise as ``start_move``.
        """
        controller_period_s = self.path_period_s
        state = self.state()
        if state.moving:  # before the checks of the path: the position of a moving arm means nothing
            raise arm_error(self._name, "advised", STILL_MOVING)
        path = checked_path(self._name, q, period_s, controller_period_s, self._limits, state.q)
        self._program.started()
        self._call(
            "path",
            self._settings.startup_timeout,
            self._require_not_braked,
            q=path.tolist(),
            period_s=period_s,
            lookahead_s=self._settings.servo_lookahead,
            gain=self._settings.servo_gain,
        )

    def end_path(self) -> None:
        """Slow down along the path and rest on it; from any thread. Raises ``LinkLost``."""
        worker = self._worker
        if worker is None:
            return
        try:
            worker.call("end_path", ANSWER_WITHIN_S)
        except (WorkerGone, Refusal) as error:
            raise LinkLost(f"arm {self._name}: the path could not be ended: {error}") from error

    def reached(self) -> float:
        """Return the row at which ``end_path`` ended the last path; inf if it did not."""
        return float(self._call("reached", ANSWER_WITHIN_S).get("reached", math.inf))

    # -- recording -----------------------------------------------------------------------------------------------------

    @property
    def settle_window(self) -> float:
        """Largest change of a joint at rest [rad]."""
        return self._settings.settle_window

    def start_recording(self) -> None:
        """Record every state of the controller over a separate connection. Raises ``LinkLost``."""
        self._end_recorder()
        self._recorder = UrRecorder(self._name, self._host, self.path_period_s)

    def end_recording(self) -> JointRecord:
        """Return all samples. Raises ``LinkLost`` if the connection ended before."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            raise LinkLost(f"arm {self._name}: it is not being recorded")
        return recorder.end()

    def _end_recorder(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()

    # -- connecting ----------------------------------------------------------------------------------------------------

    def _is_well(self, going_on: GoingOn) -> bool:
        """Return whether the client runs without a fault; after a brake, restart its program.

        Raises the reason why a braked arm cannot move again.
        """
        worker, probe = self._worker, self._probed
        if worker is None or probe is None or self._first_fault.error is not None:
            return False
        try:
            if not self._latch.in_force:
                return worker.call("state", ANSWER_WITHIN_S)["fault"] is None
            self._stop_line.confirm(Patience(CONFIRM_WITHIN_S, look=going_on))
            self._program.started()
            self._connecting = worker
            answer = worker.call("restart", self._settings.startup_timeout, going_on)
        except (WorkerGone, Refusal, LinkLost):
            return False
        self._connecting = None
        going_on()
        self._raise_failed(load_checks(self._expected, probe, answer))
        return True

    def _probe(self, going_on: GoingOn) -> UrProbe:
        try:
            return probe_ur(self._host, min(self._settings.timeout, LONGEST_PROBE_S), look=going_on)
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

    def _start_client(self, probe: UrProbe, going_on: GoingOn) -> None:
        going_on()
        worker = WorkerProcess(self._name, self._report_fault, self._program.uploaded)
        self._worker = self._connecting = worker
        self._fault = None
        timeout = self._settings.startup_timeout
        sample = probe.sample
        reported = () if sample is None else (sample.speed_fraction, sample.payload_kg, sample.payload_center_m)
        try:
            worker.wait_hello(_HELLO_WITHIN_S)
            answer = worker.call(
                "open",
                timeout,
                going_on,
                host=self._host,
                program=program_name(self._user),
                version=probe.software.split(".")[:2],
                optional=[name for name, value in zip(OPTIONAL_VARIABLES, reported) if value is not None],
                watchdog_hz=self._settings.watchdog_hz,
                settle_s=self._settings.settle_time,
                settle_speed=self._settings.settle_speed,
                settle_position=self._settings.settle_window,
                timeout_s=timeout + _MARGIN_S,
            )
            self._connecting = None
            going_on()
            worker.watch()
            self._raise_failed(load_checks(self._expected, probe, answer))
        except MotionStopped:
            raise
        except Refusal as error:
            going_on()
            self._give_up()
            text = self._who_holds_it() if error.kind == "occupied" else ""
            raise arm_error(self._name, error.kind, text or error.text) from error
        except WorkerGone as error:
            going_on()
            raise self._link_fault(f"the client did not start: {error}", error.kind) from error
        except BaseException:
            self._give_up()
            raise

    def _who_holds_it(self) -> str:
        """Return who holds the controller, by the name of the program; it may be about to start."""
        patience = Patience(_KNOWN_WITHIN_S)
        while not patience.over:
            if running := running_program(self._host, patience.remaining_s):
                return held_by(running)
            time.sleep(_ASK_AGAIN_S)
        return ""

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


# -- Checks of a request before anything is sent ----------------------------------------------------------------------


def checked_rows(name: str, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Check joint positions; return them, (n, 6) [rad]. Raises ``LimitExceeded``."""
    rows = np.asarray(q, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != JOINTS:
        raise LimitExceeded(f"arm {name}: positions have shape {rows.shape}, expected rows of {JOINTS} joints")
    if not np.isfinite(rows).all():
        raise LimitExceeded(f"arm {name}: row {int(np.argmin(np.isfinite(rows).all(axis=1)))} is not finite numbers")
    return rows


def narrower(asked: JointLimits, allowed: JointLimits | None) -> JointLimits:
    """Return the intersection of the limits. They differ only by rounding: ``checks`` refuses anything more."""
    if allowed is None:
        return asked
    position = np.column_stack(
        [
            np.maximum(asked.position[:, 0], allowed.position[:, 0]),
            np.minimum(asked.position[:, 1], allowed.position[:, 1]),
        ]
    )
    return replace(asked, position=position, speed=np.minimum(asked.speed, allowed.speed))


# ---------------------------------------------------------------------------------------------------------------------
# Recorder of every state that a UR controller sends, over a separate RTDE connection.
#
# The RTDE client that moves the arm keeps only the newest of several states that arrive together. Here a thread keeps
# all. Lost states are counted by the controller's own clock.


_OPENS_WITHIN_S = 3.0
_SILENT_S = 2.0
"""A controller that sends nothing for this long has ended the recording."""
_RECORDING_ENDS_WITHIN_S = 1.0
_LAST_SAMPLE_LOOK_S = 0.001
_REQUIRED = ("timestamp", "actual_q", "actual_qd")
_OPTIONAL = ("joint_temperatures",)

Values = dict[str, tuple[float, ...]]


class UrRecorder:
    """Recorder from construction, which waits for the first state, until ``end``."""

    def __init__(self, name: str, host: str, period_s: float, *, port: int = RTDE_PORT) -> None:
        """Connect. Raises ``LinkLost``."""
        self._name, self._period_s = name, period_s
        self._states: list[Values] = []
        self._problem: LinkLost | None = None
        self._ending = threading.Event()
        self._first = threading.Event()
        patience = Patience(_OPENS_WITHIN_S)
        try:
            self._link = Connection.to(host, port, patience)
            try:
                self._outputs = RtdeOutputs(self._link, patience, _REQUIRED, _OPTIONAL, 1.0 / period_s)
            except BaseException:
                self._link.close()
                raise
        except LinkLost as error:
            raise LinkLost(f"arm {name}: its joints are not recorded: {cause(error)}") from error
        self._thread = threading.Thread(target=self._record, name=f"recorder of {name}", daemon=True)
        self._thread.start()
        if not self._first.wait(_OPENS_WITHIN_S) or self._problem is not None:
            self.close()
            why = "no state came" if self._problem is None else cause(self._problem)
            raise LinkLost(f"arm {name}: its joints are not recorded: {why}")

    def end(self) -> JointRecord:
        """Close the connection after one more sample; return all. Raises ``LinkLost`` if it ended before."""
        count, patience = len(self._states), Patience(_SILENT_S)
        while len(self._states) == count and self._problem is None and not patience.over:
            time.sleep(_LAST_SAMPLE_LOOK_S)
        problem = self._problem or (LinkLost("no state came") if len(self._states) == count else None)
        self.close()
        if problem is not None:
            raise LinkLost(f"arm {self._name}: the recording of its joints ended early: {cause(problem)}") from problem
        states = self._states
        temperature = _table(states, "joint_temperatures")
        return JointRecord(
            time_s=_table(states, "timestamp")[:, 0],
            q=_table(states, "actual_q"),
            qd=_table(states, "actual_qd"),
            period_s=self._period_s,
            joint_temperature_c=temperature if temperature.any() else None,
        )

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._ending.set()
        self._link.shut_down()
        self._thread.join(_RECORDING_ENDS_WITHIN_S)
        self._link.close()

    def _record(self) -> None:
        """Store states until the connection is closed."""
        try:
            for values in self._outputs.states(lambda: Patience(_SILENT_S)):
                if not math.isfinite(sum(values["actual_q"])):
                    raise LinkLost("its state holds a value that is not a finite number")
                self._states.append(values)
                self._first.set()
        except LinkLost as error:
            if not self._ending.is_set():
                self._problem = error
            self._first.set()


def _table(states: Sequence[Values], name: str) -> NDArray[np.float64]:
    """Return an output of all states, (n, k); (n, 0) if it was not sent."""
    return np.array([state.get(name, ()) for state in states], dtype=np.float64).reshape(len(states), -1)
