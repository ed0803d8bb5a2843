"""The verb ``emulate``: emulate a profile's UR controllers and tracker bridge, with its simulated cell behind them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.commands.record import Asked, ProfilePath, Request, Verb, View, Work
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.progress import JobToken
from cellapp.ground.results import Record, Result
from drivers.arms.settings import EmulatedController
from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.emulators.ur_controller import REAL_TIME, Addresses, ControllerConfig, Personality, UrControllerServer
from drivers.emulators.ur_controller.personality import STANDARD_PORTS
from drivers.plant import Plant
from drivers.plant.factory import factory_calibration
from drivers.plant.sweep import recorder_of
from drivers.priority import in_real_time
from drivers.settings import SettingError
from drivers.trackers.imperfections import Imperfections


class EmulateRequest(Request):
    """Emulate this cell's controllers and, behind a bridge, its tracker, on loopback until interrupted."""

    profile: ProfilePath
    pace: Annotated[float, Field(ge=0.1, le=1000.0), Asked("Simulated seconds for each real one.", "X")] = 1.0
    lost_beams: Annotated[
        float, Field(ge=0.0, le=60.0), Asked("How often in a minute the beam to a moving SMR breaks.", "N")
    ] = 0.0
    simulation: Annotated[bool, Asked("Controllers in simulation mode, for 'rehearse': no arm moves.")] = False


VERB = Verb("emulate", EmulateRequest, chapter="emulator")


class EmulatedArm(Record):
    """An emulated arm: its controller and where that listens.

    ``control_port`` on 127.0.0.1 accepts commands for faults and for the operator's actions; see
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


class EmulatedTracker(Record):
    """Where the tracker of the simulated cell is served over the bridge protocol."""

    host: str
    port: int


class EmulateResult(Result, schema="cellapp-emulate"):
    """``emulate``: what is served; ``pace`` is simulated seconds per real second."""

    pace: float
    arms: tuple[EmulatedArm, ...]
    tracker: EmulatedTracker | None


_STEP_S = 0.2
"""Longest time until a cancel, such as Ctrl-C, is noticed."""
_CB3_MODELS = ("UR3", "UR5", "UR10")
_LATE_S = 0.04
"""Largest delay of packets of the tracker's stream [s]."""
_JOINTS = 6
"""Joints of a UR arm."""
_CALIBRATED = 2
"""Calibration status that a controller reports after calibration in the factory."""


def run(request: EmulateRequest, work: Work) -> EmulateResult:
    """Emulate the cell until the work is stopped; announce the addresses when the servers listen."""
    return emulate(
        load_profile(request.profile),
        work.control,
        work.announce,
        pace=request.pace,
        lost_beams=request.lost_beams,
        simulation=request.simulation,
    )


def emulated_tracker(profile: Profile) -> EmulatedTracker | None:
    """Return the address of the emulated tracker; None without a simulated cell or a loopback address."""
    bridge = profile.tracker.driver.emulated_bridge()
    return None if profile.plant is None or bridge is None else EmulatedTracker(host=bridge.host, port=bridge.port)


def _serve_tracker(
    stack: ExitStack,
    profile: Profile,
    plant: Plant,
    server: UrControllerServer,
    tracker: EmulatedTracker,
    lost_beams: float,
) -> EmulatedTracker:
    """Serve the tracker of the cell that the controllers move; it waits for their clock and holds their lock."""
    try:
        token = profile.tracker.driver.token()
    except SettingError as error:
        raise InputError(str(error)) from error
    clocks = recorder_of(plant)  # the same seed and clocks as without emulation
    own = Imperfections(
        clock_offset_s=clocks.offset_s,
        clock_rate=clocks.rate_ppm * 1e-6,
        packet_jitter_s=_LATE_S,
        lost_beams_per_min=lost_beams,
        longest_loss_s=clocks.longest_loss_s,
    )
    bridge = TrackerBridgeEmulator(
        plant, cell=server.cell, imperfections=own, host=tracker.host, port=tracker.port, token=token
    )
    try:
        stack.enter_context(bridge)
    except OSError as error:
        raise HardwareError(f"tracker: {error.strerror}; see whether another bridge runs here") from error
    assert bridge.port is not None
    return EmulatedTracker(host=bridge.host, port=bridge.port)


