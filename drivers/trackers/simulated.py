"""The tracker of the simulated cell, with its own errors and faults."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant, TrueTarget
from drivers.plant.clearance import segment_distances
from drivers.plant.mechanism import Posture, nominal
from drivers.plant.optics import why_hidden
from drivers.plant.sweep import DYNAMIC_M, recent_smr
from drivers.plant.transforms import quaternion, rigid, transform_points
from drivers.trackers.imperfections import PERFECT, Imperfections, refractivity
from drivers.trackers.protocol import (
    PACKETS_HZ,
    Halted,
    Point,
    Preparation,
    StreamLimits,
    TargetLost,
    Track,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    Unstable,
    WrongTarget,
    checked_point,
    no_packet,
    require_ready,
)

Vector = NDArray[np.float64]

SEARCH_RADIUS_M = 0.1
"""Search radius about the expected point."""
POINTING_S = 0.5
"""Time for turning the head and locking."""
INITIALISE_S = 30.0
SETTLE_S = 0.1
"""Time at rest after which an SMR no longer shakes."""
REFLECTORS = ("simulated 1.5 in",)

_WATCH_S = 0.02
"""Interval of checking the target while anything moves: 5 mm at 0.25 m/s."""
_MOVED_M = 5e-6
"""A target that moves by more than the tracker's noise counts as unstable."""
_STANDARD_AIR = (20.0, 1013.25, 50.0)
"""Air for the refraction correction without a weather station: temperature [degC], pressure [hPa], humidity [%]."""


