"""Opening the cell that a profile describes, and building the simulated cell for simulated devices.

Heartbeat of the job in an open cell: others can see its age, whatever the job is doing.

Call all arms of a cell concurrently: in real time, one slow arm does not delay the others.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.tracker_watch import TrackerMonitor, UnaskedTracker, Watch, unwatched
from cellapp.cell.safety.gate import Gate, refuse_motion
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Arm as ArmProfile
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from cellapp.ground.progress import Cancelled
from cellapp.robot.kinematics.transforms import rotation_zyx
from cellapp.robot.model.nominal import joint_rates, pose_matrix, published_rows
from drivers.arms.protocol import Arm, ArmError, JointLimits
from drivers.arms.settings import ArmContext
from drivers.clock import Clock, RealClock, SimulatedClock
from drivers.plant import ArmConfig, CapsuleConfig, Plant, PlantConfig, TrackerConfig, TrueErrors
from drivers.plant.sweep import SweepRecord, record_sweep, recorder_of
from drivers.sensors.protocol import AirSensor, SensorError
from drivers.settings import SettingError
from drivers.trackers.protocol import NotReady, Tracker, TrackerError
from drivers.trackers.settings import TrackerContext, TrackerSettings

Together = Callable[[Sequence[Callable[[], None]]], None]
"""Function that calls functions, concurrently if time is real."""
T = TypeVar("T")


def in_threads(calls: Sequence[Callable[[], None]]) -> None:
    """Call every function in a thread of its own and return at once: one that hangs does not delay the others."""
    without_thread = []
    for call in calls:
        try:
            threading.Thread(target=call, name="all arms", daemon=True).start()
        except RuntimeError:  # the system cannot start another thread
            without_thread.append(call)
    one_by_one(without_thread)


def one_by_one(calls: Sequence[Callable[[], None]]) -> None:
    """Call the functions one after the other: simulated time does not pass in the meantime."""
    for call in calls:
        call()


def answers_of_all(
    together: Together, calls: Mapping[str, Callable[[], T]]
) -> tuple[dict[str, T], dict[str, ArmError]]:
    """Call a function for each arm and wait for all; return answers and errors by arm.

    This terminates: every call of a driver has a timeout.
    """
    answers: dict[str, T] = {}
    errors = {name: ArmError(f"arm {name}: its driver gave no answer") for name in calls}
    answered = {name: threading.Event() for name in calls}

    def ask(name: str) -> None:
        try:
            answers[name] = calls[name]()
            del errors[name]
        except ArmError as error:
            errors[name] = error
        finally:
            answered[name].set()

    together([partial(ask, name) for name in calls])
    for one in answered.values():
        one.wait()
    return answers, errors


class JobPulse:
    """Time of the last sign of life of the job's thread, which writes it; any thread can read it without waiting."""

    def __init__(self) -> None:
        self._beat_s = time.monotonic()
        self._waits_for: Callable[[], float] | None = None

    def beat(self) -> None:
        """Record a sign of life."""
        self._beat_s = time.monotonic()

    @contextmanager
    def waiting(self, age_s: Callable[[], float] = lambda: 0.0) -> Iterator[None]:
        """While this context is open, count the job as alive as its device: ``age_s`` returns the data's age [s].

        By default that is 0: the job waits on purpose, and its own waiting is not silence.
        """
        self.beat()
        self._waits_for = age_s
        try:
            yield
        finally:
            self._waits_for = None
            self.beat()

    def age_s(self) -> float:
        """Return the age of the newest sign of life [s]."""
        waits_for, own_s = self._waits_for, time.monotonic() - self._beat_s
        return own_s if waits_for is None else min(own_s, waits_for())


RecordSweep = Callable[[str, NDArray[np.float64], float, Mapping[str, NDArray[np.float64]]], SweepRecord]
"""Function of an arm, joint positions (n, N) [rad], their period [s], and the positions of arms that move with it; it
returns what the devices recorded."""


