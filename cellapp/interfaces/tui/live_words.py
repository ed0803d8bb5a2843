"""Words for the current state of the cell: the age of all data, the progress of each arm's stop. Draws nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from cellapp.ground.progress import ArmLive, CellLive, HaltState

LATE_S, LOST_S = 0.3, 1.0
"""Ages from which data are late, and lost: lost data say nothing about now."""
Look = Literal["fresh", "late", "lost"]

HALT_WORDS: Mapping[HaltState, str] = {
    "asked": "STOP ASKED",
    "braking": "BRAKING",
    "at rest": "AT REST",
    "not seen at rest": "NOT SEEN AT REST",
}
_WORST_FIRST: tuple[HaltState, ...] = ("not seen at rest", "asked", "braking", "at rest")
_TREAT_AS_MOVING = "treat it as moving: emergency stop, then look"


@dataclass(frozen=True)
class Part:
    """A part of the live strip, and how old its data are."""

    text: str
    look: Look


@dataclass(frozen=True)
class Banner:
    """Progress of the halt in words that begin with the state; its causes; whether an arm counts as moving."""

    words: str
    causes: tuple[str, ...]
    alarm: bool


def look_of(age_s: float | None) -> Look:
    """Return how data of an age are displayed; None means no data."""
    if age_s is None or age_s > LOST_S:
        return "lost"
    return "late" if age_s > LATE_S else "fresh"


def age_words(age_s: float | None) -> str:
    """Format an age as "0.2 s", in steps that an eye can follow."""
    if age_s is None:
        return "no data"
    return f"{age_s:.1f} s" if age_s < 10.0 else f"{age_s:.0f} s"


def halt_of(arm: ArmLive) -> HaltState | None:
    """Return the progress of an arm's halt; without current data it is not seen at rest, whatever was commanded."""
    if arm.halt is None:
        return None
    unknown = arm.halt.state in ("asked", "braking") and look_of(arm.age_s) == "lost"
    return "not seen at rest" if unknown else arm.halt.state


def strip_of(live: CellLive) -> list[Part]:
    """Return each arm, the tracker and the job with the age of their data."""
    parts = []
    for name, arm in live.arms.items():
        halt, look = halt_of(arm), look_of(arm.age_s)
        doing = HALT_WORDS[halt] if halt else "no state" if look == "lost" else "moves" if arm.moving else "rests"
        parts.append(Part(f"{name} {doing} {age_words(arm.age_s)}", "lost" if halt == "not seen at rest" else look))
    parts.append(Part(f"tracker {age_words(live.tracker_age_s)}", look_of(live.tracker_age_s)))
    return [*parts, Part(f"job {age_words(live.job_age_s)}", look_of(live.job_age_s))]


def banner_of(live: CellLive | None, unseen: Mapping[str, str]) -> Banner | None:
    """Return the banner of a halt or of missing data; None if there is neither.

    ``unseen`` are the arms that the open run counts as moving, arm -> why.
    """
    halts = {} if live is None else {name: halt_of(arm) for name, arm in live.arms.items()}
    state = next((state for state in _WORST_FIRST if state in halts.values()), None)
    names = [name for name, halt in halts.items() if halt == "not seen at rest"]
    names += [name for name in unseen if name not in halts]
    causes = () if live is None else live.causes
    if names:
        arms = f"arm{'s' if len(names) > 1 else ''} {', '.join(names)}"
        return Banner(f"NOT SEEN AT REST: {arms}; {_TREAT_AS_MOVING}", causes or tuple(unseen.values()), True)
    if state is not None:
        words = {"asked": "STOP ASKED", "braking": "ARMS BRAKE", "at rest": "AT REST: all arms were seen at rest"}
        return Banner(words[state], causes, False)
    lost = [] if live is None else without_data(live)
    if lost:
        return Banner(f"NO DATA from {', '.join(lost)}: what is shown of it is old", (), True)
    return None


def without_data(live: CellLive) -> list[str]:
    """Return the names of the devices that send no data."""
    arms = [f"arm {name}" for name, arm in live.arms.items() if look_of(arm.age_s) == "lost"]
    return [*arms, *(["tracker"] if look_of(live.tracker_age_s) == "lost" else [])]
