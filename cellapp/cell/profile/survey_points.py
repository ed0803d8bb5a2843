"""Points that determine the pose of a base: each is known in the tracker frame M and at the arm."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from cellapp.ground.profile.schema import CellPoint
from cellapp.ground.profile.sections import ArmPoint
from drivers.quantities import Turn
from drivers.settings import Section


class SurveyPoint(Section):
    """One point: ``tracker`` in M, and either ``base`` in the base frame B or the ``joints`` with the SMR there."""

    tracker: CellPoint
    base: ArmPoint | None = None
    joints: tuple[Turn, ...] | None = None

    @model_validator(mode="after")
    def _known_at_the_arm(self) -> Self:
        if (self.base is None) == (self.joints is None):
            raise ValueError(
                "give 'base' (coordinates in the base frame) or 'joints' (joint positions), one of the two"
            )
        return self
