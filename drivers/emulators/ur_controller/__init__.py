"""Universal Robots controllers that are not there: RTDE, dashboard, script and primary port, with motion behind them.

The real ur_rtde client holds the interpreter's lock while it connects, and knows the standard ports only. So the
emulator runs in a process of its own, and each arm has a loopback address of its own::

    from drivers.emulators.ur_controller import ControllerConfig, personality, start_in_process

    left = ControllerConfig("left", "127.0.0.2", personality("CB3", "UR10", "20153012345"))
    right = ControllerConfig("right", "127.0.0.3", personality("e-Series", "UR5", "20205501234"))
    with start_in_process([left, right]) as emulator:       # plant=PlantConfig(...), pace=20.0
        control = rtde_control.RTDEControlInterface("127.0.0.2")
        emulator.control("left", "protective", "travel", 0.3)   # a fault on command
        emulator.control("left", "release")                     # the operator
        emulator.control("left", "status")["moving"]

Plain sockets may use it in the same process: ``with UrControllerServer([left, right], plant) as server: ...`` with
``server.addresses`` and ``server.control()``; ``ports=FREE_PORTS`` in a ``ControllerConfig`` takes free ones.
``serve`` runs it in the foreground. ``control.py`` lists all that can be commanded.

Another server on the same plant, such as a tracker's, runs in a thread of its own in the same process: it holds
``server.cell.lock`` while it touches the plant and waits for the cell's time with ``server.cell.wait(seconds)`` or on
the condition ``server.cell.passed``, which has the same lock. Only the controllers' loop lets time pass, ``pace``
seconds of the cell for each second of wall time.

What this is not: URScript is not interpreted (a program other than ur_rtde's control script ends at once); servo,
speed, force, path and Cartesian motions end the program, as a script error would; ``stopJ`` brakes as hard as the
drives can, whatever deceleration is asked for; every current and force reads zero; the script port sends nothing.
"""

from drivers.emulators.ur_controller.control import Control, Refused
from drivers.emulators.ur_controller.links import FAULTS, Fault
from drivers.emulators.ur_controller.motion import FreeMotions, Motions, PacedCell
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
    Addresses,
    EmulatorProcess,
    UrControllerServer,
    serve,
    start_in_process,
)

__all__ = [
    "FAULTS",
    "FREE_PORTS",
    "STANDARD_PORTS",
    "Addresses",
    "Control",
    "ControllerConfig",
    "EmulatorProcess",
    "Fault",
    "FreeMotions",
    "Motions",
    "PacedCell",
    "Personality",
    "PortName",
    "Refused",
    "Series",
    "UrControllerServer",
    "kinematics_info",
    "personality",
    "serve",
    "start_in_process",
]