@dataclass(frozen=True)
class Cell:
    """An open cell: connected devices and their common clock.

    ``air`` is None without a weather station. ``together`` calls functions of several devices concurrently;
    ``watch_tracker`` watches the tracker while the arms move.
    ``gate`` checks every motion; a trial that drives the same plan many times can pass one that caches its answers.
    ``tracker_unmet`` lists what kept the tracker from measuring when the cell was opened. ``pulse`` is the job's
    heartbeat. ``plant`` is the simulated cell; None in a real one. ``record_sweep`` lets an arm follow
    joint positions and records it; None in a real cell. ``logs`` are called with the level and the text of what a
    person should read later.
    """

    arms: Mapping[str, Arm]
    tracker: Tracker
    clock: Clock
    watch_tracker: Watch
    air: AirSensor | None = None
    together: Together = in_threads
    gate: Gate = refuse_motion
    tracker_unmet: tuple[str, ...] = ()
    pulse: JobPulse = field(default_factory=JobPulse)
    plant: Plant | None = None
    record_sweep: RecordSweep | None = None
    logs: list[Callable[[str, str], None]] = field(default_factory=list)

    def oldest_data_s(self) -> float:
        """Return the largest age [s] of the newest states of the arms; never block."""
        return max(arm.live().age_s for arm in self.arms.values())

    def require_tracker(self) -> None:
        """Raise ``HardwareError`` if the tracker was not ready to measure when the cell was opened."""
        if self.tracker_unmet:
            raise HardwareError(f"tracker: not ready: {'; '.join(self.tracker_unmet)}")


@contextmanager
def open_cell(profile: Profile, *, plant: Plant | None = None, control: JobControl | None = None) -> Iterator[Cell]:
    """Connect to all devices of a profile; disconnect them at the end, whatever happens.

    ``plant`` is a simulated cell in the state where an earlier job left it; if None, the profile's plant is built. A
    person's stop, through ``control``, also ends the connecting: no program is started on a controller after it.

    Raises
    ------
    InputError
        If a setting does not fit its device.
    HardwareError
        If a device cannot be reached or is not ready.
    Stopped, Aborted
        If a person stopped the job while it connected; nothing has moved.
    """
    control = control or JobControl()
    if plant is None and _needs_plant(profile):
        plant = build_plant(profile)
    arms = {name: _driver_of(name, arm, plant, user=control.run) for name, arm in profile.arms.items()}
    tracker = tracker_driver(profile, plant)
    air = _air_sensor(profile, plant)
    simulated = None if _has_real_arm(profile) else plant
    together = in_threads if simulated is None else one_by_one
    with ExitStack() as stack:
        stack.push(partial(_disconnect_all, arms, together))
        _connect_all(arms, together, control)
        stack.callback(tracker.disconnect)
        unmet = start_tracker(tracker, profile.tracker.driver)
        if air is not None:
            stack.callback(air.disconnect)
            try:
                air.connect()
            except SensorError as error:
                raise HardwareError(str(error)) from error
        control.check()
        if simulated is None:
            monitor = stack.enter_context(TrackerMonitor(tracker))
            yield Cell(arms, monitor, RealClock(), monitor.watching, air, tracker_unmet=unmet)
        else:
            yield Cell(
                arms,
                tracker,
                SimulatedClock(simulated),
                partial(unwatched, tracker),
                air,
                together,
                tracker_unmet=unmet,
                plant=simulated,
                record_sweep=partial(record_sweep, simulated, recorder_of(simulated)),
            )


@contextmanager
def open_arms(profile: Profile, control: JobControl, *, simulation: bool) -> Iterator[Cell]:
    """Connect to the arms of a profile only; disconnect them at the end. The tracker is never queried.

    If ``simulation``, every controller must be in its simulation mode. Raise as ``open_cell``.
    """
    arms = {
        name: _driver_of(name, arm, None, simulation=simulation, user=control.run) for name, arm in profile.arms.items()
    }
    with ExitStack() as stack:
        stack.push(partial(_disconnect_all, arms, in_threads))
        _connect_all(arms, in_threads, control)
        tracker = UnaskedTracker()
        yield Cell(arms, tracker, RealClock(), partial(unwatched, tracker))


