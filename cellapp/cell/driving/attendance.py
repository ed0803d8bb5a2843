"""Actions of a person at resting arms while a job waits: another load, a force on a flange.

A simulated cell acts by itself. In a real one the job pauses and says what to do, until a person resumes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cellapp.ground.control import JobControl
from cellapp.ground.progress import JobState, Listener, Progress, StateChange
from cellapp.robot.kinematics.transforms import Array
from drivers.plant import Plant


@dataclass(frozen=True, eq=False)
class SimulatedPerson:
    """Acts on the arms of a simulated cell."""

    plant: Plant

    def hang(self, arm: str, load_kg: float, center_F: Array | None = None) -> None:
        """Put another load on a flange; ``center_F`` is its centre of mass (3,) [m], unchanged if None."""
        _, center = self.plant.payload(arm)
        self.plant.set_payload(arm, load_kg, center if center_F is None else center_F)

    def pull(self, arm: str, force_B: Array) -> None:
        """Pull at a flange with a force (3,) [N] in the arm's base; if zero, release it."""
        self.plant.set_pull(arm, force_B if force_B.any() else None)


def by_person(
    person: SimulatedPerson | None,
    act: Callable[[SimulatedPerson], None],
    words: str,
    control: JobControl,
    listener: Listener,
    hold: Callable[[], None],
) -> None:
    """Have something done at the resting arms; return when it is done.

    In a simulated cell ``act`` does it. Else the job pauses with ``words``; ``hold`` returns when it is resumed.
    """
    if person is not None:
        act(person)
        return

    def say(done: int, state: JobState, reason: str) -> None:
        listener(Progress("by hand", done, 1, words, detail=StateChange(state, reason)))

    control.pause()
    say(0, "paused", f"{words}; then resume")
    hold()
    say(1, "running", "resumed by a person")
