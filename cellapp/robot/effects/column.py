"""Columns of an effect: the SMR displacement per unit of each parameter, and the channel it acts through."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from cellapp.robot.kinematics.transforms import Array


class Channel(Enum):
    """The part of the cell that an effect moves, and how that moves the measured SMR."""

    JOINT = "joint"
    """Offset of joint j: ``dP = offset J_j``, ``J_j = z_j x (P - o_j)``."""
    AXIS = "axis"
    """Small twist of the frame before joint j, or of joint housings."""
    LINK = "link"
    """Small twist (d, w) of D-H frame i with all beyond it: ``dP = R_i d + (R_i w) x (P - o_i)``."""
    BASE = "base"
    """Small twist of the base frame: ``dP = R_B d + (R_B w) x (P - o_B)``."""
    TOOL = "tool"
    """Shift of the SMR in the flange frame: ``dP = R_F d``."""
    TRACKER = "tracker"
    """Reading error of the tracker, along the beam or across it."""


INDEXED_CHANNELS = frozenset({Channel.JOINT, Channel.AXIS, Channel.LINK})
"""Channels that exist once per joint."""


@dataclass(frozen=True)
class Wave:
    """Cosine or sine of a multiple of a joint angle: ``cycles`` periods per turn."""

    cycles: int
    sine: bool

    def __call__(self, angle: Array) -> Array:
        """Values at joint angles [rad]."""
        return np.asarray((np.sin if self.sine else np.cos)(self.cycles * angle))


@dataclass(frozen=True)
class EffectColumn:
    """One parameter of an effect and the displacement it causes.

    Attributes
    ----------
    name : str
        For example ``compliance2``. A label for JSON and people; nothing parses it.
    unit : str
    block : str
        Columns of one block enter or leave a model together.
    lower, upper : float
        Physical bounds of the parameter; a value outside is an alias of something else, not a finding.
    channel : Channel
    index : int or None
        Joint or link, from 0; None where the column acts on all of them or the channel has none.
    wave : Wave or None
        Its dependence on the angle of joint ``index``, where that is periodic.
    refines : bool
        Whether it only refines other columns: without them it is not the effect.
    prior_sd : float
        Standard deviation of the parameter's zero-mean prior, where the column is part of a smooth free function;
        infinite where the parameter has no prior.
    offset : array, shape (n,), or None
        Joint offset per unit [rad]; channel ``JOINT`` only.
    shift_M : array, shape (n, 3), or None
        SMR shift per unit [m] in the tracker frame; all other channels.
    """

    name: str
    unit: str
    block: str
    lower: float
    upper: float
    channel: Channel
    index: int | None = None
    wave: Wave | None = None
    refines: bool = False
    prior_sd: float = math.inf
    offset: Array | None = field(default=None, repr=False)
    shift_M: Array | None = field(default=None, repr=False)

    @property
    def joint(self) -> int | None:
        """The joint that it offsets, from 0; None for a column that shifts the SMR."""
        return self.index if self.channel is Channel.JOINT else None

    @property
    def cycles(self) -> int | None:
        """Periods per turn of the joint, where it is periodic."""
        return None if self.wave is None else self.wave.cycles

    @property
    def where(self) -> str:
        """What it acts on, for people: ``joint 2``, ``link 3``, ``all links``, ``base``, ``tool``, ``tracker``."""
        return place_name(self.channel, self.index)


def place_name(channel: Channel, index: int | None) -> str:
    """Name of what a channel acts on; ``index`` counts from 0."""
    if channel not in INDEXED_CHANNELS:
        return channel.value
    kind = "link" if channel is Channel.LINK else "joint"
    return f"all {kind}s" if index is None else f"{kind} {index + 1}"


def joint_column(
    name: str,
    unit: str,
    joint: int,
    offset: Array,
    lower: float,
    upper: float,
    block: str | None = None,
    *,
    wave: Wave | None = None,
    refines: bool = False,
    prior_sd: float = math.inf,
) -> EffectColumn:
    """A column that offsets one joint (from 0); the default block is the joint."""
    block = block or place_name(Channel.JOINT, joint)
    return EffectColumn(name, unit, block, lower, upper, Channel.JOINT, joint, wave, refines, prior_sd, offset=offset)


def shift_column(
    name: str,
    unit: str,
    channel: Channel,
    shift_M: Array,
    lower: float,
    upper: float,
    block: str | None = None,
    *,
    index: int | None = None,
    wave: Wave | None = None,
    refines: bool = False,
) -> EffectColumn:
    """A column that shifts the SMR (n, 3) [m per unit, tracker frame]; the default block is what it acts on."""
    block = block or place_name(channel, index)
    return EffectColumn(name, unit, block, lower, upper, channel, index, wave, refines, shift_M=shift_M)
