"""The verb: where model and measurement disagree, which effect is missing; add it and show the gap shrink."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cellapp.calibration.calibrate import CALIBRATION_FILE, RESULT, rms_length_mm
from cellapp.calibration.cooperative import calibrate_pair
from cellapp.calibration.evaluation import evaluate, position_errors, summarise
from cellapp.calibration.identification import (
    EffectColumns,
    Identification,
    excess_variance,
    identify,
    whitener,
    with_excess,
)
from cellapp.calibration.parameters import ParameterSet
from cellapp.calibration.residual import train_network
from cellapp.calibration.setup import prior_sigmas, stated_uncertainty
from cellapp.discovery.scan import (
    Candidate,
    Score,
    Visible,
    candidate,
    complement,
    corrected_p,
    null_maxima,
    scan,
    score,
    smallest_seen,
    threshold,
    visible_part,
)
from cellapp.effects import EFFECTS, EffectColumn, EffectTerm, joint_offsets
from cellapp.errors import InputError
from cellapp.kinematics.chain import Turns, jacobian, joint_jacobian
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel, ResidualNetwork
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings, RunFile

DISCOVER_RESULT = "discover"
_MOST_EFFECTS = 4
_RIVAL = 10.0
"""Effects whose score is this near the winner's are named beside it."""
_WEIGHING_ROUNDS = 3
_CHANCE = 4.0
"""Standard errors by which a value may pass its bound: a joint that hardly feels an effect may come out negative."""
_FLOOR = 1.05
"""Held-out rms within this factor of the noise floor counts as explained."""


@dataclass(frozen=True)
class Rival:
    """Another effect that scored near the accepted one."""

    slug: str
    score: float
    told_apart: bool


@dataclass(frozen=True)
class Finding:
    """An accepted effect with its evidence."""

    term: EffectTerm
    joints: tuple[int, ...]
    score: float
    p_value: float
    heldout_before_mm: float
    heldout_after_mm: float
    rivals: tuple[Rival, ...]


@dataclass(frozen=True)
class Discovery:
    """What was found in one arm's data."""

    findings: tuple[Finding, ...]
    noise_floor_mm: float
    before_mm: float
    after_mm: float
    threshold: float
    omnibus_p: float
    invisible: tuple[Mapping[str, Any], ...]
    verdict: str
    sentence: str
    model: ArmModel
    stage: Mapping[str, Mapping[str, float | int]]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "noise_floor_mm": None if math.isnan(self.noise_floor_mm) else self.noise_floor_mm,
            "heldout_mm": {"before": self.before_mm, "after": self.after_mm},
            "threshold": self.threshold,
            "omnibus_p": None if math.isnan(self.omnibus_p) else self.omnibus_p,
            "accepted": [_finding_dict(finding) for finding in self.findings],
            "invisible": [dict(entry) for entry in self.invisible],
            "verdict": self.verdict,
            "sentence": self.sentence,
        }


def discover_run(
    run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None
) -> dict[str, Discovery]:
    """Look for missing effects in every arm of a calibrated run, add what is found to ``calibration.json``.

    Raises
    ------
    InputError
        If the run is not calibrated yet.
    """
    cancel = cancel or CancelToken()
    calibrated = run.read_result(RESULT)
    if calibrated is None:
        raise InputError(f"{run.path}: not calibrated yet; run 'cellapp calibrate' first")
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    found: dict[str, Discovery] = {}
    for done, name in enumerate(model.arms):
        listener(Progress("discover", done, len(model.arms), f"arm {name}"))
        cancel.check()
        found[name] = discover_arm(run.profile, name, model.arms[name], run.readings(name), cancel)
    result = json.loads(calibrated)
    for name, discovery in found.items():
        result["arms"][name]["validate"].pop("effects", None)
        if discovery.findings:
            result["arms"][name]["validate"]["effects"] = discovery.stage
    result["pair"].pop("effects", None)
    if any(discovery.findings for discovery in found.values()):
        readings = {name: run.readings(name) for name in found}
        pair, _ = calibrate_pair(run.profile, readings, {name: _Found(d.model) for name, d in found.items()})
        if pair is not None:
            result["pair"]["effects"] = pair.as_dict()["effects"]
            model = replace(model, T_R_L=pair.T_R_L)
    arms = {name: discovery.model for name, discovery in found.items()}
    replace(model, arms=arms).save(run.folder / CALIBRATION_FILE)
    run.write_result(RESULT, json.dumps(result))
    run.write_result(DISCOVER_RESULT, json.dumps(as_dict(found)))
    listener(Progress("discover", len(model.arms), len(model.arms), "done"))
    return found


