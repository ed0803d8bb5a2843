"""Read the record of one run: only what a comparison of many runs needs. Never changes the run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from cellapp.cell.run.arm_identity import ArmIdentity, arm_identities
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.sqlite_file import FILE_NAME
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.basis import counted_basis
from cellapp.commands.run_results import UNREADABLE
from cellapp.commands.stages import RunStages, StoredStage, read_history, read_stages
from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult, PairMethodResult
from cellapp.estimation.discovery.records import AcceptedEffect, ArmDiscoveryResult, DiscoverResult, Place
from cellapp.estimation.iso9283.norm import ISO_COMMANDS
from cellapp.estimation.iso9283.records import Iso9283Result, IsoValue
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.estimation.monitoring.fleet.record import ArmRecord, EffectRecord, GeometryRecord, RunRecord
from cellapp.estimation.monitoring.fleet.records import CheckPoint, DatedValue, Figure, IsoPoint
from cellapp.ground.errors import CellappError
from cellapp.ground.profile import Arm
from cellapp.ground.results import (
    CALIBRATE,
    CHECK,
    DISCOVER,
    ISO9283,
    STAGES,
    VERIFY,
    ErrorSummary,
    Estimate,
    Method,
    StageName,
)
from cellapp.robot.kinematics.chain import JointAngles, all_names, jacobian
from cellapp.robot.model.nominal import nominal_arm

_LEVER_CONFIGURATIONS = 64
"""Number of configurations to average the displacement by a parameter: its rms is known to a tenth."""

P = TypeVar("P", bound=BaseModel)


def read_record(folder: Path) -> RunRecord:
    """Return the record of one run; if the run cannot be read, it states the problem."""
    try:
        with RunFile.peek(folder) as run:
            return _Reader(run, read_stages(run, counted_basis)).record()
    except CellappError as error:
        return RunRecord(run=str(folder), problem=str(error))
    except (OSError, ValueError, TypeError, KeyError) as error:  # a damaged or foreign file may contain anything
        words = str(error).partition("\n")[0] or type(error).__name__
        return RunRecord(
            run=str(folder),
            problem=f"{folder / FILE_NAME} holds values that this cellapp cannot read ({words}); open it with the"
            " cellapp that wrote it, or restore it from a copy",
        )


class _Parameters(BaseModel):
    """Parameters of a chain [m, rad]."""

    parameters: Mapping[str, float]


class _Term(BaseModel):
    """An effect of a model."""

    effect: str
    parameters: Mapping[str, Estimate]


class ModelArm(BaseModel):
    """One arm of a stored model, of whatever effects; ``covariance`` (p, p) is of ``identified``, geometry first."""

    geometry: _Parameters
    nominal: _Parameters
    identified: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...] | None = None
    effects: tuple[_Term, ...] = ()


class Model(BaseModel):
    """A stored model."""

    arms: Mapping[str, ModelArm]


@dataclass
class _Reader:
    """Reader of one open run; ``notes`` say what cannot be used and why."""

    run: RunFile
    stages: RunStages
    notes: list[str] = field(default_factory=list)

    def record(self) -> RunRecord:
        sessions = self.run.sessions()
        began = sessions[0].began if sessions else self.run.created or _changed(self.run.path)
        stored = self._stored()
        identities, folder = arm_identities(self.run), str(self.run.folder)
        tolerance = self.run.profile.tolerances.position
        self._note_outdated()
        return RunRecord(
            run=folder,
            profile=self.run.profile.name,
            began=began,
            stage=None if self.stages.in_force is None or stored.model is None else self.stages.in_force.name,
            arms={
                name: _ArmParts(name, settings, identities[name], stored, folder, began).record()
                for name, settings in self.run.profile.arms.items()
            },
            transforms=_transforms(stored),
            tolerance_mm=None if tolerance is None else tolerance * 1e3,
            alone=not any(stage.basis is not None and stage.basis.priors for stage in self.stages.current.values()),
            notes=tuple(self.notes),
        )

    def _stored(self) -> _Stored:
        holds = DISCOVER not in self.stages.out_of_date
        return _Stored(
            calibrated=self._current(CALIBRATE, CalibrateResult),
            searched=self._current(DISCOVER, DiscoverResult) if holds else None,
            model=self._model(),
            dated=self._dated(),
            temperatures=self.run.mean_temperatures(),
        )

    def _note_outdated(self) -> None:
        for name in (CALIBRATE, DISCOVER, VERIFY):
            if (reason := self.stages.out_of_date.get(name)) is not None:
                self.notes.append(f"'{name}' is out of date ({reason})")
        if CALIBRATE not in self.stages.current:
            self.notes.append("is not calibrated")

    def _current(self, name: StageName, kind: type[P]) -> P | None:
        stage = self.stages.current.get(name)
        return None if stage is None else self._parsed(stage, stage.text, kind)

    def _model(self) -> Model | None:
        """Return the model in force; None if its arms no longer follow from the readings."""
        stage = self.stages.in_force
        if stage is None or stage.model is None or self.stages.stale_arms():
            return None
        return self._parsed(stage, stage.model, Model)

    def _parsed(self, stage: StoredStage, text: str, kind: type[P]) -> P | None:
        try:
            return kind.model_validate_json(text, extra="ignore")  # ignore keys of other versions
        except ValidationError:
            self.notes.append(f"'{stage.name}' cannot be used: {UNREADABLE}")
            return None

    def _dated(self) -> _Dated:
        """Return all measurements with a model of this run, each at its own time."""
        found = _Dated(str(self.run.folder))
        for stage in read_history(self.run):
            if stage.name == VERIFY and (verified := self._parsed(stage, stage.text, VerifyResult)):
                found.verified.append((stage.written, verified))
            elif stage.name == CHECK and (checked := self._parsed(stage, stage.text, CheckResult)):
                found.checked.append((stage.written, checked))
            elif stage.name == ISO9283 and (tested := self._parsed(stage, stage.text, Iso9283Result)):
                found.tested.append((stage.written, tested))
        return found


@dataclass
class _Dated:
    """Verifications, checks and tests of a run with the times when they were stored."""

    run: str
    verified: list[tuple[str, VerifyResult]] = field(default_factory=list)
    checked: list[tuple[str, CheckResult]] = field(default_factory=list)
    tested: list[tuple[str, Iso9283Result]] = field(default_factory=list)

    def figures(self, arm: str) -> dict[Figure, tuple[DatedValue, ...]]:
        verified = tuple(
            DatedValue(run=self.run, time=time, value=(own.corrected_mm or own.compensated_mm).max)
            for time, one in self.verified
            if (own := one.arms.get(arm)) is not None
        )
        checks = tuple(
            DatedValue(run=self.run, time=time, value=part.rms_mm, standard_error=_rms_error(part.rms_mm, part.stops))
            for time, one in self.checked
            if (part := one.arms.get(arm)) is not None and part.rms_mm is not None
        )
        poses = list(self._poses(arm))
        found: dict[Figure, tuple[DatedValue, ...]] = {
            "verified": verified,
            "check": checks,
            "pose_accuracy": tuple(accuracy for accuracy, _ in poses),
            "pose_repeatability": tuple(repeatability for _, repeatability in poses),
        }
        return {figure: values for figure, values in found.items() if values}

    def _poses(self, arm: str) -> Iterator[tuple[DatedValue, DatedValue]]:
        """Yield the largest AP and RP of each test, with calibrated commands if those were tested."""
        for time, one in self.tested:
            tests = one.arms[arm].tests if arm in one.arms else {}
            kind = next((kind for kind in reversed(ISO_COMMANDS) if kind in tests and tests[kind].pose), None)
            if kind is not None:
                poses = tests[kind].pose
                yield (
                    self._largest(time, [pose.accuracy for pose in poses]),
                    self._largest(time, [pose.repeatability for pose in poses]),
                )

    def _largest(self, time: str, values: Sequence[IsoValue]) -> DatedValue:
        worst = max(values, key=lambda one: one.value_mm)
        standard_error = None if worst.expanded_mm is None else worst.expanded_mm / 2.0
        return DatedValue(run=self.run, time=time, value=worst.value_mm, standard_error=standard_error)

    def checks(self, arm: str) -> tuple[CheckPoint, ...]:
        return tuple(
            CheckPoint(
                run=self.run,
                time=time,
                verdict=one.verdict,
                rms_mm=one.arms[arm].rms_mm,
                changes=tuple(change.what for change in one.changes if change.arm == arm),
            )
            for time, one in self.checked
            if arm in one.arms
        )

    def iso9283(self, arm: str) -> tuple[IsoPoint, ...]:
        return tuple(
            IsoPoint.like(judgement, run=self.run, time=time)
            for time, one in self.tested
            for judgement in one.judgements
            if judgement.where == arm
        )


@dataclass(frozen=True)
class _Stored:
    """Results of a run for all arms; None if a stage is missing or no longer holds."""

    calibrated: CalibrateResult | None
    searched: DiscoverResult | None
    model: Model | None
    dated: _Dated
    temperatures: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class _ArmParts:
    """Results of a run for one arm."""

    name: str
    settings: Arm
    identity: ArmIdentity
    stored: _Stored
    run: str
    began: str

    @property
    def calibrated(self) -> ArmCalibrationResult | None:
        return None if self.stored.calibrated is None else self.stored.calibrated.arms.get(self.name)

    @property
    def searched(self) -> ArmDiscoveryResult | None:
        return None if self.stored.searched is None else self.stored.searched.arms.get(self.name)

    @property
    def model(self) -> ModelArm | None:
        return None if self.stored.model is None else self.stored.model.arms.get(self.name)

    def record(self) -> ArmRecord:
        searched, errors = self.searched, self._best_errors()
        return ArmRecord(
            type=self.settings.type.model,
            key=self.identity.key,
            known_by=self.identity.known_by,
            serial=self.identity.serial,
            geometry=self._geometry(),
            effects=self._effects(),
            smallest={} if searched is None else _smallest(searched),
            unseen=() if searched is None else tuple(one.effect for one in searched.invisible),
            heldout_rms_mm=None if errors is None else errors.rms,
            heldout_n=0 if errors is None else errors.n,
            temperatures_c=self._temperatures(),
            figures={**dict(self._figures(errors)), **self.stored.dated.figures(self.name)},
            checks=self.stored.dated.checks(self.name),
            iso9283=self.stored.dated.iso9283(self.name),
        )

    def _geometry(self) -> GeometryRecord | None:
        model, calibrated = self.model, self.calibrated
        if model is None or calibrated is None or model.covariance is None:
            return None
        names = [name for name in model.identified if name in model.geometry.parameters]
        k = len(names)
        if list(model.identified[:k]) != names or len(model.covariance) < k:
            return None
        return GeometryRecord(
            values={name: model.geometry.parameters[name] for name in names},
            nominal={name: model.nominal.parameters[name] for name in names},
            covariance=tuple(value for row in range(k) for value in model.covariance[row][: row + 1]),
            merged=calibrated.merged,
            determined=tuple(name for name in calibrated.identified if name in names),
            levers=levers(self.settings, names),
            degrees_of_freedom=calibrated.degrees_of_freedom,
        )

    def _effects(self) -> tuple[EffectRecord, ...] | None:
        if self.searched is not None:
            n = next((errors.position_mm.n for errors in self.searched.validate_.values()), 0)
            return tuple(_accepted(one, n) for one in self.searched.accepted)
        return _carried_over(self.model) if self.model is not None and self.model.effects else None

    def _best_errors(self) -> ErrorSummary | None:
        """Return the held-out errors of the last model that still holds; None without one."""
        if self.calibrated is None or self.model is None:
            return None
        found = dict(self.calibrated.validate_)
        if self.calibrated.prior is None:
            found.pop("effects", None)  # older versions stored it in the calibration
        if self.searched is not None:
            found |= self.searched.validate_
        best = next((stage for stage in reversed(STAGES) if stage in found), None)
        return None if best is None else found[best].position_mm

    def _figures(self, errors: ErrorSummary | None) -> Iterator[tuple[Figure, tuple[DatedValue, ...]]]:
        if errors is not None:
            standard_error = errors.std / math.sqrt(errors.n) if errors.n > 1 else None
            yield "heldout", (self._dated(errors.mean, standard_error),)
        if self.searched is not None and self.searched.noise_mm is not None:
            yield "noise", (self._dated(self.searched.noise_mm.rms),)
        if self.calibrated is not None and self.calibrated.repeatability_mm is not None:
            yield "repeatability", (self._dated(self.calibrated.repeatability_mm.rp),)
        if (air := self._temperatures().get("air")) is not None:
            yield "temperature", (self._dated(air),)

    def _temperatures(self) -> Mapping[str, float]:
        return self.stored.temperatures.get(self.name, {})

    def _dated(self, value: float, standard_error: float | None = None) -> DatedValue:
        return DatedValue(run=self.run, time=self.began, value=value, standard_error=standard_error)


def _changed(path: Path) -> str:
    """Return when a file last changed (ISO 8601, UTC): for runs that do not state when they were made."""
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="milliseconds")


def levers(arm: Arm, names: list[str]) -> dict[str, float]:
    """Compute the rms SMR displacement [m] by one unit of each parameter of the nominal arm, over all joint angles."""
    geometry = nominal_arm(arm)
    joints = len(arm.type.joints)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_LEVER_CONFIGURATIONS, joints))
    columns = tuple(all_names(joints).index(name) for name in names)
    _, J = jacobian(geometry, JointAngles.of(q), columns)
    return dict(zip(names, np.sqrt(np.mean(np.sum(J**2, axis=0), axis=1)).tolist(), strict=True))


def _accepted(one: AcceptedEffect, n: int) -> EffectRecord:
    removed = one.evidence.heldout_mm.before**2 - one.evidence.heldout_mm.after**2
    free = one.description is not None or one.where.channel is not None
    return EffectRecord.like(one, parameters={} if free else one.parameters, size_mm=math.sqrt(max(removed, 0.0)), n=n)


def _carried_over(model: ModelArm) -> tuple[EffectRecord, ...]:
    """Return the effects that a calibration took over from its prior."""
    return tuple(
        EffectRecord(
            effect=term.effect,
            title=term.effect.replace("_", " "),
            where=Place(joints=(), acts_on=()),
            parameters=term.parameters,
        )
        for term in model.effects
    )


def _smallest(searched: ArmDiscoveryResult) -> dict[str, dict[str, float]]:
    return {
        absent.effect: {name: size.value for name, size in (absent.smallest_seen or {}).items()}
        for absent in searched.not_found
    }


def _transforms(stored: _Stored) -> dict[Method, dict[str, Estimate]]:
    pairs: dict[Method, PairMethodResult] = {}
    for made in (stored.calibrated, stored.searched):
        pairs |= {} if made is None else made.pair
    return {
        method: {name: Estimate.like(one) for name, one in pair.identified.items()}
        for method, pair in pairs.items()
        if pair.identified
    }


def _rms_error(rms: float, stops: int) -> float | None:
    """Return the standard error of an rms length over 3 ``stops`` normal coordinates: rms / sqrt(2 n) for n of them."""
    return rms / math.sqrt(6.0 * stops) if stops else None
