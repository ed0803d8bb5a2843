"""Open a cell whose arms a job moves: attended, confirmed by a person before the first motion, slow at first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import Confirm, Mover
from cellapp.cell.driving.reaction import StopReaction
from cellapp.cell.driving.supervision import Opened, attended_cell, hold_while_paused
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.control import JobControl
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel


@dataclass(frozen=True, eq=False)
class MovingCell:
    """Open cell with all arms at home; ``hold`` waits while a person pauses."""

    cell: Cell
    reaction: StopReaction
    bodies: CellBodies
    mover: Mover
    hold: Callable[[], None]
    began_s: float
    """Start of the first motion on the cell's clock [s]."""


@contextmanager
def moving_cell(
    profile: Profile,
    model: CellModel,
    control: JobControl,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    open_with: Opened | None = None,
    slow_visits: int | None = 0,
) -> Iterator[MovingCell]:
    """Open the cell of a profile and move all arms home.

    ``opened`` is called with the open cell before anything moves; an exception from it ends the job. ``confirm`` is
    called before the first motion. ``open_with`` opens the cell. The tracker must be ready. ``slow_visits``
    is as in ``Mover.slow_start``. Raise as ``attended_cell`` and ``Mover``; ``InputError`` if the first motion is not
    confirmed.
    """
    bodies, homes = cell_bodies(profile, model), home_positions(profile)
    with attended_cell(profile, control, open_with) as (cell, reaction):
        opened(cell)
        cell.require_tracker()
        mover = Mover(profile, cell, bodies, reaction)
        mover.confirm_first(homes, confirm)
        mover.slow_start(slow_visits)
        began_s = cell.clock.now_s()
        mover.go_home()
        yield MovingCell(cell, reaction, bodies, mover, lambda: hold_while_paused(cell, control, reaction), began_s)