@dataclass(frozen=True)
class _Found:
    """An arm as the pair sees it after discovery."""

    model: ArmModel
    tracker_trained: None = None


def as_dict(found: Mapping[str, Discovery]) -> dict[str, Any]:
    """The object that ``--json`` writes."""
    return {
        "schema": "cellapp-discover",
        "version": 1,
        "arms": {name: discovery.as_dict() for name, discovery in found.items()},
    }


def discover_arm(
    profile: Profile, name: str, model: ArmModel, readings: Readings, cancel: CancelToken | None = None
) -> Discovery:
    """Discover on everything but the validate split, confirm by folds of it, show the gap on the validate split."""
    cancel = cancel or CancelToken()
    held_out = readings.take(readings.in_split("validate"))
    learn = readings.take(np.concatenate([readings.in_split("identify"), readings.in_split("train")]))
    stated = _Data.of(profile, replace(model, effects=(), network=None), learn)
    data = stated.weighed(())
    fitted = data.fit(())
    first_candidates, first_basis = data.candidates(fitted), data.geometry_basis(fitted)
    first_seen = [visible_part(effect, first_basis) for effect in first_candidates]
    rng = np.random.default_rng([profile.seed, 0xD15C])
    maxima = null_maxima(first_seen, first_basis, profile.discovery.null_simulations, rng)
    least = threshold(maxima, profile.discovery.false_alarm)

    accepted: list[_Accepted] = []
    before_mm = gap = _rms_mm(data.with_terms(fitted, ()), held_out)
    while len(accepted) < _MOST_EFFECTS:
        cancel.check()
        groups = _groups(accepted)
        data = stated.weighed(groups)
        fitted = data.fit(groups)
        effects = {effect.slug: effect for effect in data.candidates(fitted)}
        basis = _extended(data.geometry_basis(fitted), [(effects[slug], picked) for slug, picked in groups])
        residual = complement(basis, data.whitened_residual(fitted))
        taken = {slug for slug, _ in groups}
        visible = {slug: visible_part(effect, basis) for slug, effect in effects.items() if slug not in taken}
        scores = scan(list(visible.values()), residual)
        possible = (_plausible(data, groups, s, visible[s.slug], residual) for s in scores if s.score > least)
        winner = next((s for s in possible if s.score > least), None)
        if winner is None or not data.confirmed(groups, (winner.slug, winner.chosen), profile.discovery.folds):
            break
        rivals = tuple(
            Rival(s.slug, s.score, _told_apart(winner, s, effects, basis, residual, least))
            for s in scores
            if s.slug != winner.slug and s.score > winner.score - _RIVAL and s.score > 0.0
        )
        new_gap = _rms_mm(data.model_with([*groups, (winner.slug, winner.chosen)]), held_out)
        accepted.append(
            _Accepted(winner.slug, winner.chosen, winner.score, corrected_p(maxima, winner.score), gap, new_gap, rivals)
        )
        gap = new_gap

    accepted = _backward(stated, accepted, least)
    groups = _groups(accepted)
    final = stated.weighed(groups).model_with(groups) if groups else model
    findings = tuple(
        Finding(
            term=term,
            joints=tuple(sorted({stated.columns[entry.slug][i].joint + 1 for i in entry.chosen})),
            score=entry.score,
            p_value=entry.p_value,
            heldout_before_mm=entry.before_mm,
            heldout_after_mm=entry.after_mm,
            rivals=entry.rivals,
        )
        for entry, term in zip(accepted, final.effects, strict=True)
    )
    floor, after = _noise_floor_mm(held_out), _rms_mm(final, held_out)
    omnibus = _omnibus(stated.fit(groups), learn)
    verdict, sentence = _judge(findings, floor, after, omnibus, stated=stated.sigma is not None)
    if findings and verdict == "unknown effect" and profile.network.kind == "mlp":
        final = replace(final, network=_network_for_the_rest(profile, final, learn, cancel))
    return Discovery(
        findings=findings,
        noise_floor_mm=floor,
        before_mm=before_mm,
        after_mm=after,
        threshold=least,
        omnibus_p=omnibus,
        invisible=_invisible(first_candidates, first_seen, {slug for slug, _ in groups}, least, data.coordinates),
        verdict=verdict,
        sentence=f"arm {name}: {sentence}",
        model=final,
        stage=evaluate(held_out.p_M, final.predict(held_out.q, held_out.approach, held_out.payload_kg)),
    )


