"""Every data-driven law that the data at hand allow; discovery makes them from their families one by one."""

from __future__ import annotations

from collections.abc import Collection

from cellapp.robot.effects import EffectContext, Law
from cellapp.robot.effects.data_driven import DataChannel, Variable, channels
from cellapp.robot.effects.unknown import PAIR_ORDER, curve_families, pair_families


def curve_laws(context: EffectContext) -> list[Law]:
    """Laws of all functions of one variable, in every channel."""
    families = curve_families(context)
    return [family.law(channel) for channel in channels(context.joints) for family in families]


def pair_laws(context: EffectContext, channel: DataChannel, among: Collection[Variable] | None = None) -> list[Law]:
    """Laws of all functions of two variables, of those ``among`` them if given, in one channel."""
    return [family.law(channel) for family in pair_families(context, among, (PAIR_ORDER,))]
