"""Outcome of discovery: the stored result, and the model with the accepted effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellapp.estimation.calibration.pair_calibration import PairCalibration
from cellapp.estimation.discovery.held_out import HeldOut
from cellapp.estimation.discovery.records import ArmDiscoveryResult, BeforeAfter, HeldOutBeforeAfter
from cellapp.robot.effects import EffectTerm
from cellapp.robot.model import ArmModel, CellModel


@dataclass(frozen=True)
class Discovery:
    """Outcome of discovery in one arm's data.

    Attributes
    ----------
    result : ArmDiscoveryResult
        Accepted effects with their evidence, errors, tests of the residuals, and the verdict.
    terms : tuple of EffectTerm
        Terms of the accepted effects, in the same order.
    model : ArmModel
        The arm with these terms.
    scatter_m : float
        Standard deviation of a coordinate beyond the stated uncertainty in the final model [m].
    """

    result: ArmDiscoveryResult
    terms: tuple[EffectTerm, ...]
    model: ArmModel
    scatter_m: float = 0.0

    def with_model(self, model: ArmModel, held_out: HeldOut, **changes: Any) -> Discovery:
        """Return the outcome with another final model, its errors on held-out readings, and changes of the result."""
        result = self.result
        before, after = result.heldout_position_mm, held_out.position_mm(model)
        turned, turned_after = result.heldout_orientation_mrad, held_out.orientation_mrad(model)
        errors: dict[str, Any] = {
            "heldout_mm": BeforeAfter(before=result.heldout_mm.before, after=after.rms),
            "heldout_position_mm": None if before is None else HeldOutBeforeAfter(before=before.before, after=after),
            "validate_": {"effects": held_out.evaluate(model)} if result.accepted else {},
        }
        if turned is not None and turned_after is not None:
            errors["heldout_orientation_mrad"] = HeldOutBeforeAfter(before=turned.before, after=turned_after)
        return Discovery(result.model_copy(update={**errors, **changes}), self.terms, model, self.scatter_m)


@dataclass(frozen=True)
class CellDiscovery:
    """Outcome of discovery in the data of every arm.

    ``model`` is the cell with the accepted effects; ``pair`` the cooperative errors with them, None if no effect was
    accepted or there is no pair.
    """

    arms: Mapping[str, Discovery]
    model: CellModel
    pair: PairCalibration | None
