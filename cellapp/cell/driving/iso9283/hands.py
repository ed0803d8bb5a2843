"""Ask a person for actions at the arms in tests of ISO 9283: attach a load, pull at the flange; record each step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cellapp.cell.driving.attendance import SimulatedPerson, by_person
from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import known_payload
from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.estimation.iso9283.evaluate_compliance import FORCE_DIRECTIONS, force_direction, force_place
from cellapp.estimation.iso9283.places import ArmProgramme, Place
from cellapp.estimation.iso9283.records import PersonStep
from cellapp.ground.control import JobControl
from cellapp.ground.progress import Listener, Progress


@dataclass(frozen=True, eq=False)
class Hands:
    """Asks a person at an open cell; ``hold`` returns when the job is resumed. A simulated cell acts by itself.

    ``cycles`` is the number for a test under forces.
    """

    cell: Cell
    findings: IsoFindings
    control: JobControl
    listener: Listener
    hold: Callable[[], None]
    cycles: int

    def hang(self, name: str, load_kg: float) -> bool:
        """Have another load attached to the flange of an arm at home; return whether its controller is set to it.

        If not, record why the arm is not driven with that load.
        """
        self._ask(
            f"arm {name}: hang {load_kg:g} kg on the flange, all that it carries together, and set the payload of its"
            " controller to that",
            lambda person: person.hang(name, load_kg),
        )
        if doubt := known_payload(self.cell.arms[name], load_kg):
            self.findings.refuse(name, ["pose"], f"not with {load_kg:g} kg: {doubt}")
        return not doubt

    def under_forces(
        self, programme: ArmProgramme, forces: Sequence[float], measure: Callable[[Place, int, int], None]
    ) -> None:
        """Test static compliance at the present position, in each direction: no force, each force, no force.

        ``measure`` is called with place, cycle and group; the arm does not move in the meantime.
        """
        steps = [*((force, 0) for force in (0.0, *forces)), (0.0, 1)]
        for direction in FORCE_DIRECTIONS:
            for cycle in range(self.cycles):
                for force, group in steps:
                    place = force_place(programme, direction, force)
                    self.findings.wanted[place] = self.cycles
                    self.listener(Progress("compliance", cycle, self.cycles, str(place)))
                    self.pull(programme.name, direction, force)
                    measure(place, cycle, group)

    def pull(self, name: str, direction: str, force_n: float) -> None:
        """Have a force applied to the flange along an axis of the arm's base; if zero, have the flange released."""
        words = f"let go of the flange of arm {name}; nobody touches it"
        if force_n:
            words = f"pull at the flange of arm {name} with {force_n:g} N along {direction} of its base, and hold that"
        self._ask(words, lambda person: person.pull(name, force_n * force_direction(direction)))

    def _ask(self, words: str, act: Callable[[SimulatedPerson], None]) -> None:
        by_person(self.cell.person, act, words, self.control, self.listener, self.hold)
        step = PersonStep(words=words, time_s=self.cell.clock.now_s(), simulated=self.cell.person is not None)
        self.findings.by_person.append(step)