def _needs_plant(profile: Profile) -> bool:
    """Return whether a device is simulated in this process ('plant' may also describe what 'emulate' simulates)."""
    air = profile.sensors.air
    return (
        profile.tracker.driver.needs_plant
        or any(arm.driver.needs_plant for arm in profile.arms.values())
        or (air is not None and air.needs_plant)
    )


def _has_real_arm(profile: Profile) -> bool:
    """Return whether an arm moves in real time: then the cell's clock is real, whatever else is simulated."""
    return any(arm.driver.has_device and not arm.driver.needs_plant for arm in profile.arms.values())


def _connect_all(arms: Mapping[str, Arm], together: Together, control: JobControl) -> None:
    """Connect all arms concurrently; a person's stop in the meantime ends that."""

    def brake_all(verb: str) -> None:
        for arm in arms.values():
            arm.refuse_motion()

    with control.brakes(brake_all, holds=False):
        control.check()
        _, errors = answers_of_all(together, {name: arm.connect for name, arm in arms.items()})
    control.check()
    for error in errors.values():
        raise HardwareError(str(error)) from error


def _disconnect_all(arms: Mapping[str, Arm], together: Together, kind: object, error: object, trace: object) -> None:
    """Disconnect all arms. What one could not leave as it was is said after a person's stop; else ``error`` is."""
    _, errors = answers_of_all(together, {name: arm.disconnect for name, arm in arms.items()})
    if errors and isinstance(error, Cancelled):
        raise HardwareError("; ".join(map(str, (error, *errors.values())))) from error


def start_tracker(tracker: Tracker, settings: TrackerSettings) -> tuple[str, ...]:
    """Connect and prepare the tracker; return as sentences what keeps it from measuring.

    Raises
    ------
    InputError
        If a setting is one that this tracker does not have.
    HardwareError
        If it cannot be reached.
    """
    try:
        tracker.connect()
        preparation = settings.preparation()
        if preparation is not None:
            tracker.prepare(preparation)
        return tuple(tracker.unmet())
    except NotReady as error:
        return (str(error),)
    except TrackerError as error:
        raise HardwareError(str(error)) from error
    except ValueError as error:  # a setting that this tracker does not have
        raise InputError(str(error)) from error


# -- drivers ----------------------------------------------------------------------------------------------------------


def arm_context(
    name: str, arm: ArmProfile, plant: Plant | None = None, *, simulation: bool = False, user: str = ""
) -> ArmContext:
    """Return what the profile specifies for an arm's driver; if ``simulation``, the controller moves no arm.

    ``user`` is the run for which the arm is driven.
    """
    speed, acceleration = joint_rates(arm)
    return ArmContext(
        name=name,
        model=arm.type.model,
        joints=len(arm.type.joints),
        limits=JointLimits(position=np.array(arm.joint_limits), speed=speed, acceleration=acceleration),
        payload_kg=arm.payload.mass,
        payload_center_m=np.array(arm.payload.center_of_mass),
        plant=plant,
        simulation=simulation,
        user=user,
    )


def tracker_context(profile: Profile, plant: Plant | None = None) -> TrackerContext:
    """Return what the profile specifies for the tracker's driver."""
    tracker = profile.tracker
    return TrackerContext(
        transverse=(tracker.transverse.constant, tracker.transverse.proportional),
        range=(tracker.range.constant, tracker.range.proportional),
        plant=plant,
    )


def tracker_driver(profile: Profile, plant: Plant | None) -> Tracker:
    """Return the driver of the profile's tracker, not connected yet. Raise ``InputError`` on a wrong setting."""
    try:
        return profile.tracker.driver.open(tracker_context(profile, plant))
    except SettingError as error:
        raise InputError(f"tracker.{error}") from error


def require_devices(profile: Profile) -> None:
    """Raise ``InputError`` if an arm, or the tracker, has no device."""
    if not profile.tracker.driver.has_device:
        tracker_driver(profile, None)
    for name, arm in profile.arms.items():
        if not arm.driver.has_device:
            _driver_of(name, arm, None)


