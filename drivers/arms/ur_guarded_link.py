"""The links of one UR arm, its worker process and its dashboard connection, for queries, motions and stops.

On any doubt, in this order: the listener is called, the worker process is killed, a stop is requested over a separate
dashboard connection, and the arm is monitored over a separate RTDE connection until it rests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from drivers.arms.protocol import ArmError, DoubtListener, LinkLost, LiveArm, MotionStopped
from drivers.arms.ur_answers import arm_error
from drivers.arms.ur_doubt import FirstDoubt
from drivers.arms.ur_latch import StopLatch
from drivers.arms.ur_links import cause
from drivers.arms.ur_options import UrOptions
from drivers.arms.ur_program import OwnProgram
from drivers.arms.ur_stop_line import StopLine
from drivers.arms.ur_worker_process import HeartbeatGaps, WorkerGone, WorkerProcess, WorkerRefusal
from drivers.patience import Patience

ANSWER_WITHIN_S = 2.0
CONFIRM_WITHIN_S = 0.3
_MESSAGE_WITHIN_S = 0.3
"""A worker that accepts no message for this long hangs."""


class GuardedLink:
    """Base of one UR arm's driver: stops, doubts, and calls to the worker."""

    def __init__(self, name: str, settings: UrOptions, rest_s: float) -> None:
        self._name = name
        self._host = settings.host
        self._settings = settings
        self._worker: WorkerProcess | None = None
        self._connecting: WorkerProcess | None = None
        """The worker during ``connect``, while it may start a program on the controller; else None."""
        self._stop_line = StopLine(settings.host, self._dashboard_lost)
        self._program = OwnProgram(settings.host, rest_s)
        self._fault: ArmError | None = None
        self._gaps = HeartbeatGaps()
        self._latch = StopLatch()
        self._doubt = FirstDoubt()

    @property
    def name(self) -> str:
        """The arm's name in the profile."""
        return self._name

    def watch(self, listener: DoubtListener) -> None:
        """Report the first doubt after each ``connect`` to ``listener``, from a thread of this driver."""
        self._doubt.watch(listener)

    def live(self) -> LiveArm:
        """Return the worker's last report, at most 0.05 s old in normal operation."""
        worker = self._worker
        return LiveArm(math.inf, self._program.may_run) if worker is None else worker.live

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker, for tests that kill it; None without one."""
        worker = self._worker
        return None if worker is None else worker.pid

    def confirm(self) -> None:
        """Query the dashboard, then the worker; the worker checks the arm's state and whether its control program runs.

        Raises ``LinkLost``, or the arm's fault; the listener has been told.
        """
        doubt, worker = self._doubt.error, self._worker
        if worker is None:
            raise self._without_worker()
        if doubt is not None:
            raise type(doubt)(*doubt.args)
        patience = Patience(CONFIRM_WITHIN_S)
        try:
            self._stop_line.confirm(patience)
        except LinkLost as error:
            raise self._dashboard_lost(cause(error)) from error
        try:
            fault = worker.call("confirm", patience.left_s)["fault"]
        except WorkerGone as error:
            raise self._doubted(error.kind, str(error)) from error
        except WorkerRefusal as error:
            raise arm_error(self._name, error.kind, error.text) from error
        if fault is not None:
            raise arm_error(self._name, fault["kind"], fault["text"])

    # -- stopping ------------------------------------------------------------------------------------------------------

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``; a ``connect`` in progress starts nothing more on the controller.

        Tell the worker to brake if that needs no waiting.
        """
        self._refuse()
        worker = self._worker
        if worker is not None:
            worker.tell_at_once()

    def _refuse(self) -> None:
        self._latch.refuse()
        connecting = self._connecting
        if connecting is not None:
            connecting.abandon()

    def brake(self) -> None:
        """Stop at full deceleration; return within about 20 ms, or within 0.4 s if the dashboard does not answer.

        Raises ``LinkLost`` if the controller did not confirm the stop; the worker no longer kicks its watchdog then.
        """
        self._refuse()
        with self._latch.stopping():
            try:
                self._command_stop()
            except LinkLost as error:
                raise LinkLost(
                    f"arm {self._name}: its stop was not confirmed: {cause(error)}; its watchdog stops it after"
                    f" {1.0 / self._settings.watchdog_hz:.1f} s, but treat it as moving until you see it at rest"
                ) from error

    def stop(self) -> None:
        """Stop the controller's program and wait until the arm rests; harmless if no program of this driver runs.

        Raises ``LinkLost`` if the arm could not be reached or seen; its watchdog then stops it.
        """
        if not self._program.may_run:
            return
        with self._latch.stopping():
            worker = self._worker
            if worker is None or worker.has_ended:
                self._drop_worker()
                self._require_rest()
                return
            try:
                self._command_stop()
                self._program.wait_at_rest()
                with suppress(MotionStopped):
                    worker.call("release", ANSWER_WITHIN_S, self._require_last_stop)
            except (LinkLost, WorkerGone, WorkerRefusal) as error:
                kind = error.kind if isinstance(error, WorkerGone) else "link"
                why = cause(error) if isinstance(error, LinkLost) else str(error)
                doubt = self._link_in_doubt(f"the stop failed: {why}", kind)
                if self._program.may_run:  # otherwise it was seen at rest, and the next call reports the lost link
                    raise doubt from error

    def _command_stop(self) -> None:
        """Stop the arm by all means; wait until the dashboard confirms. Raises ``LinkLost`` without the arm's name."""
        worker = self._worker
        # before the dashboard stop, which the worker must not take for a stop by somebody else
        informed = worker is None or worker.brake()
        if not self._program.may_run:
            return
        try:
            self._stop_line.stop()
        finally:
            if worker is not None and not informed and not worker.brake(_MESSAGE_WITHIN_S):
                worker.kill_at_once()  # a living worker would keep the watchdog from expiring

    def _require_not_braked(self) -> None:
        if self._latch.in_force:
            raise arm_error(self._name, "stopped", "it was stopped")

    def _require_last_stop(self) -> None:
        """Raise ``MotionStopped`` if a brake is in force or another stop is under way."""
        self._require_not_braked()
        if self._latch.stops > 1:
            raise arm_error(self._name, "stopped", "it is being stopped")

    def _require_rest(self, *, quickly: bool = False, look: Callable[[], None] | None = None) -> None:
        """Bring the arm to rest. Raises ``LinkLost`` with the arm's name."""
        try:
            self._program.bring_to_rest(quickly=quickly, look=look)
        except LinkLost as error:
            text = f"its stop was not confirmed: {cause(error)}; treat it as moving until you see it at rest"
            raise LinkLost(f"arm {self._name}: {text}") from error

    # -- doubts --------------------------------------------------------------------------------------------------------

    def _doubted(self, kind: str, text: str) -> ArmError:
        """Report the first doubt since ``connect``, and return it; called from the worker's threads, too."""
        error = arm_error(self._name, kind, text)
        self._doubt.note(error, text, kind)
        return error

    def _dashboard_lost(self, why: str) -> ArmError:
        return self._doubted("link", f"the dashboard, over which it is stopped, does not answer: {why}")

    def _fault_or(self, stopped: ArmError) -> ArmError:
        """Return the fault that preceded a stop, if any: a person must know the fault."""
        doubt, worker = self._doubt.error, self._worker
        if doubt is None or worker is None:
            return doubt or stopped
        if isinstance(doubt, LinkLost):
            return self._link_in_doubt(self._doubt.text, self._doubt.kind)
        with suppress(WorkerGone, WorkerRefusal):
            fault = worker.call("state", ANSWER_WITHIN_S)["fault"]  # the worker may know the cause better by now
            if fault is not None:
                return arm_error(self._name, fault["kind"], fault["text"])
        return type(doubt)(*doubt.args)

    def _link_in_doubt(self, why: str, kind: str) -> ArmError:
        """Report the doubt, kill the client, stop the arm, monitor it until it rests if possible; return the error."""
        self._doubted(kind, why)
        self._drop_worker()
        try:
            self._program.bring_to_rest()
            outcome = "a stop was requested and the arm was seen at rest"
        except LinkLost as error:
            reason = "" if kind == "nonsense" else f" ({cause(error)})"  # without this condition it would be said twice
            outcome = (
                f"it could not be seen at rest{reason}; its controller stops it"
                f" {1.0 / self._settings.watchdog_hz:.1f} s after the last message of this computer, but treat it as"
                " moving until you see it at rest"
            )
        what = f"link lost: {why}" if kind == "link" else why
        self._fault = arm_error(self._name, kind, f"{what}; {outcome}")
        return self._fault

    def _drop_worker(self) -> None:
        worker, self._worker = self._worker, None
        self._doubt.mute()
        if worker is not None:
            worker.kill()
            self._gaps = self._gaps.joined(worker.gaps)

    # -- calls and their failures --------------------------------------------------------------------------------------

    def _without_worker(self) -> ArmError:
        if self._fault is not None:
            return type(self._fault)(*self._fault.args)
        return LinkLost(f"arm {self._name}: not connected; connect first")

    def _call(
        self, request: str, within_s: float, permitted: Callable[[], None] = lambda: None, **arguments: Any
    ) -> dict[str, Any]:
        worker = self._worker
        if worker is None:
            if self._fault is None:
                permitted()
            raise self._without_worker()
        try:
            return worker.call(request, within_s, permitted, **arguments)
        except MotionStopped as stopped:
            raise self._fault_or(stopped) from stopped
        except WorkerRefusal as error:
            refused = arm_error(self._name, error.kind, error.text)
            raise (self._fault_or(refused) if isinstance(refused, MotionStopped) else refused) from error
        except WorkerGone as error:
            raise self._link_in_doubt(str(error), error.kind) from error
