"""The tracker of the simulated cell: it sees what the plant lets it see, and has faults of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.plant.clearance import segment_distances
from drivers.plant.lines import carry, rigid
from drivers.plant.mechanism import Posture, nominal
from drivers.plant.optics import why_hidden
from drivers.trackers.protocol import (
    Face,
    Halted,
    Inclination,
    NotReady,
    Point,
    Preparation,
    TargetLost,
    TrackerIdentity,
    TrackerLinkLost,
    TwoFace,
    Unstable,
    WrongTarget,
)

Vector = NDArray[np.float64]

SEARCH_RADIUS_M = 0.1
"""How far from the expected point an SMR is still found."""
POINTING_S = 0.5
"""Turning the head and locking."""
FACE_CHANGE_S = 3.0
INITIALISE_S = 30.0
SETTLE_S = 0.1
"""An arm that has rested for less than this still shakes its SMR."""
INCLINATION_THRESHOLD_RAD = 15e-6
REFLECTORS = ("simulated 1.5 in",)

_WATCH_S = 0.02
_MOVED_M = 5e-6
_STANDARD_AIR = (20.0, 1013.25, 50.0)


@dataclass(frozen=True)
class Imperfections:
    """What is wrong with the tracker itself. As it stands here nothing is, beyond the noise of its specification.

    Attributes
    ----------
    warm_up_rad, warm_up_m : array (3,), float
        Rotation vector in M by which the head points wrong when it has just been switched on, and what it adds to
        every distance [rad, m]; both fade with the time constant ``warm_up_s``.
    laser_s : float
        How long after switching on the laser needs before anything can be measured [s].
    collimation_rad, index_rad : float
        Errors of azimuth and elevation that change sign with the face [rad]; the first grows towards the zenith.
    tilt_rad : tuple of two float
        How far the tracker leans, as its level tells [rad].
    weather_station : bool
        Whether it measures the air. Without, and without values given by ``prepare``, it corrects for standard air.
    pressure_hpa, humidity_percent : float
        The true air; its temperature is the plant's.
    clock_offset_s, clock_rate : float
        Its own clock against the plant's: ``offset + (1 + rate) t``.
    """

    warm_up_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    warm_up_m: float = 0.0
    warm_up_s: float = 2400.0
    laser_s: float = 0.0
    collimation_rad: float = 0.0
    index_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    weather_station: bool = True
    pressure_hpa: float = 1013.25
    humidity_percent: float = 50.0
    clock_offset_s: float = 0.0
    clock_rate: float = 0.0


@dataclass(frozen=True, eq=False)
class _Seen:
    """One SMR in the room: whose, where (3,) in M, why it cannot be seen ("" when it can)."""

    owner: str
    arm: str | None
    p_M: Vector
    hidden: str
    moving: bool = False


def refractivity(temperature_c: float, pressure_hpa: float, humidity_percent: float) -> float:
    """n - 1 of moist air at 633 nm: density of an ideal gas, and Edlen's term for water vapour.

    Within 0.3 ppm of Ciddor (1996) between 10 and 30 degC: 271.4e-6 at 20 degC, 1013.25 hPa, 50 %.
    """
    vapour_hpa = 0.01 * humidity_percent * 6.1078 * math.exp(17.27 * temperature_c / (temperature_c + 237.3))
    dry = 271.8e-6 * (pressure_hpa / 1013.25) * 293.15 / (273.15 + temperature_c)
    return dry - 3.63e-8 * vapour_hpa


class SimulatedTracker:
    """The tracker of a ``Plant``. It locks the visible SMR nearest to where it is told to look, whosever that is.

    An SMR is seen in the field of view, inside its acceptance angle and where no body of any arm crosses the beam.

    Attributes
    ----------
    obstacles : list of str
        Preconditions that are not met, in words; add some to make it refuse.
    covered : set of str
        Arms (or nests) whose SMR something hides.
    measured : int
        How many points it has made.
    """

    def __init__(
        self,
        plant: Plant,
        imperfections: Imperfections = Imperfections(),
        *,
        nests: Mapping[str, Vector] | None = None,
        wrong_target_m: float | None = None,
        switched_on_s: float = -math.inf,
        pass_time: Callable[[float], None] | None = None,
        watch_s: float = math.inf,
    ) -> None:
        """Stand in the cell of ``plant``.

        ``nests`` holds SMRs in fixed places, name -> (3,) [m] in M. A locked SMR farther than ``wrong_target_m`` from
        where it was expected is refused; by default that is left to who asks. ``switched_on_s`` is on the plant's
        clock. ``pass_time`` lets a duration [s] of the plant pass, by default ``plant.advance``; give one that waits
        where somebody else advances the plant, and ``watch_s``, how often to look at the target meanwhile.
        """
        self._plant = plant
        self._wrong = imperfections
        self._nests = {name: np.array(p, dtype=np.float64) for name, p in (nests or {}).items()}
        self._wrong_target_m = wrong_target_m
        self._switched_on_s = switched_on_s
        self._pass_time = plant.advance if pass_time is None else pass_time
        self._watch_s = watch_s
        self._bodies = {arm.name: nominal(arm) for arm in plant.config.arms}
        self._settings = Preparation()
        self._initialised = True
        self._tilt_drift_rad = 0.0
        self._halt = threading.Event()
        self._connected = False
        self._link_cut = False
        self._down_until_s = -math.inf
        self.obstacles: list[str] = []
        self.covered: set[str] = set()
        self.measured = 0

    # -- link ----------------------------------------------------------------------------------------------------------

    def _down(self) -> str:
        if self._link_cut:
            return "cut"
        if self._plant.clock_s < self._down_until_s:
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

    def identify(self) -> TrackerIdentity:
        """Who it is: a simulated tracker."""
        self._link()
        return TrackerIdentity(model="simulated tracker", serial="SIM-tracker", software="simulated")

    def prepare(self, settings: Preparation) -> None:
        """Initialise after a restart, which takes its time, and apply ``settings``."""
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
        """Every precondition that keeps it from measuring."""
        self._link()
        unmet = list(self.obstacles)
        if not self._initialised:
            unmet.append("it has not been initialised since it was switched on")
        left = self._switched_on_s + self._wrong.laser_s - self._plant.clock_s
        if left > 0.0:
            unmet.append(f"its laser is warming up, {left:.0f} s are left")
        return unmet

    # -- measuring -----------------------------------------------------------------------------------------------------

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Lock the visible SMR nearest to ``expected_M`` (3,) [m] and average it for ``averaging_s``.

        What it locks may be another arm's: unless ``wrong_target_m`` was given only who asked can tell, from the
        distance to the expected point. Raises ``TargetLost``, ``WrongTarget``, ``Unstable``, ``NotReady``, ``Halted``
        or ``TrackerLinkLost``.
        """
        expected = self._asked(expected_M, averaging_s)
        return self._measure(expected, averaging_s, 1)

    def measure_two_face(self, expected_M: Vector, averaging_s: float) -> TwoFace:
        """Measure in face 1, turn the head over, measure in face 2 and turn it back. Raises as ``measure``."""
        expected = self._asked(expected_M, averaging_s)
        first = self._measure(expected, averaging_s, 1)
        self._wait(FACE_CHANGE_S)
        second = self._measure(expected, averaging_s, 2)
        self._wait(FACE_CHANGE_S)
        return TwoFace(first, second)

    def _asked(self, expected_M: Vector, averaging_s: float) -> Vector:
        unmet = self.unmet()
        if unmet:
            raise NotReady(f"tracker: not ready to measure: {'; '.join(unmet)}")
        if not 0.0 < averaging_s < math.inf:
            raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
        expected = np.asarray(expected_M, dtype=np.float64)
        if expected.shape != (3,) or not np.isfinite(expected).all():
            raise ValueError("tracker: the expected point must be three finite coordinates in metres")
        self._halt.clear()
        return expected

    def _measure(self, expected: Vector, averaging_s: float, face: Face) -> Point:
        self._wait(POINTING_S)
        locked = self._lock(expected)
        rested_s = math.inf if locked.arm is None else self._plant.clock_s - self._plant.rest_s(locked.arm)
        if locked.moving or rested_s < SETTLE_S:
            self._unstable(locked)
        taken_s = self._plant.clock_s
        air = (self._plant.air_temperature_c, self._wrong.pressure_hpa, self._wrong.humidity_percent)
        read, covariance = self._plant.measure_positions(locked.p_M[None], averaging_s=averaging_s)
        applied, warnings = self._applied(air)
        p_M = self._as_it_reads(read[0], face, air, applied)
        self._average(locked, averaging_s)
        if self._wrong_target_m is not None and np.linalg.norm(p_M - expected) > self._wrong_target_m:
            off_mm = float(np.linalg.norm(p_M - expected)) * 1e3
            raise WrongTarget(f"tracker: it locked an SMR {off_mm:.0f} mm from where one was expected")
        self.measured += 1
        clock = self._wrong.clock_offset_s + (1.0 + self._wrong.clock_rate) * self._plant.clock_s
        return Point(
            p_M=p_M,
            covariance_M=covariance[0],
            time_s=taken_s + 0.5 * averaging_s,
            averaging_s=averaging_s,
            temperature_c=applied[0],
            pressure_hpa=applied[1],
            humidity_percent=applied[2],
            precision_M=np.sqrt(np.diag(covariance[0])),
            face=face,
            tracker_time_s=clock,
            host_time_s=self._plant.clock_s,
            reflector=self._settings.reflector or REFLECTORS[0],
            quality=warnings,
        )

    def _lock(self, expected: Vector) -> _Seen:
        around = []
        for target in self._targets():
            distance = float(np.linalg.norm(target.p_M - expected))
            if distance <= SEARCH_RADIUS_M:
                around.append((distance, target))
        visible = [(distance, target) for distance, target in around if not target.hidden]
        if not visible:
            place = ", ".join(f"{v:.3f}" for v in expected)
            causes = "".join(f"; that of {target.owner} is there, but {target.hidden}" for _, target in around)
            raise TargetLost(f"tracker: no SMR within {SEARCH_RADIUS_M * 1e3:.0f} mm of ({place}) m{causes}")
        return min(visible, key=lambda pair: pair[0])[1]

    def _targets(self) -> list[_Seen]:
        """Every SMR in the room."""
        found = []
        for target in self._plant.targets():
            why = "something covers it" if target.arm in self.covered else target.hidden
            why = why or self._in_the_beam(target.p_M, target.arm)
            found.append(_Seen(f"arm {target.arm}", target.arm, target.p_M, why, target.moving))
        for name, p_M in self._nests.items():
            facing = -p_M / np.linalg.norm(p_M)
            why = "something covers it" if name in self.covered else ""
            why = why or why_hidden(self._plant.config.tracker, p_M, facing, math.pi) or self._in_the_beam(p_M, None)
            found.append(_Seen(f"nest {name}", None, p_M, why))
        return found

    def _in_the_beam(self, p_M: Vector, owner: str | None) -> str:
        """Whose body stands between the tracker and ``p_M``, in words; "" where none does.

        What is fixed to the owner's flange holds the SMR: it always stands where the beam ends.
        """
        for name, mechanism in self._bodies.items():
            capsules = mechanism.capsules
            counted = capsules.frames < len(mechanism.masses) if name == owner else np.ones(len(capsules.frames), bool)
            if not counted.any():
                continue
            posture = Posture(mechanism, self._plant.q(name)[None], np.zeros(3))
            start, end = (carry(self._plant.true_T_M_B(name), ends[counted, 0]) for ends in posture.segments())
            gaps = segment_distances(np.zeros_like(start), np.broadcast_to(p_M, start.shape), start, end)
            if (gaps < capsules.radii[counted]).any():
                return f"{'its own arm' if name == owner else f'arm {name}'} stands in the beam"
        return ""

    # -- time ----------------------------------------------------------------------------------------------------------

    def _moving(self) -> bool:
        return any(self._plant.moving(name) for name in self._plant.names)

    def _wait(self, duration_s: float) -> None:
        """Let time pass in steps no longer than ``watch_s``. Raises ``Halted``."""
        end_s = self._plant.clock_s + duration_s
        left = duration_s
        while left > 0.0:
            self._pass_time(min(left, self._watch_s))
            if self._halt.is_set():
                self._link()  # a restart is no halt
                raise Halted("tracker: it was told to halt; there is no measurement")
            left = 0.0 if left <= self._watch_s else end_s - self._plant.clock_s

    def _average(self, locked: _Seen, averaging_s: float) -> None:
        """Let the averaging pass and watch the target while anything moves."""
        began_s = self._plant.clock_s
        left = averaging_s
        while left > 0.0:
            step = min(left, self._watch_s, _WATCH_S if self._moving() else math.inf)
            moved = self._moving()
            self._wait(step)
            moved = moved or any(self._plant.moving(n) or self._plant.rest_s(n) > began_s for n in self._plant.names)
            if moved:
                self._still_there(locked, began_s)
            left = 0.0 if left <= step else began_s + averaging_s - self._plant.clock_s

    def _still_there(self, locked: _Seen, began_s: float) -> None:
        now = next(target for target in self._targets() if target.owner == locked.owner)
        if now.hidden:
            raise TargetLost(f"tracker: the beam to the SMR of {locked.owner} broke in mid-measurement: {now.hidden}")
        own_motion = locked.arm is not None and self._plant.rest_s(locked.arm) > began_s
        if now.moving or own_motion or np.linalg.norm(now.p_M - locked.p_M) > _MOVED_M:
            self._unstable(locked)

    @staticmethod
    def _unstable(locked: _Seen) -> NoReturn:
        raise Unstable(f"tracker: the SMR of {locked.owner} moved while it was measured")

    # -- what it reads -------------------------------------------------------------------------------------------------

    def _applied(self, air: tuple[float, float, float]) -> tuple[tuple[float, float, float], tuple[str, ...]]:
        """Temperature, pressure and humidity that the refraction is corrected with, and warnings about them."""
        given = (self._settings.temperature_c, self._settings.pressure_hpa, self._settings.humidity_percent)
        source = air if self._wrong.weather_station else _STANDARD_AIR
        missing = not self._wrong.weather_station and None in given
        warnings = ("no weather station: refraction was corrected for standard air",) if missing else ()
        temperature, pressure, humidity = (s if g is None else g for g, s in zip(given, source, strict=True))
        return (temperature, pressure, humidity), warnings

    def _as_it_reads(
        self, p_M: Vector, face: Face, air: tuple[float, float, float], applied: tuple[float, float, float]
    ) -> Vector:
        """The point (3,) with the tracker's own errors on it; exactly ``p_M`` where it has none."""
        wrong = self._wrong
        since_s = self._plant.clock_s - self._switched_on_s
        cold = math.exp(-since_s / wrong.warm_up_s)
        if any(wrong.warm_up_rad) and cold > 0.0:
            p_M = carry(rigid(np.array([0.0, 0.0, 0.0, *wrong.warm_up_rad]) * cold), p_M)
        if wrong.collimation_rad or wrong.index_rad:
            sign = 1.0 if face == 1 else -1.0
            flat = math.hypot(p_M[0], p_M[1])
            distance = math.hypot(flat, p_M[2])
            azimuth = math.atan2(p_M[1], p_M[0]) + sign * wrong.collimation_rad * distance / flat
            elevation = math.atan2(p_M[2], flat) + sign * wrong.index_rad
            level = distance * math.cos(elevation)
            up = distance * math.sin(elevation)
            p_M = np.array([level * math.cos(azimuth), level * math.sin(azimuth), up])
        if applied != air:  # it divides the optical path by the index it believes in
            p_M = p_M * ((1.0 + refractivity(*air)) / (1.0 + refractivity(*applied)))
        if wrong.warm_up_m and cold > 0.0:
            distance = float(np.linalg.norm(p_M))
            p_M = p_M * ((distance + wrong.warm_up_m * cold) / distance)
        return p_M

    def inclination(self) -> Inclination:
        """The level: how far it leans, and how far it was bumped since."""
        self._link()
        return Inclination(self._wrong.tilt_rad, self._tilt_drift_rad, INCLINATION_THRESHOLD_RAD)

    def halt(self) -> None:
        """End what is under way, where time passes outside this tracker; harmless when nothing is."""
        self._halt.set()

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        self._connected = False

    # -- faults, for those who test what happens then ------------------------------------------------------------------

    def cut_link(self) -> None:
        """Let no call through until ``release`` and ``connect``."""
        self._link_cut = True
        self._connected = False

    def release(self) -> None:
        """Mend the link."""
        self._link_cut = False

    def reboot(self, down_s: float = 0.0) -> None:
        """Start anew: the link is down for a while of the plant's time; then it must be connected and prepared."""
        self._connected = False
        self._initialised = False
        self._settings = Preparation()
        self._down_until_s = self._plant.clock_s + down_s
        self._halt.set()

    def bump(self, angle_rad: float) -> None:
        """Knock against the stand: the level shows it."""
        self._tilt_drift_rad += angle_rad