def _driver_of(name: str, arm: ArmProfile, plant: Plant | None, *, simulation: bool = False, user: str = "") -> Arm:
    try:
        return arm.driver.open(arm_context(name, arm, plant, simulation=simulation, user=user))
    except SettingError as error:
        raise InputError(f"arms.{name}.{error}") from error


def _air_sensor(profile: Profile, plant: Plant | None) -> AirSensor | None:
    settings = profile.sensors.air
    try:
        return None if settings is None else settings.open(plant)
    except SettingError as error:
        raise InputError(f"sensors.air.{error}") from error


# -- the simulated cell -----------------------------------------------------------------------------------------------


def build_plant(profile: Profile, *, watch_clearance: bool = False) -> Plant:
    """Return the simulated cell that a profile describes; ``watch_clearance`` observes distances, which takes time.

    Raise ``InputError`` on an unknown effect or parameter.
    """
    settings = profile.plant
    tracker = profile.tracker
    if settings is None or tracker.pose is None:
        raise InputError(f"profile {profile.name}: a simulated cell needs the sections 'plant' and 'tracker.pose'")
    accuracy = tracker_context(profile)
    try:
        config = PlantConfig(
            seed=settings.seed,
            arms=tuple(plant_arm(name, arm, settings.effects.get(name, {})) for name, arm in profile.arms.items()),
            tracker=TrackerConfig(
                T_C_M=pose_matrix(settings.tracker_pose or tracker.pose),
                transverse=accuracy.transverse,
                range=accuracy.range,
                azimuth=tracker.azimuth,
                elevation=tracker.elevation,
                distance=tracker.distance,
                averaging_s=tracker.averaging,
            ),
            errors=TrueErrors(**settings.geometry.model_dump()),
            repeatability=settings.repeatability,
            temperature_c=settings.temperature,
            noise=settings.noise,
            earlier_jobs=settings.earlier_jobs,
            floor=profile.plan.floor,
            factory=None if settings.factory is None else TrueErrors(**settings.factory.model_dump()),
        )
        return Plant(config, watch_clearance=watch_clearance)
    except ValueError as error:
        raise InputError(f"profile {profile.name}: plant: {error}") from error


def plant_arm(name: str, arm: ArmProfile, effects: Mapping[str, Mapping[str, object]]) -> ArmConfig:
    """Return an arm of the simulated cell; ``effects`` maps hidden effects to parameters. Raise ``InputError``."""
    if arm.base is None or arm.smr.offset == "unknown":
        raise InputError(f"arms.{name}: a simulated arm needs 'base' and a known 'smr.offset'")
    joints = arm.type.joints
    return ArmConfig(
        name=name,
        rows=published_rows(arm),
        limits=np.array(arm.joint_limits),
        speed=np.array([joint.speed for joint in joints]),
        acceleration=np.array([joint.acceleration for joint in joints]),
        T_C_B=pose_matrix(arm.base),
        smr_offset=np.array(arm.smr.offset),
        smr_normal=np.array(arm.smr.normal) / math.hypot(*arm.smr.normal),
        smr_acceptance=arm.smr.acceptance,
        masses=np.array([joint.mass for joint in joints]),
        centers_of_mass=np.array([joint.center_of_mass for joint in joints]),
        payload_mass=arm.payload.mass,
        payload_center=np.array(arm.payload.center_of_mass),
        capsules=tuple(
            CapsuleConfig(capsule.frame, np.array(capsule.start), np.array(capsule.end), capsule.radius)
            for capsule in arm.type.capsules
        ),
        effects=effects,
        home=None if arm.home is None else np.array(arm.home),
        **_probe(name, arm.smr),
    )


def _probe(name: str, smr: Smr) -> dict[str, Any]:
    """Return the probe of an arm of the simulated cell. Raise ``InputError``."""
    if smr.probe is None:
        return {}
    if smr.probe.rpy == "unknown":
        raise InputError(f"arms.{name}.smr.probe: a simulated arm needs a known 'rpy' of its probe")
    roll, pitch, yaw = smr.probe.rpy
    return {"probe": rotation_zyx(yaw, pitch, roll), "probe_sigma": smr.probe.sigma}