class SimulatedTracker:
    """The tracker of a ``Plant``. It locks the visible SMR that is nearest to the expected point, of any arm.

    An SMR is visible inside the field of view and its acceptance angle, if no body of any arm crosses the beam.

    Attributes
    ----------
    plant, errors, sight, dynamic : Plant, Imperfections, TrueSight, numpy.random.Generator
        Its cell, its own errors, what it sees, and the random numbers of a moving SMR.
    obstacles : list of str
        Unmet preconditions in words; add one to make the tracker refuse.
    measured : int
        Number of points measured.
    """

    def __init__(
        self,
        plant: Plant,
        imperfections: Imperfections = PERFECT,
        *,
        nests: Mapping[str, Vector] | None = None,
        wrong_target_m: float | None = None,
        switched_on_s: float = -math.inf,
        pass_time: Callable[[float], None] | None = None,
        watch_s: float = math.inf,
    ) -> None:
        """Prepare the tracker of ``plant``; nothing is opened yet.

        Parameters
        ----------
        nests : mapping, or None
            SMRs in fixed places, name -> (3,) [m] in M.
        wrong_target_m : float or None
            Largest distance of a locked SMR from the expected point [m]; None leaves this check to the caller.
        switched_on_s : float
            When it was switched on, on the plant's clock [s].
        pass_time : callable, or None
            Lets a duration [s] of the plant pass; None is ``plant.advance``. It must wait if another thread advances
            the plant.
        watch_s : float
            Longest interval of checking the target meanwhile [s].
        """
        self.plant = plant
        self.errors = imperfections
        self.sight = TrueSight(plant, nests)
        self._wrong_target_m = wrong_target_m
        self._switched_on_s = switched_on_s
        self._pass_time = plant.advance if pass_time is None else pass_time
        self._watch_s = watch_s
        self._settings = Preparation()
        self._initialised = True
        self._halt = threading.Event()
        self._stream: SimulatedStream | None = None
        """Stream of the SMR that is being followed; None if there is none."""
        self._blind_until_s = -math.inf
        """Time until which a broken beam cannot be locked again [s]."""
        self.dynamic = plant.config.random(3)
        self._rotation_noise = plant.config.random(5)
        self._connected = False
        self._link_cut = False
        self._down_until_s = -math.inf
        self.obstacles: list[str] = []
        self.measured = 0

    @property
    def covered(self) -> set[str]:
        """Arms or nests whose SMR is covered."""
        return self.sight.covered

    @covered.setter
    def covered(self, names: set[str]) -> None:
        self.sight.covered = names

    # -- link ----------------------------------------------------------------------------------------------------------

    def _down(self) -> str:
        if self._link_cut:
            return "cut"
        if self.plant.clock_s < self._down_until_s:
            return "down: the tracker is starting"
        return ""

    def connect(self) -> None:
        """Open the link. Raises ``TrackerLinkLost`` while it is cut."""
        down = self._down()
        if down:
            raise TrackerLinkLost(f"tracker: the simulated link is {down}")
        self._connected = True

    def _link(self) -> None:
        down = self._down()
        if down or not self._connected:
            raise TrackerLinkLost(f"tracker: the simulated link is {down or 'not open; connect first'}")

    def confirm(self, within_s: float) -> None:
        """Return at once. Raises ``TrackerLinkLost`` while the link is cut or down."""
        self._link()

    def data_age_s(self) -> float:
        """Return 0 while the link is open, inf otherwise."""
        return 0.0 if self._connected and not self._down() else math.inf

    def identify(self) -> TrackerIdentity:
        """Return the identity of a simulated tracker."""
        self._link()
        return TrackerIdentity(model="simulated tracker", serial="SIM-tracker", software="simulated")

    def prepare(self, settings: Preparation) -> None:
        """Apply ``settings``; after a restart initialise first, which takes ``INITIALISE_S``."""
        self._link()
        if settings.reflector and settings.reflector not in REFLECTORS:
            known = ", ".join(f"'{name}'" for name in REFLECTORS)
            raise ValueError(f"tracker: it has no reflector '{settings.reflector}'; it has {known}")
        if not self._initialised:
            self._halt.clear()
            self._wait(INITIALISE_S)
            self._initialised = True
        self._settings = settings

    def unmet(self) -> list[str]:
        """Return every unmet precondition in words."""
        self._link()
        unmet = list(self.obstacles)
        if not self._initialised:
            unmet.append("it has not been initialised since it was switched on")
        remaining = self._switched_on_s + self.errors.laser_s - self.plant.clock_s
        if remaining > 0.0:
            unmet.append(f"its laser is warming up, {remaining:.0f} s are left")
        return unmet

    # -- measuring -----------------------------------------------------------------------------------------------------

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Lock the visible SMR nearest to ``expected_M`` (3,) [m] and average it for ``averaging_s``.

        The SMR may belong to another arm: without ``wrong_target_m``, the caller must check the distance to the
        expected point. Raises ``TargetLost``, ``WrongTarget``, ``Unstable``, ``NotReady``, ``Halted``
        or ``TrackerLinkLost``.
        """
        expected = self._checked_request(expected_M, averaging_s)
        self._wait(POINTING_S)
        locked = self._lock(expected)
        rested_s = math.inf if locked.arm is None else self.plant.clock_s - self.plant.rest_s(locked.arm)
        if locked.moving or rested_s < SETTLE_S:
            self._unstable(locked)
        taken_s = self.plant.clock_s
        air = (self.plant.air_c, self.errors.pressure_hpa, self.errors.humidity_percent)
        read, covariance = self.plant.measure_positions(locked.p_M[None], averaging_s=averaging_s)
        applied, warnings = self._applied(air)
        p_M = self._with_errors(read[0], air, applied)
        self._average(locked, averaging_s)
        if self._wrong_target_m is not None and np.linalg.norm(p_M - expected) > self._wrong_target_m:
            off_mm = float(np.linalg.norm(p_M - expected)) * 1e3
            raise WrongTarget(f"tracker: it locked an SMR {off_mm:.0f} mm from where one was expected")
        self.measured += 1
        return Point(
            p_M=p_M,
            covariance_M=covariance[0],
            time_s=taken_s + 0.5 * averaging_s,
            averaging_s=averaging_s,
            temperature_c=applied[0],
            pressure_hpa=applied[1],
            humidity_percent=applied[2],
            reflector=self._settings.reflector or REFLECTORS[0],
            quality=warnings,
            quaternion_M=self._orientation(locked),
            sigma_rad=None if locked.R_M_S is None else locked.sigma_rad,
        )

    def _checked_request(self, expected_M: Vector, averaging_s: float) -> Vector:
        require_ready(self.unmet())
        expected = checked_point(expected_M, averaging_s)
        self._halt.clear()
        if self._stream is not None:  # another measurement ends the stream
            self._stream.end()
            self._stream = None
        return expected

    def _orientation(self, locked: TrueTarget) -> Vector | None:
        """Return the measured orientation of a 6-D probe (4,); None for an SMR."""
        if locked.R_M_S is None:
            return None
        error = np.zeros(6)
        if self.plant.config.noise:
            error[3:] = locked.sigma_rad * self._rotation_noise.standard_normal(3)
        return quaternion(rigid(error)[:3, :3] @ locked.R_M_S)

    # -- following a moving SMR ----------------------------------------------------------------------------------------

    def stream_limits(self) -> StreamLimits:
        """Return the limits of an AT960: up to 1000 points a second."""
        self._link()
        return STREAM_LIMITS

    def start_track(
        self,
        expected_M: Vector,
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Lock the SMR and measure it every ``interval_s``, while other calls advance the plant's time."""
        STREAM_LIMITS.check(interval_s)
        expected = self._checked_request(expected_M, interval_s)
        self._wait(POINTING_S)
        if self.plant.clock_s < self._blind_until_s:
            raise TargetLost("tracker: the SMR cannot be locked again yet")
        locked = self._lock(expected)

        def broken(error: TrackerError) -> None:
            self._blind_until_s = self.plant.clock_s + self.dynamic.uniform(0.0, self.errors.longest_loss_s)
            lost(error)

        self._stream = SimulatedStream(self, locked, interval_s, broken, received)
        self._stream.begin()

    def end_track(self) -> Track:
        """End the track and return all points."""
        stream, self._stream = self._stream, None
        self._link()
        track = Track.of([]) if stream is None else stream.end()
        self.measured += len(track.p_M)
        return track

    def hidden(self, locked: TrueTarget, p_M: Vector, normal_M: Vector) -> str:
        """Return why the locked SMR is not visible at ``p_M`` (3,) now; empty if it is."""
        return self._down() or self.sight.hidden(locked, p_M, normal_M)

    def points(self, p_M: Vector, *, moving: bool) -> tuple[Vector, Vector]:
        """Simulate measured points (n, 3) of true ones; return them and their standard uncertainties (n,)."""
        air = (self.plant.air_c, self.errors.pressure_hpa, self.errors.humidity_percent)
        read, covariance = self.plant.measure_positions(p_M)
        applied = self._applied(air)[0]
        read = np.array([self._with_errors(one, air, applied) for one in read]).reshape(-1, 3)
        if self.plant.config.noise and moving:
            distance = np.linalg.norm(read, axis=1, keepdims=True)
            read = read * (1.0 + DYNAMIC_M * self.dynamic.standard_normal(distance.shape) / distance)
        return read, np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0)

    def _lock(self, expected: Vector) -> TrueTarget:
        around = []
        for target in self.sight.targets():
            distance = float(np.linalg.norm(target.p_M - expected))
            if distance <= SEARCH_RADIUS_M:
                around.append((distance, self.sight.behind_bodies(target)))
        visible = [(distance, target) for distance, target in around if not target.hidden]
        if not visible:
            place = ", ".join(f"{v:.3f}" for v in expected)
            causes = "".join(f"; that of {target.owner} is there, but {target.hidden}" for _, target in around)
            raise TargetLost(f"tracker: no SMR within {SEARCH_RADIUS_M * 1e3:.0f} mm of ({place}) m{causes}")
        return min(visible, key=lambda pair: pair[0])[1]

    # -- time ----------------------------------------------------------------------------------------------------------

    def _moving(self) -> bool:
        return any(self.plant.moving(name) for name in self.plant.names)

    def _wait(self, duration_s: float) -> None:
        """Advance time in steps of at most ``watch_s``, up to each event. Raises ``Halted`` or ``TrackerLinkLost``."""
        end_s = self.plant.clock_s + duration_s
        remaining = duration_s
        while remaining > 0.0:
            step = min(remaining, self._watch_s, self.plant.undisturbed_s)
            self._pass_time(step)
            self._link()  # before the halt: a restart is a lost link
            if self._halt.is_set():
                raise Halted("tracker: a halt was requested; no measurement was made")
            remaining = 0.0 if remaining <= step else end_s - self.plant.clock_s

    def _average(self, locked: TrueTarget, averaging_s: float) -> None:
        """Wait for the end of the averaging; check the target while anything moves or an event changes it."""
        began_s = self.plant.clock_s
        remaining = averaging_s
        while remaining > 0.0:
            undisturbed_s = self.plant.undisturbed_s
            step = min(remaining, self._watch_s, undisturbed_s, _WATCH_S if self._moving() else math.inf)
            moved = self._moving() or step == undisturbed_s
            self._wait(step)
            moved = moved or any(self.plant.moving(n) or self.plant.rest_s(n) > began_s for n in self.plant.names)
            if moved:
                self._check_target(locked, began_s)
            remaining = 0.0 if remaining <= step else began_s + averaging_s - self.plant.clock_s

    def _check_target(self, locked: TrueTarget, began_s: float) -> None:
        now = self.sight.behind_bodies(next(target for target in self.sight.targets() if target.owner == locked.owner))
        if now.hidden:
            raise TargetLost(f"tracker: the beam to the SMR of {locked.owner} broke in mid-measurement: {now.hidden}")
        own_motion = locked.arm is not None and self.plant.rest_s(locked.arm) > began_s
        if now.moving or own_motion or np.linalg.norm(now.p_M - locked.p_M) > _MOVED_M:
            self._unstable(locked)

    @staticmethod
    def _unstable(locked: TrueTarget) -> NoReturn:
        raise Unstable(f"tracker: the SMR of {locked.owner} moved while it was measured")

    # -- what it reads -------------------------------------------------------------------------------------------------

    def _applied(self, air: tuple[float, float, float]) -> tuple[tuple[float, float, float], tuple[str, ...]]:
        """Return temperature, pressure and humidity used for the refraction correction, and warnings about them."""
        given = (self._settings.temperature_c, self._settings.pressure_hpa, self._settings.humidity_percent)
        source = air if self.errors.weather_station else _STANDARD_AIR
        missing = not self.errors.weather_station and None in given
        warnings = ("no weather station: refraction was corrected for standard air",) if missing else ()
        temperature, pressure, humidity = (s if g is None else g for g, s in zip(given, source, strict=True))
        return (temperature, pressure, humidity), warnings

    def _with_errors(self, p_M: Vector, air: tuple[float, float, float], applied: tuple[float, float, float]) -> Vector:
        """Return the point (3,) with the tracker's own errors; exactly ``p_M`` if there are none."""
        errors, since_s = self.errors, self.plant.clock_s - self._switched_on_s
        cold = math.exp(-since_s / errors.warm_up_s)
        p_M = errors.pointed(p_M, cold)
        if applied != air:  # it divides the optical path by the refractive index of the assumed air
            p_M = p_M * ((1.0 + refractivity(*air)) / (1.0 + refractivity(*applied)))
        if errors.warm_up_m and cold > 0.0:
            distance = float(np.linalg.norm(p_M))
            p_M = p_M * ((distance + errors.warm_up_m * cold) / distance)
        return p_M

    def halt(self) -> None:
        """End a running command, if another thread advances the plant; harmless when none runs."""
        self._halt.set()

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        self._connected = False

    # -- faults, for tests --------------------------------------------------------------------------------------------

    def cut_link(self) -> None:
        """Block all calls until ``release`` and ``connect``."""
        self._link_cut = True
        self._connected = False

    def release(self) -> None:
        """Restore the link."""
        self._link_cut = False

    def reboot(self, down_s: float = 0.0) -> None:
        """Restart: the link is down for ``down_s`` [s] of the plant's time; then connect and prepare again."""
        self._connected = False
        self._initialised = False
        self._settings = Preparation()
        self._down_until_s = self.plant.clock_s + down_s
        self._halt.set()


