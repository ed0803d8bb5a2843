"""A Leica tracker (AT960 and relatives) through Leica's LMF, in this process, on the Windows PC it is connected to.

Written from Leica's documents and from what other programs do. Neither LMF nor a tracker was available, so the tests
run against a stand-in with LMF's names and rules. What those sources leave open is a setting, is read from the objects
themselves (units, kinds of enumerations), or is refused.

Threads: one thread of the driver calls LMF, and every wait for it has a time limit, so a call that hangs blocks only
that thread. LMF delivers its events one by one on a thread of its own. A command that causes an event waits until its
handlers have returned; ours only store the message. While a *property* is read or written (unlike a method call),
pythonnet keeps Python's lock, so a handler that LMF waits for could never run. Hence no handler is subscribed while
settings are written.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.lmf_objects import (
    ErrorLaw,
    Handlers,
    Lmf,
    apply_settings,
    describe,
    error_number,
    laser_and_stand,
    load_lmf,
    read_air,
    read_position,
    read_rotation,
    set_quantity,
    set_value,
    start_level_monitoring,
    to_si,
    tracker_time_s,
    unwrap,
)
from drivers.trackers.lmf_options import DEFAULT_LIBRARY, LmfOptions
from drivers.trackers.lmf_stream import CONTINUOUS_PROFILE, LIMITS, Following, continuous_profile
from drivers.trackers.protocol import (
    PACKETS_HZ,
    Halted,
    NotReady,
    Point,
    Preparation,
    StreamLimits,
    TargetLost,
    Track,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TrackerTimeout,
    Unstable,
    WrongTarget,
    checked_point,
    no_packet,
    require_ready,
)

Vector = NDArray[np.float64]
_T = TypeVar("_T")

MEASURING_S: Mapping[str, float] = MappingProxyType({"fast": 2.0, "standard": 12.0, "precise": 12.0})
"""Time limits of a stationary measurement on the AT9x0 by accuracy, as Leica recommends [s]."""
OTHER_PROFILE_S = 7.0
"""Time for starting and ending a measurement, added to an averaging time that the caller sets."""
CONNECTING_S = 60.0
INITIALISING_S = 60.0
"""Time limit of the initialisation. Leica allows 30 s; its simulator is slow on purpose."""
LEVELLING_S = 180.0

_NO_PREPARATION = Preparation()
_USUAL_ACCURACY = ErrorLaw()
_IN_USE = 10011
"""LMF's error number for a tracker that another program holds."""
_MAX_MESSAGES = 200
_POINTING, _MEASURING = "pointing and searching", "measuring"