def emulated_arms(profile: Profile) -> list[EmulatedArm]:
    """Return the controllers of a profile that can be emulated, on the standard ports.

    The driver of an arm sets its address: its own loopback address, or any free one from 127.0.0.2 on. Arms with a
    controller on another machine are left out.

    Raises
    ------
    InputError
        If no controller can be emulated, two arms share an address, or an arm is not a UR arm with six joints.
    """
    emulated = {name: arm.driver.emulated_controller() for name, arm in profile.arms.items()}
    controllers = {name: controller for name, controller in emulated.items() if controller is not None}
    if not controllers:
        raise InputError(
            f"profile {profile.name}: no controller to emulate; this needs an arm whose driver is 'simulated', or 'ur'"
            " with a loopback address such as 127.0.0.2 as its host"
        )
    hosts = _hosts(controllers)
    return [
        EmulatedArm(arm=name, controller=_personality(name, arm, controllers[name].serial, number), host=hosts[name])
        for number, (name, arm) in enumerate(profile.arms.items(), start=1)
        if name in controllers
    ]


def _hosts(controllers: Mapping[str, EmulatedController]) -> dict[str, str]:
    """Return the address of each controller; assign free addresses to those without one. Raises ``InputError``."""
    hosts = {name: one.host for name, one in controllers.items() if one.host is not None}
    for name, host in reversed(hosts.items()):
        if list(hosts.values()).count(host) > 1:
            raise InputError(f"arms.{name}.driver.host: {host} is another arm's; give each its own, as 127.0.0.2")
    free = (f"127.0.0.{number}" for number in range(2, 255) if f"127.0.0.{number}" not in hosts.values())
    return hosts | dict(zip((name for name in controllers if name not in hosts), free, strict=False))


def emulate(
    profile: Profile,
    job: JobToken,
    announce: Callable[[EmulateResult], None],
    arms: Sequence[EmulatedArm] | None = None,
    pace: float = 1.0,
    tracker: EmulatedTracker | None = None,
    watch_clearance: bool = False,
    lost_beams: float = 0.0,
    simulation: bool = False,
) -> EmulateResult:
    """Emulate the controllers of a profile until ``cancel``; all ports are free on return. Returns what was served.

    The arms belong to the simulated cell of the section ``plant``; without one, only their joints move. In real time
    they run with priority over other programs, if permitted: real controllers have their own computers.

    Parameters
    ----------
    announce : callable
        Called once with the addresses, when all controllers and the tracker listen.
    arms : sequence of EmulatedArm, or None
        Controllers to use instead of ``emulated_arms``; port 0 takes a free one.
    pace : float
        Seconds of the cell for each second of wall time.
    tracker : EmulatedTracker, or None
        Address to use instead of ``emulated_tracker``; the tracker measures the same cell.
    watch_clearance : bool
        Whether the command ``clearance`` of the control channel reports the smallest distances.
    lost_beams : float
        How often the beam to a moving SMR breaks [1/min].
    simulation : bool
        Whether the controllers are in simulation mode: joints move, but the arms of the simulated cell rest at home.

    Raises
    ------
    InputError
        As ``emulated_arms``, and if ``pace`` is not between 0 and 1000.
    HardwareError
        If a port is in use, an address is not available, or the simulation fails while it runs.
    """
    chosen = emulated_arms(profile) if arms is None else arms
    bridge = emulated_tracker(profile) if tracker is None else tracker
    plant = None if profile.plant is None else build_plant(profile, watch_clearance=watch_clearance)
    server = _server(profile, chosen, plant, pace, simulation=simulation)
    with ExitStack() as stack:
        if pace <= REAL_TIME:
            stack.enter_context(in_real_time(inherited=True))
        _listen(stack, server)
        if bridge is not None and plant is not None and not simulation:
            bridge = _serve_tracker(stack, profile, plant, server, bridge, lost_beams)
        else:
            bridge = None
        listening = tuple(_listening(arm, server.addresses) for arm in chosen)
        served = EmulateResult(pace=pace, arms=listening, tracker=bridge)
        announce(served)
        while not job.wait(_STEP_S):
            _check(server)
        return served


