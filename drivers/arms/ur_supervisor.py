"""Supervision of one connected UR arm in its worker process: requests, faults, watchdog, motion and rest.

Everything here runs in the worker's main thread. ``braked`` may become true at any moment; ``drivers.arms.ur_worker``
explains why no motion escapes it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, NoReturn, Protocol

from drivers.arms.protocol import LinkLost, LiveArm
from drivers.arms.ur_control import Refusal, UrControl, advised, failed
from drivers.arms.ur_links import LOCAL_CONTROL, in_local_control, stop_program
from drivers.arms.ur_motion import (
    REST_DWELL_S,
    STILL_MOVING,
    STREAMS_APART_S,
    Kicks,
    Motion,
    RestCriterion,
    Unrest,
    leading_rates,
)
from drivers.arms.ur_rtde_reader import UrSample, not_ready
from drivers.patience import Patience, RunningTime

# -- The states of one UR arm in its worker process: which one is new, which one may be old, and when none arrives ----


SILENT_S = 0.3
"""The arm's state is unknown if no new one arrives for this long."""
_SILENT_LOOKS = 10
"""Smallest number of looks in that time: a process that was not scheduled has not looked."""
_STALL_S = 0.1
"""A process that has not looked at its arm for this long was not scheduled, or waited for the controller."""
_CATCH_UP_S = 0.02
"""Time in which the client reads what arrived during a stall: the first of these states are old."""
_BROKEN_BY_STALL_S = 1.0
"""A stall at least this long, and at most this long ago, explains a broken link: the client's own silence broke it."""
_ASK_AGAIN_S = 0.0005
_LATELY, _LATE, _LOOKED_S = 125, 0.3, 0.016
"""States within which a late one is remembered; the part of the watchdog's period that shows a late network;
the most time for each look meanwhile: a process that was not scheduled has not looked."""
_WAITED = 0.5
"""Part of a silence of this computer from which on it was the controller's, which was asked for something."""
_NO_MODE = "UNKNOWN_0"
"""A safety mode that no controller has."""

End = Callable[[str, str], NoReturn]
"""Function that ends the process; its arguments are a kind of ``ur_supervised_link.REFUSALS`` and a sentence."""


class States:
    """States of one arm. ``end`` is called when the arm's state is unknown, ``meanwhile`` while waiting for a state."""

    def __init__(self, control: UrControl, end: End, meanwhile: Callable[[], None]) -> None:
        self._control, self._end, self._meanwhile = control, end, meanwhile
        self._looked_s = self._news_s = time.monotonic()
        self._stall_ended_s, self._stall_s = -math.inf, 0.0
        self._time_s = -1.0
        self._looks_without_news = 0
        self._lately: deque[float] = deque(maxlen=_LATELY)

    @property
    def late_s(self) -> float:
        """Longest time between two of the last states [s], while this process looked."""
        return max(self._lately, default=0.0)

    @property
    def age_s(self) -> float:
        """Age of the newest state [s]."""
        return time.monotonic() - self._news_s

    def check_links(self) -> None:
        """End the process if a link broke: the client would reconnect by itself again and again, and finally crash."""
        if not self._control.connected:
            self.lost("the RTDE link broke")

    def lost(self, text: str) -> NoReturn:
        """End the process because the arm's state is unknown; name a long stall of this process as the cause."""
        if time.monotonic() - self._stall_ended_s < _BROKEN_BY_STALL_S:
            self._end("stalled", f"this computer was silent for {self._stall_s:.1f} s (suspended, or too busy): {text}")
        self._end("link", text)

    def newest(self) -> UrSample:
        """Return the newest state."""
        sample = self._control.sample()
        if not sample.complete:
            self.check_links()
            self.lost("the controller's state is not one of six joints")
        if not sample.finite:
            self._end("nonsense", "the controller reports positions or speeds of its joints that are no numbers")
        if sample.safety_mode == _NO_MODE:
            self._end("nonsense", "a malformed packet came from the controller: its state has no safety mode")
        return sample

    def look(self) -> tuple[UrSample, bool]:
        """Return the newest state, and whether it is new; end the process if none has arrived for too long."""
        self._note_look()
        sample, now = self.newest(), time.monotonic()
        if sample.time_s != self._time_s:
            gap_s = now - self._news_s
            self._lately.append(gap_s if self._looks_without_news * _LOOKED_S > gap_s else 0.0)
            self._time_s, self._news_s, self._looks_without_news = sample.time_s, now, 0
            return sample, True
        self._looks_without_news += 1
        if now - self._news_s > SILENT_S and self._looks_without_news > _SILENT_LOOKS:
            self.lost(f"no state came for {SILENT_S:g} s")
        return sample, False

    def next(self, within_s: float = SILENT_S) -> UrSample:
        """Return the first state sent after this call; end the process if none arrives ``within_s`` [s]."""
        self._note_look()
        before = self._control.time_s
        patience = Patience(within_s)
        while True:
            if self._note_look():  # first read the states that arrived meanwhile
                time.sleep(_CATCH_UP_S)
                before = self._control.time_s
            elif self._control.time_s != before:
                return self.newest()
            self.check_links()
            if patience.over:
                self.lost(f"no state came for {within_s:g} s")
            self._meanwhile()
            time.sleep(_ASK_AGAIN_S)

    def _note_look(self) -> bool:
        """Note a look at the arm; return whether it is late, so that the newest state may be old."""
        now = time.monotonic()
        gap_s, self._looked_s = now - self._looked_s, now
        if gap_s > _BROKEN_BY_STALL_S and self._control.waited_s < _WAITED * gap_s:
            self._stall_ended_s, self._stall_s = now, gap_s
        return gap_s > _STALL_S