# -- The view of the simulated tracker: SMRs of arms and nests, and the bodies between them and the tracker -----------


class TrueSight:
    """The view of a tracker of ``plant``.

    Attributes
    ----------
    covered : set of str
        Arms or nests whose SMR is covered.
    """

    def __init__(self, plant: Plant, nests: Mapping[str, Vector] | None) -> None:
        """``nests`` are SMRs at fixed places, name -> (3,) [m] in M."""
        self._plant = plant
        self._nests = {name: np.array(p, dtype=np.float64) for name, p in (nests or {}).items()}
        self._bodies = {arm.name: nominal(arm) for arm in plant.config.arms}
        self._placed: dict[str, tuple[bytes, tuple[Vector, Vector]]] = {}
        """Cache: arm -> joint positions, and the ends of its capsules there."""
        self.covered: set[str] = set()

    def targets(self) -> list[TrueTarget]:
        """Return all SMRs of arms and nests, ignoring bodies in the beam."""
        found = [replace(one, hidden=self._cover(one.arm) or one.hidden) for one in self._plant.targets()]
        for name, p_M in self._nests.items():
            facing = -p_M / np.linalg.norm(p_M)
            why = self._cover(name) or why_hidden(self._plant.config.tracker, p_M, facing, math.pi)
            found.append(TrueTarget(None, p_M, why, nest=name))
        return found

    def _cover(self, name: str | None) -> str:
        """Return why the SMR of an arm or nest is covered; empty if it is not."""
        return "something covers it" if name in self.covered else ""

    def behind_bodies(self, target: TrueTarget) -> TrueTarget:
        """Return the SMR, hidden if a body is in the beam."""
        why = target.hidden or self._beam_obstacle(target.p_M, target.arm)
        return replace(target, hidden=why)

    def _beam_obstacle(self, p_M: Vector, owner: str | None) -> str:
        """Return in words whose body is between the tracker and ``p_M``; empty if there is none.

        Bodies fixed to the owner's flange are not checked: they hold the SMR, where the beam ends.
        """
        owners: list[str] = []
        bodies: list[tuple[Vector, Vector, Vector]] = []
        for name, mechanism in self._bodies.items():
            capsules = mechanism.capsules
            counted = capsules.frames < len(mechanism.masses) if name == owner else np.ones(len(capsules.frames), bool)
            start, end = self._segments(name)
            owners += [name] * int(counted.sum())
            bodies.append((start[counted], end[counted], capsules.radii[counted]))
        if not bodies:
            return ""
        start, end, radii = (np.concatenate(part) for part in zip(*bodies, strict=True))
        gaps = segment_distances(np.zeros_like(start), np.broadcast_to(p_M, start.shape), start, end)
        for row in np.flatnonzero(gaps < radii)[:1]:
            return f"{'its own arm' if owners[row] == owner else f'arm {owners[row]}'} blocks the beam"
        return ""

    def _segments(self, name: str) -> tuple[Vector, Vector]:
        """Return the ends (k, 3) of an arm's capsules in M, cached while the arm rests."""
        q = self._plant.q(name)
        key = q.tobytes()
        if name not in self._placed or self._placed[name][0] != key:
            posture = Posture(self._bodies[name], q[None], np.zeros(3))
            T_M_B = self._plant.true_T_M_B(name)
            start, end = (transform_points(T_M_B, ends[:, 0]) for ends in posture.segments())
            self._placed[name] = (key, (start, end))
        return self._placed[name][1]

    def recent(self, locked: TrueTarget, time_s: Vector) -> tuple[Vector, Vector]:
        """Return positions and viewing directions (n, 3) of an SMR at recent times (n,)."""
        if locked.arm is not None:
            return recent_smr(self._plant, locked.arm, time_s)
        p_M = np.repeat(locked.p_M[None], len(time_s), axis=0)
        return p_M, -p_M / np.linalg.norm(p_M, axis=1, keepdims=True)

    def hidden(self, locked: TrueTarget, p_M: Vector, normal_M: Vector) -> str:
        """Return why an SMR at ``p_M`` (3,) is not visible now; empty if it is."""
        if why := self._cover(locked.arm or locked.nest):
            return why
        acceptance = math.pi
        if locked.arm is not None:
            acceptance = next(arm.smr_acceptance for arm in self._plant.config.arms if arm.name == locked.arm)
        why = why_hidden(self._plant.config.tracker, p_M, normal_M, acceptance)
        return why or self._beam_obstacle(p_M, locked.arm)