def _network_for_the_rest(
    profile: Profile, model: ArmModel, learn: Readings, cancel: CancelToken
) -> ResidualNetwork | None:
    """A network for what the named effects leave, where it predicts readings it has not seen better than none."""
    rest_M = learn.p_M - model.predict(learn.q, learn.approach, learn.payload_kg)
    return train_network(
        learn.q,
        rest_M @ model.geometry.T_M_B()[:3, :3],
        seed=profile.seed,
        folds=profile.network.folds,
        iterations=profile.network.iterations,
        cancel=cancel,
    ).network


Group = tuple[str, tuple[int, ...]]
"""An effect's slug and the columns of it that are in a model."""


@dataclass(frozen=True)
class _Accepted:
    slug: str
    chosen: tuple[int, ...]
    score: float
    p_value: float
    before_mm: float
    after_mm: float
    rivals: tuple[Rival, ...]


def _groups(accepted: Sequence[_Accepted]) -> list[Group]:
    return [(entry.slug, entry.chosen) for entry in accepted]


@dataclass(frozen=True)
class _Data:
    """One arm's readings for discovery, with what every refit needs.

    ``sigma`` are the weights in use, ``white`` (3, 3, n) what whitens by them. The parameter set is fixed once: decided
    anew in each joint refit it would let redundant directions creep in through an effect.
    """

    profile: Profile
    model: ArmModel
    readings: Readings
    columns: Mapping[str, list[EffectColumn]]
    sigma: Array | None
    white: Array
    parameter_set: ParameterSet

    @classmethod
    def of(cls, profile: Profile, model: ArmModel, readings: Readings) -> _Data:
        """With the weights that the readings state themselves."""
        context = model.context(readings.q, readings.approach, readings.payload_kg)
        sigma = stated_uncertainty(readings)
        chosen = identify(
            model.geometry,
            readings.q,
            readings.p_M,
            parameter_set=profile.calibration.parameter_set,
            max_iterations=1,
        ).parameter_set
        columns = {slug: effect.columns(context) for slug, effect in EFFECTS.items()}
        return cls(profile, model, readings, columns, sigma, _whitening(sigma, len(readings)), chosen)

    def weighed(self, groups: Sequence[Group]) -> _Data:
        """With weights that hold what a model with ``groups`` leaves beyond the stated uncertainty."""
        if self.sigma is None:
            return self
        sigma = self.sigma
        for _ in range(_WEIGHING_ROUNDS):
            fitted = replace(self, sigma=sigma, white=_whitening(sigma, len(self.readings))).fit(groups)
            sigma = with_excess(
                self.sigma, excess_variance(fitted.residuals, self.sigma, fitted.degrees_of_freedom)
            )
        return replace(self, sigma=sigma, white=_whitening(sigma, len(self.readings)))

    @property
    def coordinates(self) -> int:
        return 3 * len(self.readings)

    def candidates(self, fitted: Identification) -> list[Candidate]:
        _, by_joint = joint_jacobian(fitted.geometry, Turns.of(self.readings.q))
        return [candidate(slug, columns, by_joint, self.white) for slug, columns in self.columns.items()]

    def geometry_basis(self, fitted: Identification) -> Array:
        """Orthonormal basis (3 n, k) of what geometry can follow."""
        _, J = jacobian(fitted.geometry, Turns.of(self.readings.q), fitted.parameter_set.columns)
        return np.asarray(np.linalg.qr(np.einsum("acn,ckn->ank", self.white, J).reshape(self.coordinates, -1))[0])

    def whitened_residual(self, fitted: Identification) -> Array:
        return np.asarray(np.einsum("acn,nc->an", self.white, fitted.residuals).ravel())

    def fit(self, groups: Sequence[Group], rows: NDArray[np.intp] | None = None) -> Identification:
        """Joint refit of geometry and the chosen columns of ``groups``, on some rows or on all."""
        chosen = np.arange(len(self.readings)) if rows is None else rows
        columns = [self.columns[slug][i] for slug, picked in groups for i in picked]
        effects = None
        if columns:
            effects = EffectColumns(
                tuple(column.name for column in columns),
                tuple(column.unit for column in columns),
                joint_offsets(columns, self.readings.joints)[:, :, chosen],
            )
        settings = self.profile.calibration
        return identify(
            self.model.geometry,
            self.readings.q[chosen],
            self.readings.p_M[chosen],
            sigma=None if self.sigma is None else self.sigma[chosen],
            parameter_set=self.parameter_set,
            prior_sigma=prior_sigmas(self.model.nominal, settings.priors),
            prior_mean=self.model.nominal,
            robust=settings.robust,
            effects=effects,
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )

    def with_terms(self, fitted: Identification, groups: Sequence[Group]) -> ArmModel:
        terms, place = [], len(fitted.parameter_set.columns)
        for slug, picked in groups:
            part = slice(place, place + len(picked))
            terms.append(
                EffectTerm(
                    slug, fitted.names[part], fitted.values[part], fitted.standard_errors[part], fitted.units[part]
                )
            )
            place += len(picked)
        return replace(
            self.model,
            geometry=fitted.geometry,
            effects=tuple(terms),
            identified=fitted.names,
            covariance=fitted.covariance,
        )

    def model_with(self, groups: Sequence[Group], rows: NDArray[np.intp] | None = None) -> ArmModel:
        return self.with_terms(self.fit(groups, rows), groups)

    def confirmed(self, groups: Sequence[Group], new: Group, folds: int) -> bool:
        """Whether the new effect lowers the squared error on readings that were left out of the fit."""
        fold = np.random.default_rng([self.profile.seed, 0xF01D]).permutation(len(self.readings)) % folds
        gain = 0.0
        for k in range(folds):
            inside, outside = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
            left_out = self.readings.take(outside)
            for sign, chosen in ((1.0, [*groups]), (-1.0, [*groups, new])):
                computed = self.model_with(chosen, inside).predict(
                    left_out.q, left_out.approach, left_out.payload_kg
                )
                off = np.einsum("acn,nc->an", self.white[:, :, outside], left_out.p_M - computed)
                gain += sign * float(np.sum(off**2))
        return gain > 0.0

    def impossible(self, groups: Sequence[Group], new: Group) -> set[int]:
        """Joints at which a refit puts the new effect outside its physical bounds by more than chance allows."""
        term = self.model_with([*groups, new]).effects[-1]
        columns = [self.columns[new[0]][i] for i in new[1]]
        return {
            column.joint
            for column, value, error in zip(columns, term.values, term.standard_errors, strict=True)
            if not column.lower - _CHANCE * error <= value <= column.upper + _CHANCE * error
        }