_FIRST_STATE_WITHIN_S = 2.0
"""Time limit for a state while connecting: nothing moves, and the client and its controller are busy."""
_STARTS_WITHIN_S = 1.0
_STOP_SEEN_WITHIN_S = 0.05
"""Time to wait for a ``brake`` after the program was seen stopped. The application sends ``brake`` before it stops the
program over another connection; without a ``brake`` in this time something else stopped it."""
_STANDING_S = 1.0
"""If a motion is reported as running while the arm rests for this long, the link is at fault."""
_CUT_SHORT_S = 0.5
"""An arm that rests away from its goal for this long after the end of a motion will not reach it."""
_STANDS_RAD_S = 1e-4
AT_GOAL_RAD = 2e-3
_STOP_WITHIN_S = 1.0
_LOCAL_WITHIN_S = 0.3
_REST_WITHIN_S = 3.0
_RELEASE_WITHIN_S = 0.5
_EMERGENCIES = ("SYSTEM_EMERGENCY_STOP", "ROBOT_EMERGENCY_STOP")
_KINDS = {"PROTECTIVE_STOP": "protective", **dict.fromkeys(_EMERGENCIES, "emergency")}
_HARMLESS = "stalled"
"""The kind of fault after which a profile may allow to continue without a person."""


class Application(Protocol):
    """Interface of the application for the supervisor."""

    @property
    def braked(self) -> bool:
        """Whether a brake is in force."""

    def answer(self, message: Mapping[str, Any]) -> None:
        """Send a message."""

    def opening(self, may_start: bool) -> None:
        """Tell that a program may start from now on, or that it was seen to run."""

    def check(self, kicks: Kicks, live: LiveArm) -> str:
        """Exchange heartbeats; return why the application no longer watches its arm, else empty."""

    def exit_link_lost(self, kind: str, text: str) -> NoReturn:
        """Report, stop the arm over the dashboard, and end the process."""


@dataclass
class SettleRequest:
    """A pending request that is answered when the arm has settled."""

    request: int
    timeout_s: float
    deadline_s: float


