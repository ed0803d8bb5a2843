"""A Universal Robots arm, moved through ur_rtde in a separate process that can be killed at any moment.

Three properties hold even if that client hangs, crashes with the link or reports old states. Every call returns in
bounded time. On any doubt the listener is called, then the worker process is killed, a stop is requested over a
separate dashboard connection, and the arm is monitored over a separate RTDE connection until it rests. If even that
fails, the controller's watchdog expires and stops the program.

``brake`` stops the arm in three ways: the worker decelerates the motion through the control program; at most 20 ms
later a line on an open dashboard connection, and the worker on another one, end the program; and the worker no longer
kicks the watchdog.

After a fault or a brake nothing moves until ``connect`` is called again. The driver never releases a protective stop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import (
    ArmError,
    ArmIdentity,
    ArmState,
    DoubtListener,
    JointLimits,
    LinkLost,
    LiveArm,
    MotionStopped,
    Tool,
    WrongRobot,
    stale,
)
from drivers.arms.ur_answers import arm_error, arm_state
from drivers.arms.ur_checks import Check, UrExpectation, checks, load_checks
from drivers.arms.ur_doubt import FirstDoubt
from drivers.arms.ur_links import stop_program
from drivers.arms.ur_motion import OPTIONAL_VARIABLES
from drivers.arms.ur_probe import UrProbe, probe_ur
from drivers.arms.ur_requests import checked_acceleration, checked_goal, checked_rows, checked_speed, narrower
from drivers.arms.ur_rtde_reader import wait_at_rest
from drivers.arms.ur_settings import UrSettings
from drivers.arms.ur_stop_line import StopLatch, StopLine
from drivers.arms.ur_worker_process import HeartbeatGaps, WorkerGone, WorkerProcess, WorkerRefusal

LONGEST_PROBE_S = 5.0
LONGEST_BRAKING_S = 3.0
"""Several times what a UR arm takes to brake from full speed."""

_HELLO_WITHIN_S = 10.0
_ANSWER_WITHIN_S = 2.0
_STOP_WITHIN_S = 1.0
_MESSAGE_WITHIN_S = 0.3
"""A worker that takes no message for this long hangs."""
_MARGIN_S = 1.0
_ROWS_AT_ONCE = 20
"""Joint positions in one request to the worker: it asks the controller about one in 8 to 20 ms."""
_ROWS_WITHIN_S = 10.0


class UrArm:
    """One UR arm. ``brake`` and ``stop`` may be called from any thread, the rest from one at a time."""

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
        self._stop_line = StopLine(settings.host)
        self._fault: ArmError | None = None
        self._may_run_program = False
        """Whether a program of this driver may run on the controller, and with it a motion."""
        self._probed: UrProbe | None = None
        self._serial = ""
        self._checksum: str | None = expected.checksum
        self._warnings: tuple[str, ...] = ()
        self._gaps = HeartbeatGaps()
        self._limits = expected.limits
        self._latch = StopLatch()
        self._doubt = FirstDoubt()

    # -- the protocol --------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """The arm's name in the profile."""
        return self._name

    def connect(self) -> None:
        """Probe the controller over plain sockets, check it against the expectation, then start the RTDE client.

        After a fault it does all of this again; a program of this driver that may still run is stopped first. After
        ``brake`` alone it starts the control program again and checks readiness, payload, TCP and speed slider.
        Harmless when connected, without a fault and not braked. Raises as the protocol specifies, and ``MotionStopped``
        if ``brake`` is called meanwhile.
        """
        brakes = self._latch.brakes
        self._latch.wait_for_stops(self._rest_s + _STOP_WITHIN_S)
        if not self._is_well(brakes):
            self._connect_anew()
        self._latch.release(brakes)
        self._require_not_braked()
        self._doubt.report()

    def _connect_anew(self) -> None:
        self._drop_worker()
        self._doubt.clear()
        probe = self._probe()
        self._raise_failed(
            [check for check in checks(self._expected, probe) if check.subject not in ("program", "state")]
        )
        program = "" if probe.sample is None else probe.sample.program
        if program != "STOPPED" and self._may_run_program:
            self._require_rest()
            probe = self._probe()
        results = checks(self._expected, probe)
        self._raise_failed(results)
        self._check_same_controller(probe)
        self._open_stop_line()
        self._start_client(probe)
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
        """Return the findings of the last ``connect`` that do not keep the arm from moving, and late heartbeats."""
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
        """Return how regularly this computer has kept the controller's watchdog from expiring, over all connections."""
        worker = self._worker
        return self._gaps if worker is None else self._gaps.joined(worker.gaps)

    def watch(self, listener: DoubtListener) -> None:
        """Report the first doubt after each ``connect`` to ``listener``, from a thread of this driver."""
        self._doubt.watch(listener)

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which joint positions (n, 6) [rad] the controller's safety configuration forbids, shape (n,).

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
        return arm_state(self._call("state", _ANSWER_WITHIN_S), self._settings.settle_speed)

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion to ``q`` (6,), all joints together; no joint exceeds its speed or acceleration (6,).

        Raises ``LimitExceeded`` before anything is sent, otherwise as the protocol specifies.
        """
        goal = checked_goal(self._name, q, self._limits)
        speeds = checked_speed(self._name, speed, self._limits)
        accelerations = checked_acceleration(self._name, acceleration, self._limits)
        self._connected()
        self._may_run_program = True
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
        answer = self._call("settled", timeout + _ANSWER_WITHIN_S, self._require_not_braked, timeout_s=timeout)
        return arm_state(answer, self._settings.settle_speed)

    def live(self) -> LiveArm:
        """Return what the worker last reported of the arm."""
        worker = self._worker
        return LiveArm(math.inf, self._may_run_program) if worker is None else worker.live

    def confirm(self) -> None:
        """Ask the dashboard and the worker. Raises as the protocol specifies."""
        doubt = self._doubt.error
        if doubt is not None:
            raise type(doubt)(*doubt.args)
        try:
            self._stop_line.open()
        except LinkLost as error:
            self._doubted("link", str(error))
            raise LinkLost(f"arm {self._name}: {error}") from error
        fault = self._call("state", _ANSWER_WITHIN_S)["fault"]
        if fault is not None:
            raise arm_error(self._name, fault["kind"], fault["text"])

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``."""
        self._latch.refuse()

    def brake(self) -> None:
        """Stop at full deceleration; returns within some 20 ms, within 0.4 s if the dashboard does not answer.

        Raises ``LinkLost`` if the controller did not confirm the stop; the worker no longer kicks its watchdog then.
        """
        with self._latch.stopping(brakes=1):
            self._command_stop()

    def stop(self) -> None:
        """Stop the controller's program and wait until the arm rests; harmless if no program of this driver runs.

        Raises ``LinkLost`` if the arm could not be reached or seen; its watchdog then stops it.
        """
        if not self._may_run_program:
            return
        with self._latch.stopping():
            worker = self._worker
            if worker is None or worker.ended or isinstance(self._fault, LinkLost):
                self._drop_worker()
                self._require_rest()
                return
            try:
                self._command_stop()
                wait_at_rest(self._host, self._rest_s)
                with suppress(MotionStopped):
                    worker.call("release", _ANSWER_WITHIN_S, self._require_last_stop)
            except (LinkLost, WorkerGone, WorkerRefusal) as error:
                doubt = self._link_in_doubt(f"the stop failed: {error}")
                if self._may_run_program:  # else it was seen at rest, and the lost link shows at the next call
                    raise doubt from error

    def disconnect(self) -> None:
        """Stop the arm, its program and the client; nothing stays on the controller. Harmless when closed."""
        worker, self._worker = self._worker, None
        self._doubt.mute()
        if worker is not None:
            worker.end(3.0 * _STOP_WITHIN_S)
            self._gaps = self._gaps.joined(worker.gaps)
        self._stop_line.close()
        self._probed, self._fault = None, None
        if self._may_run_program:
            self._require_rest()

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker, for tests that kill it; None without one."""
        return None if self._worker is None else self._worker.pid

    # -- stopping ------------------------------------------------------------------------------------------------------

    def _command_stop(self) -> None:
        """Stop the arm by all means, and wait for the dashboard's confirmation. Raises ``LinkLost``."""
        worker = self._worker
        # before the dashboard: the worker must not take the stop for one by somebody else
        informed = worker is None or worker.brake()
        if not self._may_run_program:
            return
        try:
            self._stop_line.stop()
        except LinkLost as error:
            raise LinkLost(
                f"arm {self._name}: its stop was not confirmed: {error}; its watchdog stops it after"
                f" {1.0 / self._settings.watchdog_hz:.1f} s, but treat it as moving until you see it at rest"
            ) from error
        finally:
            if worker is not None and not informed and not worker.brake(_MESSAGE_WITHIN_S):
                worker.kill_at_once()  # it would keep the watchdog from expiring

    def _require_not_braked(self) -> None:
        if self._latch.in_force:
            raise arm_error(self._name, "stopped", "it was stopped")

    def _require_last_stop(self) -> None:
        """Raise ``MotionStopped`` if another stop or a brake must stay in force."""
        self._require_not_braked()
        if self._latch.stops > 1:
            raise arm_error(self._name, "stopped", "it is being stopped")

    # -- doubts --------------------------------------------------------------------------------------------------------

    def _doubted(self, kind: str, text: str) -> None:
        """Report the first doubt since ``connect``; called from the worker's threads, too."""
        self._doubt.note(arm_error(self._name, kind, text), text)

    def _check_stop_line(self) -> None:
        lost = self._stop_line.check()
        if lost:
            self._doubted("link", f"the dashboard, over which it is stopped, does not answer: {lost}")

    def _fault_or(self, stopped: ArmError) -> ArmError:
        """Return the fault that came before a stop, if any: it is what a person must know."""
        doubt, worker = self._doubt.error, self._worker
        if doubt is None or worker is None:
            return doubt or stopped
        if isinstance(doubt, LinkLost):
            return self._link_in_doubt(self._doubt.text)
        with suppress(WorkerGone, WorkerRefusal):
            fault = worker.call("state", _ANSWER_WITHIN_S)["fault"]  # its cause may be known better by now
            if fault is not None:
                return arm_error(self._name, fault["kind"], fault["text"])
        return type(doubt)(*doubt.args)

    # -- connecting ----------------------------------------------------------------------------------------------------

    def _is_well(self, brakes: int) -> bool:
        """Return whether the client runs without a fault; after ``brakes`` brakes, restart its program.

        Raises what keeps a braked arm from moving again.
        """
        worker, probe = self._worker, self._probed
        if worker is None or probe is None or self._doubt.error is not None:
            return False
        try:
            if not self._latch.in_force:
                return worker.call("state", _ANSWER_WITHIN_S)["fault"] is None
            self._open_stop_line()
            answer = worker.call("restart", self._settings.startup_timeout, lambda: self._require_brakes(brakes))
        except (WorkerGone, WorkerRefusal, LinkLost):
            return False
        self._may_run_program = True
        self._raise_failed(load_checks(self._expected, probe, answer))
        return True

    def _require_brakes(self, brakes: int) -> None:
        if self._latch.brakes != brakes:
            raise arm_error(self._name, "stopped", "it was stopped again")

    def _open_stop_line(self) -> None:
        try:
            self._stop_line.open()
        except LinkLost as error:
            raise LinkLost(f"arm {self._name}: {error}") from error

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
        worker = WorkerProcess(self._name, self._doubted, self._check_stop_line)
        self._worker = worker
        self._fault = None
        timeout = self._settings.startup_timeout
        sample = probe.sample
        reported = () if sample is None else (sample.speed_fraction, sample.payload_kg, sample.payload_center_m)
        try:
            worker.wait_hello(_HELLO_WITHIN_S)
            self._may_run_program = True
            answer = worker.call(
                "open",
                timeout,
                host=self._host,
                optional=[name for name, value in zip(OPTIONAL_VARIABLES, reported) if value is not None],
                watchdog_hz=self._settings.watchdog_hz,
                settle_s=self._settings.settle_time,
                settle_speed=self._settings.settle_speed,
                settle_position=self._settings.settle_window,
                timeout_s=timeout + _MARGIN_S,
            )
            worker.watch()
            self._raise_failed(load_checks(self._expected, probe, answer))
        except WorkerRefusal as error:
            self._drop_worker()
            with suppress(LinkLost):
                self._bring_to_rest()
            self._may_run_program = True  # an uploaded program may still start
            raise arm_error(self._name, error.kind, error.text) from error
        except WorkerGone as error:
            doubt = self._link_in_doubt(f"the client did not start: {error}")
            self._may_run_program = True
            raise doubt from error
        except BaseException:
            self._drop_worker()
            with suppress(LinkLost):
                self._bring_to_rest()
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

    def _call(
        self, request: str, within_s: float, permitted: Callable[[], None] = lambda: None, **arguments: Any
    ) -> dict[str, Any]:
        self._connected()
        worker = self._worker
        if worker is None:
            if self._fault is not None:
                raise type(self._fault)(*self._fault.args)
            raise LinkLost(f"arm {self._name}: not connected; connect first")
        try:
            return worker.call(request, within_s, permitted, **arguments)
        except MotionStopped as stopped:
            raise self._fault_or(stopped) from stopped
        except WorkerRefusal as error:
            refused = arm_error(self._name, error.kind, error.text)
            raise (self._fault_or(refused) if isinstance(refused, MotionStopped) else refused) from error
        except WorkerGone as error:
            raise self._link_in_doubt(str(error)) from error

    def _link_in_doubt(self, why: str) -> LinkLost:
        """Report, kill the client, stop the arm, monitor it until it rests if possible; return what to raise."""
        self._doubted("link", why)
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
        self._doubt.mute()
        if worker is not None:
            worker.kill()
            self._gaps = self._gaps.joined(worker.gaps)

    def _require_rest(self) -> None:
        """Bring the arm to rest. Raises ``LinkLost`` with the arm's name."""
        try:
            self._bring_to_rest()
        except LinkLost as error:
            text = f"its stop was not confirmed: {error}; treat it as moving until you see it at rest"
            raise arm_error(self._name, "link", text) from error

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
