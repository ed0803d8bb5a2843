"""The few figures of stored results for a list of runs, read without the rest of each result.

Results have curves, pictures and errors of every stop; reading all of that for a hundred runs takes seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellapp.commands.run_results import UNREADABLE
from cellapp.commands.runs.result import ArmFigures
from cellapp.commands.stages import RunStages
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.results import CALIBRATE, DISCOVER, STAGES, VERIFY, Stage, StageName, Verdict


class _Part(BaseModel):
    """A part of a stored result; keys that it does not name are passed over."""

    model_config = ConfigDict(extra="ignore", frozen=True)


P = TypeVar("P", bound=_Part)


class _Mean(_Part):
    mean: float | None


class _Errors(_Part):
    position_mm: _Mean


class _Prior(_Part):
    run: str


class _CalibratedArm(_Part):
    errors: Mapping[Stage, _Errors] = Field(default={}, alias="validate")
    prior: _Prior | None = None


class _Calibrated(_Part):
    arms: Mapping[str, _CalibratedArm]


class _Accepted(_Part):
    effect: str


class _SearchedArm(_CalibratedArm):
    verdict: Verdict
    accepted: tuple[_Accepted, ...]


class _Searched(_Part):
    arms: Mapping[str, _SearchedArm]


class _VerifiedArm(_Part):
    nominal_mm: _Mean
    compensated_mm: _Mean


class _Verified(_Part):
    arms: Mapping[str, _VerifiedArm]


def run_figures(stages: RunStages) -> tuple[dict[str, ArmFigures], dict[StageName, str]]:
    """Return the figures of each arm, and the unreadable stages with the reason."""
    unreadable: dict[StageName, str] = {}

    def read(name: StageName, kind: type[P]) -> P | None:
        stage = stages.current.get(name)
        try:
            return None if stage is None else kind.model_validate_json(stage.text)
        except ValidationError:
            unreadable[name] = UNREADABLE
            return None

    calibrated, searched, verified = read(CALIBRATE, _Calibrated), read(DISCOVER, _Searched), read(VERIFY, _Verified)
    names = [*(calibrated.arms if calibrated else ()), *(verified.arms if verified else ())]
    figures = {}
    for name in dict.fromkeys(names):
        arm = calibrated.arms.get(name) if calibrated else None
        found = searched.arms.get(name) if searched else None
        reached = verified.arms.get(name) if verified else None
        errors: dict[Stage, _Errors] = {} if arm is None else {**arm.errors}
        if arm is None or arm.prior is None:
            errors.pop("effects", None)  # older versions stored it in the calibration
        if found is not None and DISCOVER not in stages.out_of_date:
            errors |= found.errors
        best = next((stage for stage in reversed(STAGES) if stage in errors), None)
        figures[name] = ArmFigures(
            heldout_mm=None if best is None else _before_after(errors.get("geometry"), errors[best]),
            best_stage=best,
            verdict=None if found is None else found.verdict,
            effects=() if found is None else tuple(dict.fromkeys(effect.effect for effect in found.accepted)),
            verified_mm=None if reached is None else _means(reached.nominal_mm, reached.compensated_mm),
        )
    return figures, unreadable


def _before_after(geometry: _Errors | None, best: _Errors) -> BeforeAfter | None:
    return None if geometry is None else _means(geometry.position_mm, best.position_mm)


def _means(before: _Mean, after: _Mean) -> BeforeAfter | None:
    if before.mean is None or after.mean is None:
        return None
    return BeforeAfter(before=before.mean, after=after.mean)