class Supervisor:
    """Executes requests for one arm; ``monitor`` must be called at least a hundred times a second."""

    def __init__(self, application: Application, control: UrControl, watchdog_hz: float, rest: RestCriterion) -> None:
        self._application, self._control, self._rest = application, control, rest
        self._watchdog_hz = watchdog_hz
        self._kicks = Kicks()
        self._motion: Motion | None = None
        self._cut_short = False
        self._settle_requests: list[SettleRequest] = []
        self._resting_since: UrSample | None = None
        self._rests_at: UrSample | None = None  # where it settled; None while a motion or a stop may change that
        self._departed_s: float | None = None  # controller time since when it has been away from there
        self._fault: Refusal | None = None
        self._halted = False
        self._program_stopped_s: float | None = None  # since when the program has been stopped without a brake
        self._unrest = Unrest()
        self._running_time = RunningTime()
        self._states = States(control, application.exit_link_lost, self._meanwhile)
        self._fast = False  # whether a joint moves in the newest state

    # -- requests ------------------------------------------------------------------------------------------------------

    def begin(self) -> dict[str, Any]:
        """Return the state with the tool centre point, read while the program runs: the program could set both.

        The program has just been started. Start its watchdog last: only ``monitor`` kicks it, and before that a busy
        computer would let it expire.
        """
        tcp = self._control.tcp()
        state = self.state(_FIRST_STATE_WITHIN_S)
        self._start_watchdog()
        return {**state, "tcp": tcp}

    def state(self, within_s: float = SILENT_S) -> dict[str, Any]:
        """Return the next state of the arm, which must arrive ``within_s`` [s]."""
        state = asdict(self._states.next(within_s))
        fault = None if self._fault is None else {"kind": self._fault.kind, "text": self._fault.text}
        return {**state, "moving": self.may_move, "fault": fault}

    @property
    def _moves(self) -> bool:
        """Whether a motion is in progress."""
        return self._motion is not None and self._motion.running

    @property
    def may_move(self) -> bool:
        """Whether the arm moves, or has not been seen at rest since its last motion."""
        return self._moves or self._unrest.may_move

    @property
    def live(self) -> LiveArm:
        """Age of the newest state, and whether the arm moves."""
        return LiveArm(self._states.age_s, self.may_move or self._fast)

    @property
    def waits_s(self) -> float:
        """How long the controller has been asked for something without an answer [s]; from any thread."""
        return self._control.waits_s

    def confirm(self) -> dict[str, Any]:
        """Return the next state, which shows whether the program runs; require that both connections are open.

        A running program proves the command connection: the watchdog ends the program a fifth of a second after the
        last kick that arrived. A question to the program would prove it at once, but would delay the kicks.
        """
        state = self.state()
        self._states.check_links()
        meant = self._halted or self._application.braked
        if state["program"] != "PLAYING" and not (meant or self._control.program_runs):
            raise self._not_served(failed("its control program has ended"))
        return state

    def move(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a motion."""
        sample = self._require_movable()
        goal = request["q"]
        speed, acceleration = leading_rates(sample.q, goal, request["speed"], request["acceleration"])
        self._ensure_program_runs(sample)
        number, _ = self._control.operation()
        self._require_not_braked()
        self._unrest.begin()
        try:
            accepted = self._control.move(goal, speed, acceleration)
        except Refusal:  # its link may just have broken, or its arm have stopped
            self._require_ready(self._states.next())
            raise
        if self._application.braked:  # the brake may have come before the motion began
            stopped = self._stopped()
            self._stop_program()
            raise stopped
        if not accepted:
            self._require_ready(self._states.next())
            raise self._not_served(failed("the control program did not take the motion"))
        self._states.check_links()  # the client may report success on a link that has just broken
        self._kicks.kicked(time.monotonic())
        self._resting_since, self._cut_short = None, False
        self._motion = Motion(goal, number, self._now())
        return {}

    def _require_movable(self) -> UrSample:
        """Return the state of an arm that may begin a motion; raise ``Refusal`` if it may not."""
        self._require_no_fault()
        self._require_not_braked()
        if self._moves:
            raise advised(STILL_MOVING)
        self._motion = None
        sample = self._states.next()
        self._require_ready(sample)
        if not self._await_rest(_RELEASE_WITHIN_S, moving_at_once=True):
            raise advised(STILL_MOVING)
        self._require_no_fault()
        if self._program_stopped_s is not None:
            raise self._program_stopped()
        sample = self._states.newest()
        if sample.speed > self._rest.speed:
            raise advised(STILL_MOVING)
        if sample.slider_down:
            raise advised("the speed slider is at 0 %; raise it on the pendant")
        return sample

    def wait_settled(self, number: int, timeout_s: float) -> None:
        """Register request ``number``, to be answered when the arm has settled."""
        self._settle_requests.append(SettleRequest(number, timeout_s, self._now() + timeout_s))

    def allowed(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return for each of the joint positions whether the controller's safety configuration allows it."""
        self._ensure_program_runs(self._require_movable())
        allowed = []
        for q in request["q"]:
            self._require_not_braked()
            try:
                allowed.append(self._control.within_safety_limits(q))
            except Refusal as refusal:
                raise self._not_served(refusal) from refusal
            self.monitor()
        return {"allowed": allowed}

    def take_brake(self) -> None:
        """Stop a motion also through the control program, and forget it: its program is being stopped."""
        if self._moves:
            self._control.brake()
        if self._motion is not None:
            self._motion, self._cut_short = None, True
        self._unrest.end(self._now())
        self._halted = True
        self._kicks.end()
        self._program_stopped_s = None
        self._resting_since = None

    def release(self) -> dict[str, Any]:
        """Allow motions again after a stop, once the arm was seen at rest."""
        self.take_brake()
        self._await_rest(_RELEASE_WITHIN_S)
        return {}

    def require_restartable(self) -> None:
        """Wait until a braked arm rests; raise ``Refusal`` if it has a fault or still moves."""
        self._require_no_fault()
        self._unrest.begin()  # whatever moved the arm
        self._unrest.end(self._now())
        if not self._await_rest(_REST_WITHIN_S):
            raise failed(f"it still moves {_REST_WITHIN_S:g} s after it was stopped")
        self._require_no_fault()

    def _await_rest(self, within_s: float, *, moving_at_once: bool = False) -> bool:
        """Wait until states have shown the arm at rest since it moved; return whether they have.

        ``moving_at_once``: return False at the first state that shows motion.
        """
        patience = Patience(within_s)
        while self._unrest.may_move:
            sample = self._states.next()
            if patience.over or (moving_at_once and sample.speed > self._rest.speed):
                return False
            self.monitor()
        return True

    def restart(self) -> dict[str, Any]:
        """Start the control program again, after a brake; return the state with the tool centre point."""
        sample = self._states.next()
        self._require_ready(sample)
        self._ensure_program_runs(sample)
        try:
            tcp = self._control.tcp()
        except Refusal as refusal:
            raise self._not_served(refusal) from refusal
        state = self.state()
        self._require_no_fault()
        return {**state, "tcp": tcp}

    # -- the controller ------------------------------------------------------------------------------------------------

    def _start_watchdog(self) -> None:
        self._control.set_watchdog(self._watchdog_hz)
        self._kicks.start(time.monotonic(), 1.0 / self._watchdog_hz)

    def _stop_program(self) -> None:
        with self._control.waiting(), suppress(LinkLost):
            stop_program(self._control.host, _STOP_WITHIN_S)

    def _now(self) -> float:
        """Return the time for motions: it does not advance while this process is not scheduled."""
        return self._running_time.at(time.monotonic())

    def _meanwhile(self) -> None:
        """Handle what cannot wait for the next state: a brake."""
        if self._application.braked and not self._halted:
            self.take_brake()

    def _require_ready(self, sample: UrSample) -> None:
        """Record and raise the reason why the arm cannot move."""
        problem = not_ready(sample.robot_mode, sample.safety_mode)
        if problem is not None:
            raise self._record_fault(Refusal(_KINDS.get(sample.safety_mode, "advised"), "; ".join(problem)))

    def _require_no_fault(self) -> None:
        if self._fault is not None:
            raise self._fault

    def _require_not_braked(self) -> None:
        if self._application.braked:
            raise self._stopped()

    def _stopped(self) -> Refusal:
        self.take_brake()
        return Refusal("stopped", "its motion was stopped before the goal")

    def _ensure_program_runs(self, sample: UrSample) -> None:
        """Upload the control program again if it was stopped on purpose."""
        if sample.program == "PLAYING" and not self._halted:
            return
        if sample.program != "STOPPED":
            self._stop_program()

        def meanwhile() -> None:
            self._require_not_braked()
            self._look()

        try:
            self._control.upload(meanwhile, self._application.opening)
            self._start_watchdog()
        except Refusal as refusal:
            if refusal.kind == "stopped":
                self._stop_program()  # an uploaded program may still start
            else:
                self._record_fault(refusal)
            raise
        self._halted = False

    def _record_fault(self, refusal: Refusal) -> Refusal:
        """Report the first fault, then stop the arm: nothing moves until the application connects again.

        A fault that needs a person replaces one that does not.
        """
        if self._fault is None or (self._fault.kind == _HARMLESS and refusal.kind != _HARMLESS):
            self._fault = refusal
            self._application.answer({"fault": refusal.kind, "text": refusal.text})
            self._stop_program()
        if self._motion is not None:
            self._motion = None
            self._unrest.end(self._now())
        return self._fault

    def _not_served(self, refusal: Refusal) -> Refusal:
        """Return a brake that came meanwhile; else record ``refusal``, or why the control program has ended.

        The client holds the interpreter's lock during a command, so a brake's message may be read after its effect.
        """
        time.sleep(_STOP_SEEN_WITHIN_S)
        if self._application.braked:
            stopped = self._stopped()
            self._stop_program()
            return stopped
        self._states.check_links()
        if self._control.program_runs:
            return self._record_fault(refusal)
        if self._program_stopped_s is None:
            self._program_stopped_s = time.monotonic()
        return self._program_stopped()

    def _program_stopped(self) -> Refusal:
        """Record why the control program was stopped by something other than the application."""
        gap_s = self._kicks.expired_before(self._program_stopped_s)
        watchdog = f"the controller's watchdog ({1.0 / self._watchdog_hz:.2f} s)"
        if gap_s is not None and self._control.waited_s > _WAITED * gap_s:
            waited = (
                f"its controller took {self._control.waited_s:.2f} s for an answer (it hangs, the network is late, or"
                " this computer stood still meanwhile)"
            )
            return self._record_fault(Refusal("link", f"{waited}, so {watchdog} stopped its program"))
        if gap_s is not None:
            text = f"this computer was silent for {gap_s:.2f} s, so {watchdog} stopped its program"
            return self._record_fault(Refusal("stalled", text))
        fault = self._record_fault(failed(f"its program ended; possible: {self._what_ended_it(watchdog)}"))
        with self._control.waiting():
            local = fault.kind == "failed" and in_local_control(self._control.host, _LOCAL_WITHIN_S)
        if local:
            self._fault = fault = Refusal("local", f"its program was stopped, and {LOCAL_CONTROL}; switch it to Remote")
        return fault

    def _what_ended_it(self, watchdog: str) -> str:
        """Return what may have ended the program, most likely first: a late network was seen, all else was not."""
        stopped = "it was stopped on the pendant, or another program was started"
        late_s = self._states.late_s
        if late_s > _LATE / self._watchdog_hz:
            return f"the network is late (a state came after {late_s:.2f} s), so {watchdog} ended it; or {stopped}"
        return f"{stopped}; or the network lost messages of this computer, and {watchdog} ended it"

    # -- monitoring ----------------------------------------------------------------------------------------------------

    def monitor(self) -> None:
        """Check links, faults, motion and rest; keep the watchdog from expiring; answer settle requests."""
        sample, news = self._look()
        now = self._now()
        if self._application.braked and not self._halted:
            self.take_brake()
        self._check_program(sample, time.monotonic())
        if news:
            self._update_rest(sample)
            self._watch_rest(sample)
        if self._motion is not None and self._motion.running:
            self._track_motion(self._motion, sample, now, news)
        may_kick = self._fault is None and self._program_stopped_s is None and not self._halted
        if may_kick and not self._application.braked and self._kicks.due(time.monotonic()):
            self._kicks.kicked(time.monotonic())
            self._control.kick_watchdog()
        if self._settle_requests:
            self._answer_settle_requests(sample, now, news)

    def _look(self) -> tuple[UrSample, bool]:
        """Check everything that can stop an arm at any time; return its newest state, and whether that is new."""
        unwatched = self._application.check(self._kicks, self.live)
        self._states.check_links()
        sample, news = self._states.look()
        if news:
            self._fast = sample.speed > self._rest.speed
            self._unrest.look(sample, self._now(), self._rest.speed, running=self._moves)
        if self._fault is None or self._fault.kind == _HARMLESS:
            with suppress(Refusal):
                self._require_ready(sample)
                if unwatched:
                    self._record_fault(Refusal("stalled", unwatched))
        return sample, news

    def _check_program(self, sample: UrSample, now: float) -> None:
        """Record a fault if something other than the application stopped the program."""
        if self._fault is not None:
            return
        # the command connection shows whether the state stream is only delayed
        meant = self._halted or self._application.braked
        if sample.program == "PLAYING" or meant or self._control.program_runs:
            self._program_stopped_s = None
        elif self._program_stopped_s is None:
            self._program_stopped_s = now
        elif now - self._program_stopped_s > _STOP_SEEN_WITHIN_S:
            self._program_stopped()

    def _track_motion(self, motion: Motion, sample: UrSample, now: float, news: bool) -> None:
        """Detect the end of a motion; end the process if the client's report contradicts the arm's state."""
        number, running = self._control.operation()
        if number != motion.number_before:
            if not running:
                self._end_motion(motion, now)
                return
        elif now - motion.began_s > _STARTS_WITHIN_S:
            self._states.lost("a motion was sent but not begun")
        if sample.speed > _STANDS_RAD_S or now - motion.began_s < _STARTS_WITHIN_S or sample.slider_down:
            motion.standing_since_s = None
        elif motion.standing_since_s is None:
            motion.standing_since_s = now
        elif now - motion.standing_since_s > _STANDING_S:
            self._states.lost("the arm rests, but its motion is reported as running")

    def _end_motion(self, motion: Motion, now: float) -> None:
        """Note that a motion has ended."""
        motion.running, motion.ended_s = False, now
        self._resting_since = None  # delayed positions from before the motion may have looked like rest
        self._unrest.end(now)

    def _update_rest(self, sample: UrSample) -> None:
        """Track since when the arm has been at rest."""
        first = self._resting_since
        if sample.speed > self._rest.speed:
            self._resting_since = None
        elif first is None or sample.distance(first.q) > self._rest.position:
            self._resting_since = sample

    def _watch_rest(self, sample: UrSample) -> None:
        """Record a fault if the arm leaves its rest without a motion of ours: something pushes it, or it creeps."""
        first, at = self._resting_since, self._rests_at
        meant = self._motion is not None or self.may_move or self._halted or self._application.braked
        if meant or self._fault is not None or sample.program != "PLAYING":
            self._rests_at = self._departed_s = None
        elif at is None:
            if first is not None and sample.time_s - first.time_s >= self._rest.dwell_s:
                self._rests_at = first
        elif sample.speed <= self._rest.speed and sample.distance(at.q) <= self._rest.position:
            self._departed_s = None
        elif self._departed_s is None:
            self._departed_s = sample.time_s
        elif sample.time_s - self._departed_s >= REST_DWELL_S:
            off, speed = math.degrees(sample.distance(at.q)), math.degrees(sample.speed)
            text = f"it left its rest without being asked: now {off:.3f} deg from there, at {speed:.2f} deg/s"
            self._record_fault(failed(text))

    def _answer_settle_requests(self, sample: UrSample, now: float, news: bool) -> None:
        waiting = []
        for item in self._settle_requests:
            answer = self._settled(sample, now, news)
            if answer is None and now > item.deadline_s:
                why = "; it stands, because the speed slider is at 0 %: raise it" if sample.slider_down else ""
                answer = {"error": "timeout", "text": f"it did not come to rest within {item.timeout_s:g} s{why}"}
            if answer is None:
                waiting.append(item)
            else:
                self._application.answer({"id": item.request, **answer})
        self._settle_requests = waiting

    def _settled(self, sample: UrSample, now: float, news: bool) -> dict[str, Any] | None:
        """Return the answer to a settle request if the arm has settled, was stopped or has a fault; else None."""
        if self._fault is not None:
            return {"error": self._fault.kind, "text": self._fault.text}
        if self._cut_short or self._application.braked:
            return {"error": "stopped", "text": self._stopped().text}
        motion, first = self._motion, self._resting_since
        ended_for_s = math.inf if motion is None else now - motion.ended_s
        if not news or ended_for_s < STREAMS_APART_S:
            return None
        if first is None or sample.time_s - first.time_s < self._rest.dwell_s:
            return None
        off = 0.0 if motion is None else sample.distance(motion.goal)
        if off > AT_GOAL_RAD and ended_for_s < _CUT_SHORT_S:
            return None
        self._motion = None
        self._unrest.settled()
        if off > AT_GOAL_RAD:
            text = f"its motion was cut short: it rests {math.degrees(off):.2f} deg from its goal"
            fault = self._record_fault(failed(text))
            return {"error": fault.kind, "text": fault.text}
        return {"ok": {**asdict(sample), "moving": False, "fault": None}}