class LmfTracker:
    """One Leica tracker through LMF; it streams if LMF has continuous measurements."""

    def __init__(
        self,
        settings: LmfOptions,
        preparation: Preparation = _NO_PREPARATION,
        load: Callable[[str], Lmf] = load_lmf,
        law: ErrorLaw = _USUAL_ACCURACY,
    ) -> None:
        """Open nothing yet. ``preparation`` is applied at every connect, as LMF forgets its settings.

        ``law`` is the accuracy of the tracker.
        """
        self._use = settings
        self._law = law
        self._preparation = preparation
        self._load = load
        self._lmf: Lmf | None = None
        self._tracker: Any = None
        self._calls: CallThread | None = None
        self._messages: deque[str] = deque(maxlen=_MAX_MESSAGES)
        self._unreported: deque[str] = deque(maxlen=_MAX_MESSAGES)
        self._disconnected = ""
        self._reflector = ""
        self._averaging_set_s: float | None = None
        self._following: Following | None = None
        self._handlers = Handlers(
            ("", "Disconnected", self._on_disconnected),
            ("", "ErrorArrived", self._on_message),
            ("", "WarningArrived", self._on_message),
        )

    # -- link ----------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect, check the serial number and apply the settings. The head does not move.

        Raises
        ------
        LmfMissing
            If LMF is not installed.
        TrackerRefused
            If another program holds the tracker.
        TrackerLinkLost
            If it cannot be reached.
        TrackerError, NotReady, ValueError
            If it is another tracker, or does not take a setting.
        """
        self.disconnect()
        self._disconnected = ""
        calls = self._calls = CallThread()
        try:
            calls.call("connecting", partial(self._open, calls), max(CONNECTING_S, self._use.timeout))
        except BaseException:
            self.disconnect()
            raise

    def _open(self, calls: CallThread) -> None:
        lmf = self._lmf = self._load(self._use.library)
        address = self._use.address
        try:
            tracker = lmf.Connection().Connect(address)
        except lmf.exceptions as error:
            if error_number(error) == _IN_USE:
                raise TrackerRefused(
                    f"tracker {address}: another program or connection holds it: {describe(error)}"
                ) from error
            raise TrackerLinkLost(f"tracker {address}: no connection: {describe(error)}") from error
        if tracker is None:
            raise TrackerLinkLost(f"tracker {address}: no connection, and LMF gives no reason")
        if self._calls is not calls:  # connect() has timed out; a tracker left connected would refuse the next attempt
            tracker.Disconnect()
            return
        self._tracker, self._handlers.added = tracker, False
        serial = str(tracker.SerialNumber)
        if self._use.serial and serial != self._use.serial:
            raise TrackerError(
                f"tracker {address}: its serial number is {serial}, the settings name {self._use.serial};"
                " check address and serial"
            )
        with self._translating_errors("settings"):
            self._apply(tracker, self._preparation)
        self._handlers.set(tracker, wanted=True)

    def disconnect(self) -> None:
        """Release the tracker; harmless when not connected. A track ends; a call that hangs is abandoned."""
        with contextlib.suppress(TrackerError):
            self._leave()
        calls, tracker = self._calls, self._tracker
        self._calls = self._tracker = None
        self._averaging_set_s = None
        if calls is None:
            return
        if tracker is not None:
            with contextlib.suppress(TrackerError):  # it is released in any case
                calls.call("disconnecting", partial(self._close, tracker), self._use.timeout)
        calls.close()

    def _close(self, tracker: Any) -> None:
        with self._translating_errors("disconnecting"):
            self._handlers.set(tracker, wanted=False)
            tracker.Disconnect()

    def identify(self) -> TrackerIdentity:
        """Return model, serial number and firmware, and whether LMF only simulates the tracker."""
        return self._call("identifying", self._identify)

    def _identify(self, tracker: Any) -> TrackerIdentity:
        simulated = " (simulated by LMF)" if self._use.simulated else ""
        model = f"{tracker.ProductName or tracker.Name or 'tracker'}{simulated}"
        return TrackerIdentity(model, str(tracker.SerialNumber), f"firmware {tracker.InstalledFirmware}")

    def notices(self) -> list[str]:
        """Return deficiencies that do not prevent measuring, and the messages the tracker has sent, as sentences."""
        return [*self._call("reading the tracker's state", self._deficiencies), *self._messages]

    def _deficiencies(self, tracker: Any) -> list[str]:
        notices = []
        if not unwrap(tracker.IsCompatibleWithInstalledFirmware):
            notices.append(
                f"its firmware is {tracker.InstalledFirmware}, this LMF was made for {tracker.ExpectedFirmware}"
            )
        if tracker.Compensations.Selected is None:
            notices.append("no compensation is selected")
        return notices + self._air_notices(tracker)

    def _air_notices(self, tracker: Any) -> list[str]:
        lacks = self._preparation.temperature_c is None and not unwrap(tracker.MeteoStation.IsAirSensorConnected)
        return ["its air sensor is not connected"] if lacks else []

    def visible_trackers(self) -> str:
        """Return the trackers that LMF finds in this computer's networks, as a sentence for a person."""
        return visible_trackers(self._use.library, self._load)

    def confirm(self, within_s: float) -> None:
        """Check that LMF answers and has not reported the connection closed. Raises as the protocol says."""
        if self._calls is not None:
            self._calls.require_idle()
        try:
            self._call("confirming", lambda tracker: unwrap(tracker.QuickRelease), within_s)
        except TrackerTimeout as error:
            raise TrackerLinkLost(f"tracker: LMF did not answer within {within_s:g} s") from error

    def data_age_s(self) -> float:
        """Return the time since LMF returned from a call [s]; 0 while a call runs within the time that Leica allows.

        During a call LMF reports nothing and monitors the connection itself. inf after it has reported the connection
        closed.
        """
        calls = self._calls
        return math.inf if calls is None or self._disconnected else calls.age_s()

    # -- settings ------------------------------------------------------------------------------------------------------

    def prepare(self, settings: Preparation) -> None:
        """Initialise and level if needed (the head moves), and apply ``settings`` now and at every connect.

        A track ends. Raises ``NotReady`` with all unmet preconditions, ``ValueError`` for a setting that the tracker
        does not have.
        """
        self._leave()
        self._clear_halt()
        # LMF's number for "not initialised" is not public: any precondition may mean it if the laser is ready
        known = self._call(
            "reading the tracker's state", lambda its: bool(laser_and_stand(its)) or not self._preconditions(its)
        )
        if not known:
            self._call("initialising", lambda tracker: tracker.Initialize(), INITIALISING_S, haltable=True)
        self._call("settings", partial(self._apply, preparation=settings))
        self._preparation = settings
        if self._use.gravity:
            self._call("levelling", self._level, LEVELLING_S, haltable=True)
        require_ready(self.unmet())

    def _apply(self, tracker: Any, preparation: Preparation) -> None:
        assert self._lmf is not None
        with self._no_handlers(tracker):
            self._averaging_set_s = None
            self._reflector = apply_settings(self._lmf, tracker, self._use, preparation)

    def _level(self, tracker: Any) -> None:
        with self._no_handlers(tracker):
            start_level_monitoring(tracker)

    # -- events --------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _no_handlers(self, tracker: Any) -> Iterator[None]:
        """Unsubscribe the handlers while settings are written; the module docstring says why."""
        subscribed = self._handlers.added
        self._handlers.set(tracker, wanted=False)
        try:
            yield
        finally:
            if subscribed:
                self._handlers.set(tracker, wanted=True)

    def _on_disconnected(self, *arguments: Any) -> None:
        cause = arguments[-1] if arguments else None
        self._disconnected = "LMF reports the connection closed" + (f": {describe(cause)}" if cause is not None else "")

    def _on_message(self, *arguments: Any) -> None:
        if arguments:
            self._unreported.append(describe(arguments[-1]))

    # -- readiness -----------------------------------------------------------------------------------------------------

    def unmet(self) -> list[str]:
        """Return what prevents measuring. An SMR that is not locked does not count: measuring points at it first."""
        return self._call("reading the tracker's state", self._unmet)

    def _unmet(self, tracker: Any) -> list[str]:
        return laser_and_stand(tracker) + self._preconditions(tracker)

    def _preconditions(self, tracker: Any) -> list[str]:
        locked = tracker.Targets.Selected is not None
        unmet = []
        for precondition in tracker.Measurement.Status.Preconditions:
            text = describe(precondition)
            if locked or not any(word.casefold() in text.casefold() for word in self._use.target_words):
                unmet.append(text)
        return unmet

    # -- measuring -----------------------------------------------------------------------------------------------------

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Point at ``expected_M`` (3,) [m], lock the SMR there and measure it in face 1. Errors as in the protocol.

        The tracker sets the averaging time, unless ``stationary`` is "time". A track ends.
        """
        self._leave()
        expected = checked_point(expected_M, averaging_s)
        self._clear_halt()
        self._call(_POINTING, partial(self._lock, expected=expected, averaging_s=averaging_s), haltable=True)
        return self._average(expected, averaging_s)

    def halt(self) -> None:
        """Make the running measurement raise ``Halted``. LMF completes its call; the next call waits for that."""
        calls = self._calls
        if calls is not None:
            calls.halt()

    def _lock(self, tracker: Any, expected: Vector, averaging_s: float) -> None:
        require_ready(self._unmet(tracker))
        if self._use.stationary == "time" and averaging_s != self._averaging_set_s:
            with self._no_handlers(tracker):
                set_quantity(tracker.Measurement.Profiles.Selected.Time, "time", averaging_s)
            self._averaging_set_s = averaging_s
        if not unwrap(tracker.Face.IsFace1):
            tracker.Face.Change()
        found = tracker.PositionTo(True, False, *(float(value) for value in expected))
        if found is None or tracker.Targets.Selected is None:
            raise TargetLost(f"tracker: no SMR found near ({', '.join(f'{v:.3f}' for v in expected)}) m")
        probe = self._use.probes and not unwrap(found.IsSelectable)  # LMF finds probes; reflectors are selected
        if self._reflector and str(found.Name) != self._reflector and not probe:
            raise WrongTarget(f"tracker: it locked a '{found.Name}' where a '{self._reflector}' was expected")

    def _average(self, expected: Vector, averaging_s: float) -> Point:
        if self._use.stationary == "time":
            limit_s = averaging_s + OTHER_PROFILE_S
        else:
            limit_s = MEASURING_S[self._preparation.accuracy]
        read = partial(self._read, averaging_s=averaging_s)
        point = self._call(_MEASURING, read, limit_s, haltable=True)
        off_m = float(np.linalg.norm(point.p_M - expected))
        if off_m > self._use.wrong_target:
            raise WrongTarget(f"tracker: it locked an SMR {off_m * 1e3:.0f} mm from where one was expected")
        return point

    def _read(self, tracker: Any, averaging_s: float) -> Point:
        """Measure the locked SMR and convert LMF's result."""
        assert self._lmf is not None
        if tracker.Targets.Selected is None:
            raise TargetLost("tracker: the beam to the SMR broke before it was measured")
        began_s = time.monotonic()
        result = tracker.Measurement.MeasureStationary()
        ended_s = time.monotonic()
        if result is None:
            raise TargetLost("tracker: it measured nothing")
        p_M, precision_M = read_position(self._lmf, result.Position)
        precision_m = float(np.linalg.norm(precision_M))
        if precision_m > self._use.shaking:
            raise Unstable(f"tracker: the SMR moved while it was measured: precision {precision_m * 1e6:.0f} µm")
        covariance_M = self._law.covariance(p_M)
        covariance_M *= max(1.0, precision_m**2 / float(np.trace(covariance_M)))  # the SMR shook more than specified
        air, quality = read_air(result)
        quaternion_M = read_rotation(self._lmf, result)
        return Point(
            p_M=p_M,
            covariance_M=covariance_M,
            time_s=0.5 * (began_s + ended_s),
            averaging_s=averaging_s if self._use.stationary == "time" else ended_s - began_s,
            temperature_c=air["Temperature"],
            pressure_hpa=air["Pressure"],
            humidity_percent=air["Humidity"],
            reflector=self._reflector,
            quality=(*quality, *self._air_notices(tracker), *self._new_messages()),
            quaternion_M=quaternion_M,
            sigma_rad=None if quaternion_M is None else self._law.sigma_rad,
        )

    def _new_messages(self) -> list[str]:
        """Return the messages received since the last point, and keep them for ``notices``."""
        messages = [self._unreported.popleft() for _ in range(len(self._unreported))]
        self._messages.extend(messages)
        return messages

    # -- following a moving SMR ----------------------------------------------------------------------------------------

    def stream_limits(self) -> StreamLimits | None:
        """Return the limits of an AT960; None if this tracker has no continuous measurement."""
        profile = self._call("reading the profiles", lambda its: continuous_profile(its) is not None)
        return LIMITS if profile else None

    def start_track(
        self,
        expected_M: Vector,
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Lock the SMR, select the continuous measurement and start it."""
        LIMITS.check(interval_s)
        expected = checked_point(expected_M, interval_s)
        self._leave()
        self._clear_halt()
        self._call(_POINTING, partial(self._lock, expected=expected, averaging_s=interval_s), haltable=True)
        self._following = following = Following(self._packet, lost, received)
        try:
            self._call("starting to follow", partial(self._begin, following=following, interval_s=interval_s))
        except BaseException:
            with contextlib.suppress(TrackerError):  # report why it did not begin, not why it did not end
                self.end_track()
            raise

    def end_track(self) -> Track:
        """Stop measuring, return to stationary measurements and return all points."""
        following, self._following = self._following, None
        if following is None:
            return Track.of([])
        try:
            self._call("ending the measurement", partial(self._stop, following=following))
        finally:
            packets = following.end()
        return Track.of(packets)

    def _begin(self, tracker: Any, following: Following, interval_s: float) -> None:
        profile = continuous_profile(tracker)
        if profile is None:
            raise TrackerError(f"tracker: this tracker has no {CONTINUOUS_PROFILE}")
        with self._no_handlers(tracker):
            profile.Select()
            self._averaging_set_s = None
            set_quantity(profile.TimeSeparation, "time", interval_s)
            set_value(profile, "PacketRate", max(1, min(int(PACKETS_HZ), round(1.0 / interval_s))))
        following.handlers.set(tracker, wanted=True)
        tracker.Measurement.StartMeasurement()
        if tracker.Targets.Selected is None:
            raise TargetLost("tracker: the beam to the SMR broke before it was followed")

    def _stop(self, tracker: Any, following: Following) -> None:
        following.handlers.set(tracker, wanted=False)
        self._apply(tracker, self._preparation)  # stops the measurement and selects the stationary one

    def _leave(self) -> None:
        """End a track that is still running."""
        if self._following is not None:
            self.end_track()

    def _packet(self, points: Any, arrived_s: float) -> Track:
        """Convert a packet of LMF, on the thread that reads them. Raises ``TrackerError``."""
        stamps, places = [], []
        with self._translating_errors("reading points"):
            for one in points:
                position = one.Position
                places.append([to_si(getattr(position, f"Coordinate{axis}"), "length") for axis in (1, 2, 3)])
                stamps.append(tracker_time_s(one) or math.nan)
        p_M = np.array(places, dtype=np.float64).reshape(-1, 3)
        time_s = np.array(stamps, dtype=np.float64)
        known = np.isfinite(time_s) & np.isfinite(p_M).all(axis=1)
        p_M, time_s = p_M[known], time_s[known]
        sigma_m = np.array([math.sqrt(np.trace(self._law.covariance(p)) / 3.0) for p in p_M], dtype=np.float64)
        return Track(time_s, p_M, sigma_m, np.full(len(p_M), arrived_s))

    # -- calls ---------------------------------------------------------------------------------------------------------

    def _clear_halt(self) -> None:
        if self._calls is not None:
            self._calls.clear_halt()

    def _call(
        self, what: str, function: Callable[[Any], _T], limit_s: float | None = None, *, haltable: bool = False
    ) -> _T:
        """Run ``function(tracker)`` on the thread that calls LMF; convert LMF's exceptions to ``TrackerError``."""
        calls, tracker = self._calls, self._tracker
        if calls is None or tracker is None:
            raise TrackerLinkLost(f"tracker {self._use.address}: not connected")
        if self._disconnected:
            raise TrackerLinkLost(f"tracker {self._use.address}: {self._disconnected}; connect again")

        def run() -> _T:
            with self._translating_errors(what):
                return function(tracker)

        return calls.call(what, run, self._use.timeout if limit_s is None else limit_s, haltable=haltable)

    @contextlib.contextmanager
    def _translating_errors(self, what: str) -> Iterator[None]:
        exceptions = () if self._lmf is None else self._lmf.exceptions
        try:
            yield
        except exceptions as error:
            raise self._classified(what, error) from error
        except AttributeError as error:
            raise TrackerError(f"tracker: this LMF lacks what the driver needs: {error}; is it v1.10?") from error

    def _classified(self, what: str, error: BaseException) -> TrackerError:
        """Return the protocol's error for an exception of LMF.

        LMF publishes no numbers for a lost target, so the state after the failure decides.
        """
        text = f"tracker: {what} failed: {describe(error)}"
        if self._disconnected:
            return TrackerLinkLost(f"{text}; {self._disconnected}")
        if error_number(error) in self._use.lost_numbers:
            return TargetLost(text)
        exceptions = () if self._lmf is None else self._lmf.exceptions
        try:
            unmet = self._unmet(self._tracker)
            lost = self._tracker.Targets.Selected is None
        except exceptions:
            return TrackerLinkLost(f"{text}; its state cannot be read either")
        if unmet:
            return NotReady(f"{text}; not ready: {'; '.join(unmet)}")
        return TargetLost(text) if lost and what in (_POINTING, _MEASURING) else TrackerError(text)


# -- Search for Leica trackers in this computer's networks ------------------------------------------------------------


FINDING_S = 30.0


def visible_trackers(library: str = DEFAULT_LIBRARY, load: Callable[[str], Lmf] = load_lmf) -> str:
    """Return the trackers that LMF finds in this computer's networks, or why it cannot search, as a sentence."""

    def find() -> str:
        lmf = load(library)
        try:
            finder = lmf.TrackerFinder()
            finder.Refresh()
            names = ", ".join(f"{t.Type} {t.SerialNumber} at {t.IPAddress}" for t in finder.Trackers)
        except lmf.exceptions as error:
            return f"tracker: LMF could not search for trackers: {describe(error)}"
        return f"LMF sees {names}" if names else "LMF sees no tracker in the networks of this computer"

    calls = CallThread()
    try:
        return calls.call("searching for trackers", find, FINDING_S)
    except TrackerError as error:
        return str(error)
    finally:
        calls.close()


# -- A thread for calls that may hang; every wait for a call has a time limit -----------------------------------------


_LOOK_S = 0.05


@dataclass(eq=False)
class _Call(Generic[_T]):
    """One call and, when it is done, its return value or exception."""

    what: str
    function: Callable[[], _T]
    limit_s: float
    began_s: float
    started: bool = False
    done: bool = False
    result: _T | None = None
    error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self.function()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that made the call
            self.error = error


class CallThread:
    """Runs calls one by one on one thread. A call that exceeds its time limit is abandoned; it blocks the next one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._current: _Call[Any] | None = None
        self._halted = False
        self._closed = False
        self._returned_s = -math.inf
        threading.Thread(target=self._work, name="LMF", daemon=True).start()

    def call(self, what: str, function: Callable[[], _T], limit_s: float, *, haltable: bool = False) -> _T:
        """Run ``function``; return its value or raise its exception.

        Raises
        ------
        TrackerTimeout
            If it takes longer than ``limit_s``.
        TrackerLinkLost
            If the previous call has still not returned.
        Halted
            If ``haltable`` and ``halt`` is called meanwhile; the result of the call is then discarded.
        """
        call = _Call(what, function, limit_s, time.monotonic())
        with self._changed:
            previous = self._current
            if previous is not None and not self._wait_for(lambda: previous.done, previous.limit_s):
                raise TrackerLinkLost(
                    f"tracker: LMF has not returned from {previous.what}; disconnect, check that the tracker is on, and"
                    " connect again"
                )
            call.began_s = time.monotonic()
            self._current = call
            self._changed.notify_all()
            self._wait_for(lambda: call.done or (haltable and self._halted), limit_s)
            if haltable and self._halted:
                raise Halted("tracker: a halt was requested; no measurement was made")
            if not call.done:
                raise TrackerTimeout(f"tracker: {what} took longer than {limit_s:g} s")
        if call.error is not None:
            raise call.error
        return cast(_T, call.result)

    def _wait_for(self, done: Callable[[], bool], limit_s: float) -> bool:
        """Wait until ``done()``, holding ``_changed``; time in which this process was not scheduled does not count."""
        waited_s = 0.0
        while not done() and waited_s < limit_s:
            began_s = time.monotonic()
            self._changed.wait(min(_LOOK_S, limit_s - waited_s))
            waited_s += min(time.monotonic() - began_s, _LOOK_S)
        return done()

    def require_idle(self) -> None:
        """Raise ``TrackerTimeout`` while an abandoned call runs, ``TrackerLinkLost`` after its time limit."""
        call = self._current
        if call is None or call.done:
            return
        if time.monotonic() < call.began_s + call.limit_s:
            raise TrackerTimeout(f"tracker: LMF is still at work on {call.what}, which was given up; wait for its end")
        raise TrackerLinkLost(f"tracker: LMF has not returned from {call.what}; check that the tracker is on")

    def age_s(self) -> float:
        """Return the time since the last call returned without an error [s]; 0 while a call is within its time limit.

        Never blocks.
        """
        call, now = self._current, time.monotonic()
        if call is not None and not call.done and now < call.began_s + call.limit_s:
            return 0.0
        return now - self._returned_s

    def halt(self) -> None:
        """End the wait for a haltable call, now and until ``clear_halt``."""
        with self._changed:
            self._halted = True
            self._changed.notify_all()

    def clear_halt(self) -> None:
        """Allow haltable calls again."""
        with self._changed:
            self._halted = False

    def close(self) -> None:
        """Let the thread end after its current call."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or (self._current is not None and not self._current.started)
                )
                call = self._current
                if call is None or call.started:
                    return
                call.started = True
            call.run()
            if call.error is None:
                self._returned_s = time.monotonic()
            with self._changed:
                call.done = True
                self._changed.notify_all()
