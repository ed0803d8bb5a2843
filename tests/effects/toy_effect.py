"""An effect that the library does not have, as a developer would add it: one file, registered by one line."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects import (
    SCALED,
    Constant,
    DriverVariable,
    Effect,
    EffectColumn,
    EffectContext,
    Law,
    LawForm,
    Meaning,
    joint_column,
    varies,
)

SOFTENING = Constant("softening", "kg", SCALED, "softening from {} kg on")
FORM = LawForm("softening", "with three times the joint angle and the payload, less and less", (SOFTENING,))
GRID = (0.4, 1.6, 6.4)


class ToySag(Effect):
    """``dq_j = a_j tanh(m cos(3 q_j) / s)``, m the payload and s the softening, which is tuned."""

    slug = "toy_sag"
    title = "toy sag of joints"
    meaning = Meaning(
        cause="The toy at {place} sags.",
        size="100 um",
        size_source="estimate",
        check=("Check the toy.",),
        settle=("Add payloads.",),
    )
    variables = frozenset({DriverVariable.JOINT_ANGLE, DriverVariable.PAYLOAD})
    forms = (FORM,)

    def missing_data(self, context: EffectContext) -> str:
        """Needs a payload that varies."""
        return "" if varies(context.conditions.payload_kg) else "payload does not vary"

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each softening to try."""
        return [FORM.law({SOFTENING.name: size}, len(GRID)) for size in GRID]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint."""
        load = context.payload_kg[:, None] * np.cos(3.0 * context.q)
        sag = np.tanh(load / law.constants[SOFTENING.name])
        return [joint_column(f"sag{j + 1}", "rad", j, sag[:, j], -1e-2, 1e-2) for j in range(context.joints)]
