"""The verb: stand in for the UR controllers of a profile and move its simulated cell, for any client to try."""

from __future__ import annotations

import ipaddress
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

from cellapp.collection.cell import build_plant
from cellapp.collection.token import read_token
from cellapp.errors import HardwareError, InputError
from cellapp.profile import Arm, Profile
from cellapp.progress import CancelToken
from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.emulators.ur_controller import (
    STANDARD_PORTS,
    Addresses,
    ControllerConfig,
    Personality,
    UrControllerServer,
)
from drivers.plant import Plant

_STEP_S = 0.2
_CB3_MODELS = ("UR3", "UR5", "UR10")


@dataclass(frozen=True)
class EmulatedArm:
    """Which arm is stood in for, by which controller, and where that listens.

    ``control_port`` on 127.0.0.1 takes faults and the operator's actions on command; see
    ``drivers/emulators/ur_controller/control.py``.
    """

    arm: str
    controller: Personality
    host: str
    dashboard_port: int = STANDARD_PORTS["dashboard"]
    primary_port: int = STANDARD_PORTS["primary"]
    script_port: int = STANDARD_PORTS["script"]
    rtde_port: int = STANDARD_PORTS["rtde"]
    control_port: int = 0

    def __str__(self) -> str:
        return (
            f"arm {self.arm}: {self.controller.model} ({self.controller.series}), serial {self.controller.serial},"
            f" at {self.host}: dashboard {self.dashboard_port}, primary {self.primary_port}, script"
            f" {self.script_port}, RTDE {self.rtde_port}; faults on command at 127.0.0.1:{self.control_port}"
        )


@dataclass(frozen=True)
class EmulatedTracker:
    """Where the tracker of the simulated cell is served over the bridge protocol."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tracker: simulated, bridge protocol at {self.host} port {self.port}"


def emulated_tracker(profile: Profile) -> EmulatedTracker | None:
    """The stand-in for a tracker of kind ``bridge`` with a loopback ``socket://`` URL; None for any other."""
    driver = profile.tracker.driver
    if profile.plant is None or driver.kind != "bridge" or not driver.url.startswith("socket://"):
        return None
    host, _, port = driver.url.removeprefix("socket://").rpartition(":")
    loopback = _loopback(host)
    return None if loopback is None else EmulatedTracker(loopback, int(port))


def _serve_tracker(
    stack: ExitStack, profile: Profile, plant: Plant, server: UrControllerServer, tracker: EmulatedTracker
) -> EmulatedTracker:
    """Have the tracker look at what the controllers move; it waits for their clock and touches nothing without lock."""
    driver = profile.tracker.driver
    token = read_token(driver.token_file, driver.token_env) if driver.kind == "bridge" else None
    bridge = TrackerBridgeEmulator(
        plant, clock=threading.Condition(server.cell.lock), host=tracker.host, port=tracker.port, token=token
    )
    try:
        stack.enter_context(bridge)
    except OSError as error:
        raise HardwareError(f"tracker: {error.strerror}; see whether another bridge runs here") from error
    assert bridge.port is not None
    return EmulatedTracker(bridge.host, bridge.port)


def emulated_arms(profile: Profile) -> list[EmulatedArm]:
    """The stand-ins that a profile asks for, on the standard ports.

    An arm of kind ``ur`` is stood in for where its host is a loopback address, a simulated one on 127.0.0.2, 127.0.0.3
    and so on; the others are left to their own controllers.

    Raises
    ------
    InputError
        If there is nothing to stand in for, two arms share an address, or an arm is not a UR with six joints.
    """
    hosts: dict[str, str] = {}
    for name, arm in profile.arms.items():
        if arm.driver.kind == "ur":
            host = _loopback(arm.driver.host)
            if host is not None and host in hosts.values():
                raise InputError(f"arms.{name}.driver.host: {host} is another arm's; give each its own, as 127.0.0.2")
            if host is not None:
                hosts[name] = host
    free = (f"127.0.0.{number}" for number in range(2, 255) if f"127.0.0.{number}" not in hosts.values())
    simulated = [name for name, arm in profile.arms.items() if arm.driver.kind == "simulated"]
    hosts |= dict(zip(simulated, free, strict=False))
    if not hosts:
        raise InputError(
            f"profile {profile.name}: nothing to stand in for; needed is an arm whose driver is 'simulated', or 'ur'"
            " with a loopback address such as 127.0.0.2 for its host"
        )
    return [
        EmulatedArm(name, _controller(name, arm, number), hosts[name])
        for number, (name, arm) in enumerate(profile.arms.items(), start=1)
        if name in hosts
    ]


