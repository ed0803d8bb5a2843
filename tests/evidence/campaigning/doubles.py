"""Doubles of arms, tracker and air sensor: the simulated devices with the faults of real ones.

They stay when the program dies: a session of a new process connects to the same devices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import ArmError, ArmState, HostStalled, LinkLost
from drivers.arms.simulated import SimulatedArm
from drivers.plant import Plant
from drivers.sensors.protocol import AirReading, SensorLinkLost
from drivers.sensors.simulated import SimulatedAirSensor
from drivers.trackers.protocol import Point, TrackerLinkLost, Unstable
from drivers.trackers.simulated import SimulatedTracker
from tests.evidence.campaigning.monitor import WATCHDOG_S, Monitor

Vector = NDArray[np.float64]


class ProgramKilled(BaseException):
    """The program died here; no code of it may run on."""


class Process:
    """The program that uses the devices. A dead one raises ``ProgramKilled`` at every call of a device."""

    def __init__(self) -> None:
        self.alive = False

    def check(self) -> None:
        """Raise ``ProgramKilled`` if the program is dead."""
        if not self.alive:
            raise ProgramKilled


class Guarded:
    """A device as the program has it: a dead program dies at every use of one."""

    def __init__(self, device: object, process: Process) -> None:
        self._device, self._process = device, process

    def __getattr__(self, name: str) -> Any:
        self._process.check()
        return getattr(self._device, name)


class CampaignArm(SimulatedArm):
    """A simulated arm with the faults of a controller.

    Attributes
    ----------
    unready : str
        Why it accepts no motion; empty if it does.
    slider : float
        Speed slider, which scales every motion.
    sluggish : float
        Share of the asked speed of the next motion, which the controller does not report.
    refuses : bool
        Whether the controller refuses the next motion.
    mute : bool
        Whether a link of it is silent, so that it cannot be confirmed.
    as_it_begins, as_it_connects : callable or None
        What happens at the last instant before its next motion begins, or before it is connected next.
    """

    def __init__(self, plant: Plant, name: str, monitor: Monitor) -> None:
        super().__init__(plant, name)
        self._monitor = monitor
        self._stalled = False
        self.unready = ""
        self.slider = 1.0
        self.sluggish = 1.0
        self.refuses = False
        self.mute = False
        self.as_it_begins: Callable[[], None] | None = None
        self.as_it_connects: Callable[[], None] | None = None

    # -- the protocol --------------------------------------------------------------------------------------------------

    def _no_fault(self) -> None:
        super()._no_fault()
        if self._stalled:
            raise HostStalled(f"arm {self.name}: this computer was silent, the controller stopped the program")
        if self.unready:
            raise ArmError(self.unready)

    def connect(self) -> None:
        """Open the link. Raises ``LinkLost`` while it is cut, or why the arm would refuse to move."""
        act, self.as_it_connects = self.as_it_connects, None
        super().connect()
        if act is not None:
            act()
        self._stalled = False
        try:
            self._no_fault()
        except ArmError:
            self._connected = False
            raise

    def _now(self) -> ArmState:
        reason = "the program on the controller was stopped" if self._stalled else self.unready
        state = super()._now()
        if self.slider != 1.0:
            state = replace(state, speed_fraction=self.slider)
        return replace(state, ready=False, reason=reason) if reason else state

    def start_move(self, q: Vector, speed: Vector, acceleration: Vector) -> None:
        """Start a motion, slower than asked with a lowered slider."""
        if self.refuses:
            self._link()
            self.refuses = False
            raise ArmError(f"arm {self.name}: the controller refused the motion")
        share = self.slider * self.sluggish
        self.sluggish = 1.0
        act, self.as_it_begins = self.as_it_begins, None
        if act is not None:
            act()
        super().start_move(q, speed * share, acceleration * share)
        self._monitor.started(self.name, q)

    def confirm(self) -> None:
        """Raise ``LinkLost`` while a link is cut or silent."""
        super().confirm()
        if self.mute:
            raise LinkLost(f"arm {self.name}: the simulated dashboard does not answer")

    def brake(self) -> None:
        """Brake; impossible over a link that is cut."""
        self._monitor.braked(self.name)
        if self._link_cut:
            self.refuse_motion()
            raise LinkLost(f"arm {self.name}: the simulated link is cut")
        super().brake()

    # -- faults --------------------------------------------------------------------------------------------------------

    def forget_program(self) -> None:
        """Nobody listens any more; the watchdog of the controller stops the arm."""
        self._listener = lambda error: None
        self._connected = False
        self._watchdog()

    def cut_link(self) -> None:
        """Cut the link; the watchdog of the controller stops the arm."""
        self._watchdog()
        super().cut_link()

    def restore_link(self) -> None:
        """Make the link usable again; the program must connect."""
        self._link_cut = False

    def host_stall(self) -> None:
        """Stop the program of the arm because the computer was silent for too long."""
        self._stalled = True
        self._brake()
        self._listener(HostStalled(f"arm {self.name}: this computer was silent, the controller stopped the program"))

    def power_off(self) -> None:
        """Restart the controller: the link is lost, and the arm is not ready until somebody switches it on."""
        self.unready = f"arm {self.name}: power is off; switch it on at the pendant"
        self._brake()
        self.cut_link()

    def release(self) -> None:
        """Do what a person does at the arm after a fault."""
        super().release()
        self.unready = ""
        self.slider = 1.0
        self.refuses = self.mute = False

    def _watchdog(self) -> None:
        self._plant.schedule.at(self._plant.clock_s + WATCHDOG_S, self._brake)


class CampaignTracker(SimulatedTracker):
    """A simulated tracker with further faults.

    Attributes
    ----------
    shaking : bool
        Whether the floor shakes: no measurement is stable.
    astray_m : float
        Distance of the SMR that it locks from the right one [m]; zero: it locks the right one.
    mute : bool
        Whether it gives no sign of life while nothing else is asked of it.
    """

    def __init__(self, plant: Plant, monitor: Monitor) -> None:
        super().__init__(plant)
        self._monitor = monitor
        self.shaking = False
        self.astray_m = 0.0
        self.mute = False

    def confirm(self, within_s: float) -> None:
        """Raise ``TrackerLinkLost`` while the link is cut or silent."""
        super().confirm(within_s)
        if self.mute:
            raise TrackerLinkLost(f"tracker: the simulated tracker gave no answer within {within_s:g} s")

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Measure, and record what is returned."""
        point = super().measure(expected_M, averaging_s)
        if self.shaking:
            raise Unstable("tracker: the SMR shakes")
        if self.astray_m:
            point = replace(point, p_M=point.p_M + self.astray_m)
        self._monitor.measured(point.p_M)
        return point


class CampaignAir(SimulatedAirSensor):
    """A weather station that may fall silent (``silent``) or see other air (``warmer_k`` [K])."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.silent = False
        self.warmer_k = 0.0

    def read(self) -> AirReading:
        """Return the current air. Raises ``SensorLinkLost``."""
        if self.silent:
            raise SensorLinkLost("air sensor: no answer")
        reading = super().read()
        return replace(reading, temperature_c=reading.temperature_c + self.warmer_k)
