"""Evidence for a law outside the library in place of a name, if the readings are too few to search for such laws.

If the readings determine all values of a data-driven term, it competes with every name. With fewer readings nothing
else takes a name's place, and whatever looks a little like the cause is named. There the same functions in the same
channels get normal priors: their evidence needs no value to be determined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.search.channel_scan import ChannelScan, Families
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.robot.effects import EFFECTS, DriverVariable, EffectColumn
from cellapp.robot.effects.data_driven import DataChannel, channels, form_of
from cellapp.robot.effects.unknown import FunctionFamily, curve_families, own_angles, pair_families

COORDINATES_EACH = 4
"""Measured coordinates needed for each parameter of a model with a data-driven term; with fewer it could fit noise."""


def fitted_parameters(fit: JointFit) -> int:
    """Count the parameters of a model beside a data-driven term: those without priors, and all of the geometry."""
    return int(np.count_nonzero(fit.precision == 0.0)) + fit.layout.geometric


def too_few_to_compete(data: ArmData, fit: JointFit) -> bool:
    """Return whether the readings are too few for some data-driven laws of one or two joint angles."""
    most = max(Families.of(data, pair_families(data.context, own_angles(data.context))).sizes, default=0)
    return COORDINATES_EACH * (int(most) + fitted_parameters(fit)) > 3 * len(data)


def gains_by_another_cause(data: ArmData, fit: JointFit, numbers: Sequence[int]) -> list[float]:
    """Return twice the log evidence of the best law outside the library in place of each term, less the price of
    choosing.

    Laws with the term's own cause do not count: functions of variables that the effect depends on, and functions of a
    moved joint's own angle in the same channel.
    """
    context, every = data.context, channels(data.context.joints)
    families = [*curve_families(context), *pair_families(context, own_angles(context))]
    evaluated, gains = Families.of(data, families), list[float]()
    for number in numbers:
        values = ChannelScan.of(data, fit, fit.residual_without(number)).evidence(evaluated, every)
        tried = int(np.count_nonzero(np.isfinite(values)))
        values[_of_same_cause(fit.terms[number], fit.term_columns(number), every, families)] = -math.inf
        gains.append(float(values.max(initial=-math.inf)) - 2.0 * math.log(max(tried, 1)))
    return gains


def _of_same_cause(
    term: ModelTerm,
    columns: tuple[EffectColumn, ...],
    every: tuple[DataChannel, ...],
    families: list[FunctionFamily],
) -> NDArray[np.bool_]:
    """Return a mask (channels, families) of the functions that are a named effect in another shape."""
    own = EFFECTS[term.slug].variables
    moved = {(column.channel, column.index) for column in columns}
    found = np.zeros((len(every), len(families)), dtype=bool)
    for row, channel in enumerate(every):
        moves_alike = (channel.channel, channel.joint) in moved
        for place, family in enumerate(families):
            form = form_of(channel, family.drivers)
            if form.variables <= own:
                of_angles = form.variables <= {DriverVariable.JOINT_ANGLE}
                of_its_joint = all(one.joint in (None, channel.joint) for one in family.drivers)
                found[row, place] = not of_angles or (moves_alike and of_its_joint)
    return found
