"""The effect ``hose_pull``: a hose package that becomes taut pulls joints back."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects import (
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
)

SLACK = Constant("slack", "rad", SCALED, "taut beyond {} deg", factor=180.0 / np.pi)
"""A constant enters the law in a non-linear way; the search tunes it, here by factors."""
TAUT = LawForm("taut", "in proportion to the angle beyond the slack", (SLACK,))
TRIED_RAD = (0.6, 1.0, 1.6)
"""Where the search for the slack begins."""
MOST = 1e-2
"""Physical bound of the parameter [rad/rad]: a hose that gives way less than this breaks."""


class HosePull(Effect):
    """``dq_j = -a_j sign(q_j) max(|q_j| - s, 0)``: a spring that begins to pull when the slack s is used up."""

    slug = "hose_pull"
    title = "pull of the hose package"
    meaning = Meaning(
        cause="The hose package at {place} is too short: it becomes taut and pulls the joint back.",
        size="0.1 to 0.5 mrad for each radian beyond",
        size_source="estimate",
        check=("Turn {place} to both ends of its range, and look whether the hose becomes taut.",),
        settle=("Measure {place} near both ends of its range.",),
    )
    look_alikes = ("transmission_error",)
    variables = frozenset({DriverVariable.JOINT_ANGLE})
    forms = (TAUT,)

    def missing_data(self, context: EffectContext) -> str:
        """Needs joints far from zero."""
        return "" if np.abs(context.q).max() > TRIED_RAD[0] else "no joint turns far enough to stretch a hose"

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each slack to begin with; ``tried`` is what choosing one of them costs."""
        return [TAUT.law({SLACK.name: slack}, tried=len(TRIED_RAD)) for slack in TRIED_RAD]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint: the offset [rad] per unit of its parameter, at all configurations at once."""
        beyond = np.maximum(np.abs(context.q) - law.constants[SLACK.name], 0.0)
        offset = -np.sign(context.q) * beyond
        return [joint_column(f"pull{j + 1}", "rad/rad", j, offset[:, j], 0.0, MOST) for j in range(context.joints)]