def _server(
    profile: Profile, arms: Sequence[EmulatedArm], plant: Plant | None, pace: float, *, simulation: bool
) -> UrControllerServer:
    configs = [replace(_config(arm, profile.arms[arm.arm], plant), simulation=simulation) for arm in arms]
    try:
        return UrControllerServer(configs, None if simulation else plant, pace)
    except ValueError as error:
        raise InputError(f"profile {profile.name}: {error}") from error


def _listen(stack: ExitStack, server: UrControllerServer) -> None:
    try:
        stack.enter_context(server)
    except OSError as error:
        raise HardwareError(
            f"{error.strerror}; see whether another emulator or simulator runs here. On macOS,"
            " addresses other than 127.0.0.1 must be added first: ifconfig lo0 alias 127.0.0.2"
        ) from error


def _check(server: UrControllerServer) -> None:
    """Raise ``HardwareError`` if the simulation failed."""
    if server.failure is not None:
        why = f"{type(server.failure).__name__}: {server.failure}"
        raise HardwareError(f"the emulated cell cannot go on ({why}); its ports are closed") from server.failure


def _listening(arm: EmulatedArm, addresses: Addresses) -> EmulatedArm:
    ports = {f"{name}_port": number for name, (_, number) in addresses.arms[arm.arm].items()}
    return arm.model_copy(update={**ports, "control_port": addresses.control[1]})


def _config(emulated: EmulatedArm, arm: Arm, plant: Plant | None) -> ControllerConfig:
    joints = arm.type.joints
    limits = tuple((joint.limit[0], joint.limit[1]) for joint in joints)
    home = arm.home or tuple(min(max(0.0, low), high) for low, high in limits)
    return ControllerConfig(
        name=emulated.arm,
        host=emulated.host,
        personality=_as_calibrated(emulated, plant),
        ports={name: getattr(emulated, f"{name}_port") for name in STANDARD_PORTS},
        limits=limits,
        speed=tuple(joint.speed for joint in joints),
        acceleration=tuple(joint.acceleration for joint in joints),
        home=home,
        payload_mass=arm.payload.mass,
        payload_center=arm.payload.center_of_mass,
    )


def _as_calibrated(emulated: EmulatedArm, plant: Plant | None) -> Personality:
    """Return the controller with its arm's factory calibration, if the simulated cell has one."""
    own = None if plant is None else factory_calibration(plant, emulated.arm)
    if own is None:
        return emulated.controller
    rows = tuple((theta, d, a, alpha) for theta, d, a, alpha in own.rows.tolist())
    return replace(emulated.controller, rows=rows, checksums=own.checksums, calibration_status=_CALIBRATED)


def _personality(name: str, arm: Arm, serial: str | None, number: int) -> Personality:
    """Build the controller of a UR arm. Raises ``InputError`` if the arm's type is no UR arm."""
    model = arm.type.model.strip()
    joints = arm.type.joints
    if not model.upper().startswith("UR") or len(joints) != _JOINTS:
        raise InputError(
            f"arms.{name}.type: '{model}' with {len(joints)} joints is not a UR arm; only UR controllers are emulated"
        )
    return Personality(
        series="CB3" if model.upper() in _CB3_MODELS else "e-Series",
        model=model.removesuffix("e").removesuffix("E"),  # e-Series controllers report the model without it
        serial=serial or f"2015990000{number}",
        rows=tuple((joint.theta, joint.d, joint.a, joint.alpha) for joint in joints),
    )


def view(result: EmulateResult, request: Request | None = None) -> View:
    """Show the controllers and their ports."""
    served = [_arm_words(arm) for arm in result.arms]
    if (tracker := result.tracker) is not None:
        served.append(f"tracker: simulated, bridge protocol at {tracker.host} port {tracker.port}")
    return View((*served, "Ctrl-C ends this"))


def _arm_words(arm: EmulatedArm) -> str:
    return (
        f"arm {arm.arm}: {arm.controller.model} ({arm.controller.series}), serial {arm.controller.serial},"
        f" at {arm.host}: dashboard {arm.dashboard_port}, primary {arm.primary_port}, script {arm.script_port},"
        f" RTDE {arm.rtde_port}; faults on command at 127.0.0.1:{arm.control_port}"
    )
