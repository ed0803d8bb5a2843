"""Emulated Universal Robots controllers: RTDE, dashboard, script and primary port, with simulated motion.

The real ur_rtde client holds the interpreter's lock while it connects and uses the standard ports only. Hence the
emulator runs in a separate process, and each arm has a loopback address of its own::

    from drivers.emulators.ur_controller import ControllerConfig, personality, start_in_process

    left = ControllerConfig("left", "127.0.0.2", personality("CB3", "UR10", "20153012345"))
    right = ControllerConfig("right", "127.0.0.3", personality("e-Series", "UR5", "20205501234"))
    with start_in_process([left, right]) as emulator:  # pace=20.0: 20 times as fast
        control = rtde_control.RTDEControlInterface("127.0.0.2")
        emulator.control("left", "protective", "travel", 0.3)   # a fault on command
        emulator.control("left", "release")                     # the operator
        emulator.control("left", "status")["moving"]

Clients with plain sockets may share its process: ``with UrControllerServer([left, right], plant) as server: ...`` with
``server.addresses`` and ``server.control()``; ``ports=FREE_PORTS`` in a ``ControllerConfig`` takes free ones.
``open`` and ``run`` serve in the foreground. ``control.py`` lists all commands of the control channel.

Another server on the same plant, such as a tracker's, runs in a thread of the same process. It holds
``server.cell.lock`` while it accesses the plant and waits for the cell's clock with ``server.cell.wait(seconds)`` or on
the condition ``server.cell.passed``, which uses the same lock. Only the controllers' loop advances the clock, by
``pace`` seconds per second of wall time.

A stop acts after a latency and brakes along the path with a limited deceleration; ``motion.py`` has the figures and
their sources, the command ``stops`` the times of each.

Not emulated: URScript is not interpreted (a program other than ur_rtde's control script ends at once); speed,
force, path and Cartesian motions end the program, as a script error would; all currents and forces are zero; the
script port sends nothing.
"""

from drivers.emulators.ur_controller.control import Control, Refused
from drivers.emulators.ur_controller.links import FAULTS, Fault
from drivers.emulators.ur_controller.motion import Braking, PacedCell
from drivers.emulators.ur_controller.personality import (
    FREE_PORTS,
    STANDARD_PORTS,
    ControllerConfig,
    Personality,
    PortName,
    Series,
    personality,
)
from drivers.emulators.ur_controller.primary import kinematics_info
from drivers.emulators.ur_controller.server import (
    REAL_TIME,
    Addresses,
    EmulatorProcess,
    UrControllerServer,
    ideal,
    start_in_process,
)

__all__ = [
    "FAULTS",
    "FREE_PORTS",
    "REAL_TIME",
    "STANDARD_PORTS",
    "Addresses",
    "Braking",
    "Control",
    "ControllerConfig",
    "EmulatorProcess",
    "Fault",
    "PacedCell",
    "Personality",
    "PortName",
    "Refused",
    "Series",
    "UrControllerServer",
    "ideal",
    "kinematics_info",
    "personality",
    "start_in_process",
]
