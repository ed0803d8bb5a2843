"""What a data-driven term means for people: checks by what it moves, further stops by what it depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.robot.effects.column import Channel
from cellapp.robot.effects.data_driven import DataChannel, Quantity, Variable
from cellapp.robot.effects.meaning import Meaning, enumeration

_OTHER_STATION = "Measure some of the stops from a second tracker station: a field of the tracker moves with it."
UNKNOWN_MEANING = Meaning(
    cause=(
        "Something moves {place} by a law that the library does not have; where it follows the position alone, it is a"
        " field of the workspace or of the tracker's volume."
    ),
    size="No size is known in advance: the report states what was found",
    size_source="none",
    check=(
        "Look at the figure of the term: a jump, a bend or a period often tells where it comes from.",
        "Check what was changed in the cell since the last good run: cables, hoses, tool, mounts, software.",
        "For a field: look for warm air across the beam, sunlight, a stand or floor that gives way.",
    ),
    settle=(
        _OTHER_STATION,
        "Repeat the run on another day: what belongs to the machine stays, what belongs to the day does not.",
    ),
)

_CHECKS: Mapping[Channel, tuple[str, ...]] = {
    Channel.JOINT: (
        "Check cables and hoses along {place}: a dress pack that pulls acts like this.",
        "Check gear, encoder and bolts of {place}.",
    ),
    Channel.BASE: (
        "Check the bolts of base plate, pedestal and anchors.",
        "Look for what else moves in the cell: the other arm, a conveyor, a door, traffic on the floor.",
    ),
    Channel.TOOL: (
        "Check the screws of the SMR's mount and of the tool, and the seat of the SMR in its nest.",
        "Check cables at the wrist that pull at the mount.",
    ),
    Channel.TRACKER: (
        "Check the tracker's stand, its weather station and its warm-up; run the two-face check.",
        "Look for warm air across the beam: heaters, open doors, the arm's own controller.",
    ),
}

_SETTLE: Mapping[Quantity, str] = {
    Quantity.JOINT_ANGLE: "Move {variable} alone through its range, forth and back, all other joints at rest.",
    Quantity.OTHER_JOINT_ANGLE: "Move {variable} at random between stops, then park it for 20 stops.",
    Quantity.TIME: "Measure a reference pose and fixed nests every 20 stops, over a whole run and on another day.",
    Quantity.TORQUE: "Repeat 20 stops with a second payload.",
    Quantity.STEP: "Approach one pose with last steps of 1, 5, 20 and 60 degrees of {variable}, from both sides.",
    Quantity.DWELL: "Vary the dwell from 0.5 to 10 s at random.",
    Quantity.PAYLOAD: "Measure the same 10 poses with three payloads.",
    Quantity.TEMPERATURE: "Log temperatures while the cell warms up and cools down; a reference pose every 20 stops.",
    Quantity.RANGE: "Measure some of the stops from a second tracker station, nearer and farther.",
    Quantity.AZIMUTH: "Measure some of the stops from a second tracker station.",
    Quantity.ELEVATION: "Measure some of the stops from a second tracker station, higher or lower.",
    Quantity.INCIDENCE: "Measure the same point at six rolls of the wrist.",
    **dict.fromkeys((Quantity.X, Quantity.Y, Quantity.Z), UNKNOWN_MEANING.settle[0]),
}


def data_driven_meaning(channel: DataChannel, drivers: Sequence[Variable]) -> Meaning:
    """Meaning of a term that moves ``channel`` with one or two variables."""
    settle = dict.fromkeys(_to_settle(one) for one in drivers)
    depends = enumeration([_variable_in_words(one) for one in drivers])
    return Meaning(
        cause=f"Something moves {{place}} with {depends}, by a law that the library does not have.",
        size=UNKNOWN_MEANING.size,
        size_source=UNKNOWN_MEANING.size_source,
        check=(*_CHECKS.get(channel.channel, ()), *UNKNOWN_MEANING.check[:2]),
        settle=(*settle, UNKNOWN_MEANING.settle[-1]),
    )


def imitation_meaning(title: str, meaning: Meaning) -> Meaning:
    """Meaning of a term that moves a joint by its angle and looks like an effect, ``title``, that is less probable."""
    return Meaning(
        cause=f"Something moves {{place}} and looks like {title}; a dress pack that pulls at it is more probable.",
        size=UNKNOWN_MEANING.size,
        size_source=UNKNOWN_MEANING.size_source,
        check=tuple(dict.fromkeys((*_CHECKS[Channel.JOINT], *meaning.check))),
        settle=("Take the hose or cable off {place} and measure 20 stops again.", *meaning.settle),
    )


def _to_settle(variable: Variable) -> str:
    return _SETTLE.get(variable.quantity, _OTHER_STATION).replace("{variable}", _variable_in_words(variable))


def _variable_in_words(variable: Variable) -> str:
    """``joint 2``, ``joint 3 of the other arm``, ``the torque on joint 2``, ``time``."""
    if variable.joint is None:
        return _NAMES.get(variable.quantity, variable.quantity.value)
    joint = f"joint {variable.joint + 1}"
    if variable.quantity is Quantity.OTHER_JOINT_ANGLE:
        return f"{joint} of the other arm"
    return joint if variable.quantity in (Quantity.JOINT_ANGLE, Quantity.STEP) else f"the torque on {joint}"


_NAMES = {
    Quantity.DWELL: "the dwell",
    Quantity.PAYLOAD: "the payload",
    Quantity.TEMPERATURE: "the air temperature",
    Quantity.RANGE: "the distance from the tracker",
    Quantity.AZIMUTH: "the tracker's azimuth",
    Quantity.ELEVATION: "the tracker's elevation",
    Quantity.INCIDENCE: "the angle of incidence",
}
