"""Faults of the program links: how each is caused, and the error that the driver must report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.cell.driving.reaction import CauseKind
from drivers.arms.protocol import ArmError, EmergencyStop, LinkLost, MotionStopped, ProtectiveStop

Moment = Literal["before", "during", "after"]
MOMENTS: tuple[Moment, ...] = ("before", "during", "after")
SLIDER = "slider at 0"
"""No fault: the arms wait for the person, and nothing is reported as lost."""
HUNG = "application hung"
"""The process with the drivers is stopped by a signal; the arms' own processes must notice."""


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes
    ----------
    commands : tuple
        Commands to the emulated controller of the affected arm.
    error : type
        The exception that the driver must raise for that arm.
    signal : str
        Signal sent to the driver's worker process; empty: none.
    cause : str or None
        Cause with which the cell is stopped as a whole; None: the driver of the affected arm must notice.
    moments : tuple
        Moments that make sense.
    """

    commands: tuple[tuple[str, *tuple[object, ...]], ...] = ()
    error: type[ArmError] = LinkLost
    signal: Literal["", "SIGKILL", "SIGSTOP"] = ""
    cause: CauseKind | None = None
    moments: tuple[Moment, ...] = MOMENTS


FAULTS: Mapping[str, Fault] = {
    "link closed": Fault((("drop", "rtde", "fin"),)),
    "link reset": Fault((("drop", "rtde", "rst"),)),
    "link silent": Fault((("fault", "rtde", "silent"),)),
    "host silent": Fault((("fault", "*", "silent"),)),
    "reconnect refused": Fault((("drop", "rtde", "rst", 1.0),)),
    "slow program start": Fault((("start-delay", 2.0), ("drop", "rtde", "fin"))),
    "protective stop": Fault((("protective", "now"),), ProtectiveStop),
    "emergency stop": Fault((("estop",),), EmergencyStop),
    "worker killed": Fault(signal="SIGKILL"),
    "worker stopped": Fault(signal="SIGSTOP"),
    "stop key": Fault(error=MotionStopped, cause="stop"),
    "tracker died": Fault(error=MotionStopped, cause="tracker"),
    HUNG: Fault(moments=("during",)),
    SLIDER: Fault((("slider", 0.0),), moments=("during",)),
}
"""Faults by name."""


def shuffled(random: np.random.Generator) -> Callable[[], tuple[str, Moment]]:
    """Draw pairs of fault and moment: all in random order, then all again."""
    pairs = [(name, moment) for name, fault in FAULTS.items() for moment in fault.moments]
    left: list[tuple[str, Moment]] = []

    def draw() -> tuple[str, Moment]:
        if not left:
            left.extend(pairs[index] for index in random.permutation(len(pairs)))
        return left.pop()

    return draw