def _plausible(
    data: _Data, groups: Sequence[Group], found: Score, effect: Visible, residual: Array
) -> Score:
    """The score of an effect without the joints at which its values are impossible; minus infinity if none is left.

    A negative stiffness is an alias of something else at that joint, which says nothing against the effect at others.
    """
    while found.chosen and (alias := data.impossible(groups, (found.slug, found.chosen))):
        columns = data.columns[found.slug]
        blocks = tuple(block for block in effect.blocks if columns[block[0]].joint not in alias)
        effect = replace(effect, blocks=blocks)
        found = score(effect, effect.B.T @ residual, float(residual @ residual), len(residual))
    return found


def _whitening(sigma: Array | None, n: int) -> Array:
    """What turns errors of each point into units of their standard uncertainty, (3, 3, n) [1/m]."""
    if sigma is None:
        return np.ascontiguousarray(np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n)))
    white = whitener(sigma)
    return np.asarray(np.eye(3)[:, :, None] * white) if white.ndim == 1 else white


def _extended(basis: Array, groups: Sequence[tuple[Candidate, tuple[int, ...]]]) -> Array:
    """The basis with the chosen columns of accepted effects."""
    if not groups:
        return basis
    return np.asarray(np.linalg.qr(np.hstack([basis, *(effect.B[:, list(picked)] for effect, picked in groups)]))[0])


def _told_apart(
    winner: Score, rival: Score, effects: Mapping[str, Candidate], basis: Array, residual: Array, least: float
) -> bool:
    """Whether the winner still explains something after the rival has explained all it can."""
    without = _extended(basis, [(effects[rival.slug], rival.chosen)])
    left = complement(without, residual)
    visible: Visible = visible_part(effects[winner.slug], without)
    if not visible.blocks:
        return False
    return score(visible, visible.B.T @ left, float(left @ left), len(left)).score > least