def emulate(
    profile: Profile,
    cancel: CancelToken,
    announce: Callable[[Sequence[EmulatedArm]], None],
    arms: Sequence[EmulatedArm] | None = None,
    pace: float = 1.0,
    tracker: EmulatedTracker | None = None,
    announce_tracker: Callable[[EmulatedTracker], None] = lambda _: None,
) -> None:
    """Stand in for the controllers of a profile until ``cancel``; all ports are free again when this returns.

    The arms move the simulated cell where the profile has a section ``plant``; elsewhere joints alone.

    ``announce`` is called once, when all listen, with the addresses. ``arms`` replaces what ``emulated_arms`` would
    choose; a port 0 in it takes a free one. ``tracker`` and ``announce_tracker``, which is called first, likewise for
    the tracker, which looks at the same cell. ``pace`` is how many seconds pass in the cell for each second of
    wall time.

    Raises
    ------
    InputError
        As ``emulated_arms``, and if ``pace`` is not between 0 and 1000.
    HardwareError
        If a port is in use or an address cannot be had, or the simulated cell fails on the way.
    """
    chosen = emulated_arms(profile) if arms is None else arms
    seen_by = emulated_tracker(profile) if tracker is None else tracker
    plant = None if profile.plant is None else build_plant(profile)
    controllers = [_config(arm, profile.arms[arm.arm]) for arm in chosen]
    try:
        server = UrControllerServer(controllers, plant, pace)
    except ValueError as error:
        raise InputError(f"profile {profile.name}: {error}") from error
    with ExitStack() as stack:
        try:
            stack.enter_context(server)
        except OSError as error:
            raise HardwareError(
                f"{error.strerror}; see whether another emulator or simulator runs here. On macOS,"
                " addresses other than 127.0.0.1 must be added first: ifconfig lo0 alias 127.0.0.2"
            ) from error
        if seen_by is not None and plant is not None:
            announce_tracker(_serve_tracker(stack, profile, plant, server, seen_by))
        announce([_listening(arm, server.addresses) for arm in chosen])
        while not cancel.wait(_STEP_S):  # in steps, so that Ctrl-C is heard
            if server.failure is not None:
                why = f"{type(server.failure).__name__}: {server.failure}"
                raise HardwareError(f"the emulated cell cannot go on ({why}); its ports are closed") from server.failure


def _listening(arm: EmulatedArm, addresses: Addresses) -> EmulatedArm:
    ports = {name: number for name, (_, number) in addresses.arms[arm.arm].items()}
    return replace(
        arm,
        dashboard_port=ports["dashboard"],
        primary_port=ports["primary"],
        script_port=ports["script"],
        rtde_port=ports["rtde"],
        control_port=addresses.control[1],
    )


def _config(emulated: EmulatedArm, arm: Arm) -> ControllerConfig:
    joints = arm.type.joints
    limits = tuple((joint.limit[0], joint.limit[1]) for joint in joints)
    home = arm.home or tuple(min(max(0.0, low), high) for low, high in limits)
    return ControllerConfig(
        name=emulated.arm,
        host=emulated.host,
        personality=emulated.controller,
        ports={
            "dashboard": emulated.dashboard_port,
            "primary": emulated.primary_port,
            "script": emulated.script_port,
            "rtde": emulated.rtde_port,
        },
        limits=limits,
        speed=tuple(joint.speed for joint in joints),
        acceleration=tuple(joint.acceleration for joint in joints),
        home=home,
        payload_mass=arm.payload.mass,
        payload_center=arm.payload.center_of_mass,
    )


def _loopback(host: str) -> str | None:
    """The address of a host that is this machine, else None."""
    if host == "localhost":
        return "127.0.0.1"
    try:
        return host if ipaddress.IPv4Address(host).is_loopback else None
    except ValueError:
        return None


def _controller(name: str, arm: Arm, number: int) -> Personality:
    model = arm.type.model.strip()
    joints = arm.type.joints
    if not model.upper().startswith("UR") or len(joints) != 6:
        raise InputError(f"arms.{name}.type: '{model}' with {len(joints)} joints is no UR; only those are stood in for")
    serial = arm.driver.serial if arm.driver.kind == "ur" else None
    return Personality(
        series="CB3" if model.upper() in _CB3_MODELS else "e-Series",
        model=model.removesuffix("e").removesuffix("E"),  # controllers leave it out
        serial=serial or f"2015990000{number}",
        rows=tuple((joint.theta, joint.d, joint.a, joint.alpha) for joint in joints),
    )
