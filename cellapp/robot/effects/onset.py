"""What effects have in common that begin at an onset, which is searched between readings."""

from __future__ import annotations

from cellapp.robot.effects.context import EffectContext
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect
from cellapp.robot.effects.law import DriverVariable, Law
from cellapp.robot.effects.modulation import FreeDriver
from cellapp.robot.effects.time_functions import ONSET_FORM, ONSET_MARGIN, onset_laws, times_known


class OnsetEffect(Effect):
    """An effect that is there from an onset on, which is searched between readings."""

    variables = frozenset({DriverVariable.TIME})
    forms = (ONSET_FORM,)
    free_drivers = (FreeDriver(Quantity.TIME),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs times."""
        if not times_known(context):
            return "no times"
        return "" if onset_laws(context) else f"fewer than {2 * ONSET_MARGIN} readings"

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each onset."""
        return onset_laws(context)