def _backward(data: _Data, accepted: list[_Accepted], least: float) -> list[_Accepted]:
    """Drop effects that later ones made superfluous: without them the fit is not worse by the threshold."""
    while len(accepted) > 1:
        weighed = data.weighed(_groups(accepted))
        full = _cost(weighed, accepted)
        losses = []
        for place, entry in enumerate(accepted):
            worse = data.coordinates * math.log(_cost(weighed, accepted[:place] + accepted[place + 1 :]) / full)
            losses.append((worse - len(entry.chosen) * math.log(data.coordinates), place))
        loss, place = min(losses)
        if loss > least:
            break
        accepted = accepted[:place] + accepted[place + 1 :]
    return accepted


def _cost(data: _Data, accepted: Sequence[_Accepted]) -> float:
    residual = data.whitened_residual(data.fit(_groups(accepted)))
    return float(residual @ residual)


def _rms_mm(model: ArmModel, held_out: Readings) -> float:
    computed = model.predict(held_out.q, held_out.approach, held_out.payload_kg)
    return summarise(position_errors(held_out.p_M, computed)).rms


def _noise_floor_mm(readings: Readings) -> float:
    """Root mean square length of the stated noise; NaN where the readings state none."""
    sigma = stated_uncertainty(readings)
    return math.nan if sigma is None else rms_length_mm(sigma)


def _omnibus(fitted: Identification, readings: Readings) -> float:
    """Probability of a scatter at least this large if the stated noise were all there is; NaN without stated noise."""
    if stated_uncertainty(readings) is None:
        return math.nan
    return float(chi2.sf(fitted.scale**2 * fitted.degrees_of_freedom, fitted.degrees_of_freedom))


def _invisible(
    effects: Sequence[Candidate],
    seen: Sequence[Visible],
    found: set[str],
    least: float,
    coordinates: int,
) -> tuple[Mapping[str, Any], ...]:
    entries: list[Mapping[str, Any]] = []
    by_slug = {effect.slug: (effect, part) for effect, part in zip(effects, seen)}
    for slug in EFFECTS:
        if slug in found:
            continue
        effect, part = by_slug[slug]
        if not part.blocks:
            reason = "these data cannot show it: what it depends on is not known or never varied"
            entries.append({"effect": slug, "reason": reason, "smallest_seen": None})
            continue
        sizes = smallest_seen(part, least, coordinates)
        entries.append(
            {
                "effect": slug,
                "reason": "not found; it could have been seen from these sizes on",
                "smallest_seen": {
                    effect.columns[i].name: {
                        "value": size if math.isfinite(size) else None,
                        "unit": effect.columns[i].unit,
                    }
                    for i, size in sizes.items()
                },
            }
        )
    return tuple(entries)


def _judge(
    findings: Sequence[Finding], floor: float, after: float, omnibus: float, *, stated: bool
) -> tuple[str, str]:
    names = " and ".join(EFFECTS[finding.term.slug].title for finding in findings)
    if not stated:
        left = "the readings state no uncertainty, so nothing can be said of what is left"
        return ("explained", f"{names}; {left}") if findings else ("nothing missing", f"nothing found; {left}")
    at_floor = after <= floor * _FLOOR or omnibus > 0.01
    gap = f"{after * 1e3:.0f} um rms held out against a noise floor of {floor * 1e3:.0f} um"
    doubt = any(not rival.told_apart for finding in findings for rival in finding.rivals)
    if not at_floor:
        found = f"{names} found{' (or a look-alike)' if doubt else ''}, but " if findings else ""
        return "unknown effect", f"{found}more is missing than the library knows; {gap}"
    if doubt:
        return "ambiguous", f"{names}, but these data do not tell it from its rivals; {gap}"
    return ("explained", f"{names}; {gap}") if findings else ("nothing missing", gap)


def _finding_dict(finding: Finding) -> dict[str, Any]:
    term = finding.term
    return {
        "effect": term.slug,
        "where": {"joints": list(finding.joints)},
        "parameters": {
            name: {"value": value, "standard_error": error, "unit": unit}
            for name, value, error, unit in zip(
                term.names, term.values.tolist(), term.standard_errors.tolist(), term.units, strict=True
            )
        },
        "evidence": {
            "statistic": finding.score,
            "corrected_p": finding.p_value,
            "heldout_mm": {"before": finding.heldout_before_mm, "after": finding.heldout_after_mm},
        },
        "runners_up": [
            {"effect": rival.slug, "statistic": rival.score, "told_apart": rival.told_apart}
            for rival in finding.rivals
        ],
    }