# -- The stream of the simulated tracker: points of a moving SMR in packets, timestamped by the tracker's own clock ---


STREAM_LIMITS = StreamLimits(1e-3, 1.0)
_STILL_M = 1e-9
"""Motion between two packets below which an SMR counts as resting."""


class SimulatedStream:
    """Stream of one SMR; the plant's schedule sends its packets while other calls advance the time."""

    def __init__(
        self,
        tracker: SimulatedTracker,
        locked: TrueTarget,
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None],
    ) -> None:
        self._tracker, self._locked, self._interval_s = tracker, locked, interval_s
        self._plant, self._errors, self._rng = tracker.plant, tracker.errors, tracker.dynamic
        self._lost, self._received = lost, received
        self._began_s = self._plant.clock_s
        self._packet_s = max(interval_s, 1.0 / PACKETS_HZ)
        self._taken = 0
        self._packets: list[Track] = []
        self._arrived_s = -math.inf
        self._on = True

    def begin(self) -> None:
        """Take the first point, and schedule the first packet."""
        self._send(0)

    def end(self) -> Track:
        """Return all points up to now."""
        if self._on:
            self._take(may_break=False)
        self._on = False
        return Track.of(self._packets)

    def _send(self, number: int) -> None:
        """Send one packet and schedule the next."""
        if self._on and self._take(may_break=number > 0):
            self._plant.schedule.at(self._began_s + (number + 1) * self._packet_s, lambda: self._send(number + 1))

    def _take(self, *, may_break: bool) -> bool:
        """Measure the points due since the last packet and send them; return False if the beam has broken."""
        due = math.floor((self._plant.clock_s - self._began_s) / self._interval_s + 1e-6) + 1
        time_s = self._began_s + self._interval_s * np.arange(self._taken, due, dtype=np.float64)
        self._taken = due
        true_M, normal_M = self._tracker.sight.recent(self._locked, np.append(time_s, self._plant.clock_s))
        if why := self._broken(true_M[-1], normal_M[-1], may_break=may_break):
            self._on = False
            owner = self._locked.owner
            self._lost(TargetLost(f"tracker: the beam to the SMR of {owner} broke while it was followed: {why}"))
            return False
        if self._errors.saturated and self._rng.random() < self._errors.saturated:
            time_s = time_s[:0]
        if len(time_s):
            moving = float(np.ptp(true_M, axis=0).max()) > _STILL_M
            p_M, sigma_m = self._tracker.points(true_M[: len(time_s)], moving=moving)
            self._go(self._errors.own_time_s(time_s), p_M, sigma_m)
        return True

    def _broken(self, p_M: Vector, normal_M: Vector, *, may_break: bool) -> str:
        """Return why the beam is broken now; empty if it is not."""
        often = self._errors.lost_beams_per_min * self._packet_s / 60.0
        return self._tracker.hidden(self._locked, p_M, normal_M) or (
            "something crossed it" if may_break and self._rng.random() < often else ""
        )

    def _go(self, own_s: Vector, p_M: Vector, sigma_m: Vector) -> None:
        """Deliver points as a packet, delayed by the receiving computer's random delay."""
        late_s = self._rng.uniform(0.0, self._errors.packet_jitter_s)
        self._arrived_s = max(self._arrived_s, self._plant.clock_s + late_s)
        packet = Track(own_s, p_M, sigma_m, np.full(len(own_s), self._arrived_s))
        self._packets.append(packet)
        if late_s:
            self._plant.schedule.at(self._arrived_s, lambda: self._received(packet))
        else:
            self._received(packet)
