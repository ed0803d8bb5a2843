"""Opening the cell that a profile names: the one place where drivers are chosen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np

from cellapp.collection.token import read_token
from cellapp.errors import HardwareError, InputError
from cellapp.model.nominal import pose_matrix
from cellapp.profile import Arm as ArmProfile
from cellapp.profile import (
    BridgeTrackerDriver,
    LmfTrackerDriver,
    Profile,
    SerialSensor,
    SimulatedSensor,
    UrArmDriver,
)
from drivers.arms.protocol import Arm, ArmError, JointLimits
from drivers.arms.simulated import SimulatedArm
from drivers.arms.ur import UrArm, UrSettings
from drivers.arms.ur_checks import JOINTS as UR_JOINTS
from drivers.arms.ur_checks import UrExpectation
from drivers.plant import ArmConfig, CapsuleConfig, GeometryErrors, Plant, PlantConfig, TrackerConfig
from drivers.sensors.protocol import AirSensor, SensorError
from drivers.sensors.serial_station import PRESETS, LineFormat, SerialStation
from drivers.sensors.simulated import SimulatedAirSensor
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.lmf import ErrorLaw, LmfSettings, LmfTracker
from drivers.trackers.protocol import Preparation, Tracker, TrackerError
from drivers.trackers.simulated import SimulatedTracker

ArmOpener = Callable[[str, ArmProfile, Plant | None], Arm]
TrackerOpener = Callable[[Profile, Plant | None], Tracker]
SensorOpener = Callable[[str, SimulatedSensor | SerialSensor, Plant | None], AirSensor]


@dataclass(frozen=True)
class Cell:
    """An open cell: connected arms by name, the tracker, and the weather station where there is one.

    ``plant`` is there in simulation only.
    """

    arms: Mapping[str, Arm]
    tracker: Tracker
    plant: Plant | None
    air: AirSensor | None = None


def _simulated_arm(name: str, arm: ArmProfile, plant: Plant | None) -> Arm:
    if plant is None:
        raise InputError(f"arm {name}: a simulated driver needs the profile's section 'plant'")
    return SimulatedArm(plant, name)


def _simulated_tracker(profile: Profile, plant: Plant | None) -> Tracker:
    if plant is None:
        raise InputError("tracker: a simulated driver needs the profile's section 'plant'")
    return SimulatedTracker(plant)


def _ur_arm(name: str, arm: ArmProfile, plant: Plant | None) -> Arm:
    driver = arm.driver
    if not isinstance(driver, UrArmDriver):
        raise InputError(f"arms.{name}.driver: expected the settings of a UR controller, got those of {driver.kind}")
    settings = UrSettings(
        timeout_s=driver.timeout,
        startup_s=driver.startup_timeout,
        watchdog_hz=driver.watchdog_hz,
        settle_s=driver.settle_time,
        settle_speed=driver.settle_speed,
        settle_position=driver.settle_window,
    )
    return UrArm(name, driver.host, ur_expectation(name, arm, driver), settings)


def ur_expectation(name: str, arm: ArmProfile, driver: UrArmDriver) -> UrExpectation:
    """What a profile says of an arm, as the UR driver and ``doctor`` compare it with its controller.

    Raises
    ------
    InputError
        If the arm's type has not six joints.
    """
    joints = arm.type.joints
    if len(joints) != UR_JOINTS:
        raise InputError(f"arms.{name}.type: {arm.type.model} has {len(joints)} joints, a UR arm has {UR_JOINTS}")
    return UrExpectation(
        model=arm.type.model,
        serial=driver.serial,
        checksum=driver.checksum,
        limits=JointLimits(
            position=np.array(arm.limits or tuple(joint.limit for joint in joints)),
            speed=np.array([joint.speed for joint in joints]) * arm.speed_scale,
            acceleration=np.array([joint.acceleration for joint in joints]) * arm.speed_scale,
        ),
        payload_kg=arm.payload.mass,
        payload_center_m=np.array(arm.payload.center_of_mass),
        tcp=None if driver.tcp is None else np.array(driver.tcp),
        payload_slack_kg=driver.payload_tolerance,
        payload_slack_m=driver.payload_center_tolerance,
    )


def _lmf_tracker(profile: Profile, plant: Plant | None) -> Tracker:
    return lmf_tracker(profile)


def lmf_tracker(profile: Profile) -> LmfTracker:
    """The tracker of a profile whose driver is LMF, not connected yet. Raises ``InputError`` on a bad setting."""
    tracker, driver = profile.tracker, profile.tracker.driver
    if not isinstance(driver, LmfTrackerDriver):
        raise InputError(f"tracker.driver: expected the settings of LMF, got those of {driver.kind}")
    law = ErrorLaw(
        transverse=(tracker.transverse.constant, tracker.transverse.proportional),
        range=(tracker.range.constant, tracker.range.proportional),
    )
    try:
        settings = LmfSettings(
            address=driver.address,
            serial=driver.serial or "",
            library=driver.library,
            stationary=driver.stationary,
            power_lock=driver.power_lock,
            search_radius_m=driver.search_radius,
            wrong_target_m=driver.wrong_target,
            shaking_m=driver.shaking,
            gravity=driver.gravity,
            command_s=driver.timeout,
            law=law,
            target_words=tuple(word.casefold() for word in driver.target_words),
            lost_numbers=driver.lost_numbers,
        )
    except ValueError as error:
        raise InputError(f"tracker.driver.{error}") from error
    return LmfTracker(settings, lmf_preparation(driver))


def lmf_preparation(driver: LmfTrackerDriver) -> Preparation:
    """How a profile wants an LMF tracker set up."""
    air = driver.air
    if air is None:
        return Preparation(reflector=driver.reflector, accuracy=driver.accuracy)
    return Preparation(driver.reflector, driver.accuracy, air.temperature, air.pressure_hpa, air.humidity_percent)


def _no_arm(name: str, arm: ArmProfile, plant: Plant | None) -> Arm:
    raise InputError(f"arm {name}: its driver is 'none': readings of this profile come from 'cellapp import'")


def _no_tracker(profile: Profile, plant: Plant | None) -> Tracker:
    raise InputError("tracker: its driver is 'none': readings of this profile come from 'cellapp import'")


def _bridge_tracker(profile: Profile, plant: Plant | None) -> Tracker:
    driver = profile.tracker.driver
    assert isinstance(driver, BridgeTrackerDriver)
    return BridgeTracker(
        driver.url,
        token=read_token(driver.token_file, driver.token_env),
        timeout_s=driver.timeout,
        baud=driver.baud,
        preparation=Preparation(reflector=driver.reflector, accuracy=driver.accuracy),
    )


def _simulated_sensor(name: str, sensor: SimulatedSensor | SerialSensor, plant: Plant | None) -> AirSensor:
    if plant is None:
        raise InputError(f"sensors.{name}: a simulated station needs the profile's section 'plant'")
    return SimulatedAirSensor(plant)


def _serial_sensor(name: str, sensor: SimulatedSensor | SerialSensor, plant: Plant | None) -> AirSensor:
    if not isinstance(sensor, SerialSensor):
        raise InputError(f"sensors.{name}: expected the settings of a serial station, got those of {sensor.kind}")
    layout = PRESETS[sensor.format] if sensor.format else LineFormat(sensor.pattern or "")
    layout = replace(layout, units=sensor.units.model_dump())
    if sensor.poll is not None:
        layout = replace(layout, poll=sensor.poll.encode())
    return SerialStation(
        sensor.url,
        layout,
        baud=sensor.baud,
        framing=sensor.framing,
        max_age_s=sensor.max_age,
        poll_every_s=sensor.poll_interval,
        timeout_s=sensor.timeout,
    )


ARM_DRIVERS: Mapping[str, ArmOpener] = {"simulated": _simulated_arm, "ur": _ur_arm, "none": _no_arm}
TRACKER_DRIVERS: Mapping[str, TrackerOpener] = {
    "simulated": _simulated_tracker,
    "lmf": _lmf_tracker,
    "bridge": _bridge_tracker,
    "none": _no_tracker,
}
SENSOR_DRIVERS: Mapping[str, SensorOpener] = {"simulated": _simulated_sensor, "serial": _serial_sensor}


def air_sensor(profile: Profile, plant: Plant | None) -> AirSensor | None:
    """The weather station that the profile names, not connected yet; None where it names none."""
    sensor = profile.sensors.air
    return None if sensor is None else SENSOR_DRIVERS[sensor.kind]("air", sensor, plant)


@contextmanager
def open_cell(profile: Profile, *, watch_clearance: bool = False) -> Iterator[Cell]:
    """Connect to all devices of a profile; they are disconnected at the end, whatever happens.

    ``watch_clearance`` lets a simulated cell record how near its arms came to one another, at some cost in time.

    Raises
    ------
    HardwareError
        If a device cannot be reached or is not ready.
    """
    kinds: set[str] = {profile.tracker.driver.kind, *(arm.driver.kind for arm in profile.arms.values())}
    if profile.sensors.air is not None:
        kinds.add(profile.sensors.air.kind)
    # a section 'plant' may also describe a cell that 'cellapp emulate' simulates in another process
    plant = build_plant(profile, watch_clearance=watch_clearance) if "simulated" in kinds else None
    arms = {name: ARM_DRIVERS[arm.driver.kind](name, arm, plant) for name, arm in profile.arms.items()}
    tracker = TRACKER_DRIVERS[profile.tracker.driver.kind](profile, plant)
    air = air_sensor(profile, plant)
    with ExitStack() as stack:
        for arm in arms.values():
            stack.callback(_let_go, arm)
            try:
                arm.connect()
            except ArmError as error:
                raise HardwareError(str(error)) from error
        try:
            tracker.connect()
            stack.callback(tracker.disconnect)
            if isinstance(profile.tracker.driver, LmfTrackerDriver):  # its connect does not move the head
                tracker.prepare(lmf_preparation(profile.tracker.driver))
            unmet = tracker.unmet()
        except TrackerError as error:
            raise HardwareError(str(error)) from error
        except ValueError as error:  # a setting that this tracker does not have
            raise InputError(str(error)) from error
        if unmet:
            raise HardwareError(f"tracker: not ready: {'; '.join(unmet)}")
        if air is not None:
            stack.callback(air.disconnect)
            try:
                air.connect()
            except SensorError as error:
                raise HardwareError(str(error)) from error
        yield Cell(arms, tracker, plant, air)


def _let_go(arm: Arm) -> None:
    with suppress(ArmError):  # the other devices are let go of too, and what went wrong before is what is told
        arm.disconnect()


def build_plant(profile: Profile, *, watch_clearance: bool = False) -> Plant:
    """The simulated cell that a profile describes. Raises ``InputError`` on an unknown effect or parameter."""
    settings = profile.plant
    tracker = profile.tracker
    if settings is None or tracker.pose is None:
        raise InputError(f"profile {profile.name}: a simulated cell needs the sections 'plant' and 'tracker.pose'")
    try:
        config = PlantConfig(
            seed=settings.seed,
            arms=tuple(plant_arm(name, arm, settings.effects.get(name, {})) for name, arm in profile.arms.items()),
            tracker=TrackerConfig(
                T_C_M=pose_matrix(tracker.pose),
                transverse=(tracker.transverse.constant, tracker.transverse.proportional),
                range=(tracker.range.constant, tracker.range.proportional),
                azimuth=tracker.azimuth,
                elevation=tracker.elevation,
                distance=tracker.distance,
                averaging_s=tracker.averaging,
            ),
            errors=GeometryErrors(
                length=settings.geometry.length,
                angle=settings.geometry.angle,
                base_length=settings.geometry.base_length,
                base_angle=settings.geometry.base_angle,
                smr=settings.geometry.smr,
                mass=settings.geometry.mass,
            ),
            repeatability=settings.repeatability,
            temperature_c=settings.temperature,
            noise=settings.noise,
            floor=profile.plan.floor,
        )
        return Plant(config, watch_clearance=watch_clearance)
    except ValueError as error:
        raise InputError(f"profile {profile.name}: plant: {error}") from error


def plant_arm(name: str, arm: ArmProfile, effects: Mapping[str, Mapping[str, object]]) -> ArmConfig:
    if arm.base is None or arm.smr.offset == "unknown":
        raise InputError(f"arms.{name}: a simulated arm needs 'base' and a known 'smr.offset'")
    joints = arm.type.joints
    limits = arm.limits or tuple(joint.limit for joint in joints)
    return ArmConfig(
        name=name,
        rows=np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in joints]),
        limits=np.array(limits),
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
    )
