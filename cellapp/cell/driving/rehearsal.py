"""Rehearse a plan without the tracker: first only the controllers, then real arms, in steps of increasing risk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.cell.driving.cell import open_arms
from cellapp.cell.driving.cell_checks import check_controllers
from cellapp.cell.driving.motion import Confirm, MotionRefused, Mover
from cellapp.cell.driving.records import RehearsedMotion
from cellapp.cell.driving.rehearsal_rungs import RUNGS, Rung, RungName
from cellapp.cell.driving.stops_to_collect import StopsToCollect, Travel, remaining_work
from cellapp.cell.driving.supervision import reacting
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import Detail, MotionBegun, MotionEnded
from cellapp.robot.kinematics.transforms import Array


@dataclass
class Rehearsal:
    """Results of one rung; stops count from 1, as in ``RehearseResult``.

    Attributes
    ----------
    visited : list of int
        The stops that were reached.
    refused : dict
        Stop -> why the gate or a controller refused it.
    notes : tuple of str
        Messages of the controllers.
    ended : str
        Why the rung ended early; empty if it was completed.
    """

    visited: list[int] = field(default_factory=list)
    refused: dict[int, str] = field(default_factory=dict)
    motions: list[RehearsedMotion] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    ended: str = ""


def rehearse(
    run: RunFile, name: RungName, arms: Sequence[str], control: JobControl, confirm: Confirm | None
) -> Rehearsal:
    """Drive the planned stops of a run for one rung with ``arms``; the others stay where they are. Store nothing.

    Refusals by a device, and a fault that ends the rung, are in the result.

    Raises
    ------
    InputError
        Without a plan, if the first motion is not confirmed, or if a record of the run is damaged.
    Stopped, Aborted
        If a person stopped it; the arms have been braked.
    """
    found, rung, work = Rehearsal(), RUNGS[name], remaining_work(run, resume=True)
    try:
        with open_arms(run.profile, control, simulation=rung.simulation) as cell, reacting(cell, control) as reaction:
            found.notes = check_controllers(run, cell)
            mover = Mover(run.profile, cell, cell_bodies(run.profile), reaction, control)
            _Driver(work, rung, tuple(arms), mover, found).drive(confirm)
    except (HardwareError, MotionRefused) as error:
        found.ended = str(error)
    return found


@dataclass
class _Driver:
    """Drives one rung in an open cell."""

    work: StopsToCollect
    rung: Rung
    arms: tuple[str, ...]
    mover: Mover
    found: Rehearsal

    def __post_init__(self) -> None:
        self.mover.emit = self._note
        self.travel = Travel(self.mover, self.work)
        self.mover.speed = self.rung.share
        self._begun: tuple[MotionBegun, float] | None = None

    def drive(self, confirm: Confirm | None) -> None:
        """Visit the stops of the rung, then go home."""
        forbidden = self.travel.forbidden_stops()
        stops = [stop for stop in self.work.stops if stop not in forbidden][: self.rung.stops]
        if self.rung.stops is None:
            self.found.refused |= {stop + 1: why for stop, why in forbidden.items()}
        if stops:
            self.mover.confirm_first(self._targets(stops[0]), confirm)
        for number, stop in enumerate(stops):
            self.mover.hold()
            self.mover.control.tell("rehearse", number, len(stops), f"stop {stop + 1}")
            self.mover.stop = stop
            try:
                self._to_stop(stop)
                self.found.visited.append(stop + 1)
            except MotionRefused as error:
                self.found.refused[stop + 1] = str(error)
            finally:
                self.mover.stop = None
        self.mover.go_home(self.arms)
        self.mover.control.tell("rehearse", len(stops), len(stops), "done")

    def _to_stop(self, stop: int) -> None:
        """Move as collecting does; if only some arms of the cell move, go straight or from home."""
        if set(self.arms) == set(self.work.route.q):
            self.travel.to_stop(stop)
            return
        try:
            self.mover.move(self._targets(stop))
        except MotionRefused:
            self.mover.go_home(self.arms)
            self.mover.move(self._targets(stop))

    def _targets(self, stop: int) -> dict[str, Array]:
        return {name: q for name, q in self.work.route.targets(stop).items() if name in self.arms}

    def _note(self, detail: Detail) -> None:
        """Record duration and deviation of a motion from the reports of its beginning and end."""
        now_s = self.mover.cell.clock.now_s()
        if isinstance(detail, MotionBegun):
            self._begun = detail, now_s
        elif isinstance(detail, MotionEnded) and self._begun is not None:
            begun, since_s = self._begun
            off_mrad = {
                name: 1e3 * float(np.abs(np.array(q) - detail.q[name]).max(initial=0.0))
                for name, q in begun.q_target.items()
                if name in detail.q
            }
            expected_s = begun.expected_s if math.isfinite(begun.expected_s) else 0.0
            stop = None if begun.stop is None else begun.stop + 1
            self.found.motions.append(
                RehearsedMotion(stop=stop, seconds=now_s - since_s, expected_s=expected_s, off_mrad=off_mrad)
            )
            self._begun = None
