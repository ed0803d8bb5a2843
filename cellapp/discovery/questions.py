"""What further stops shall tell: one effect from another, or an effect from none; as contests over candidates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cellapp.calibration.curves import Curves
from cellapp.design.discrimination import Contest
from cellapp.discovery.data import ArmData, Choice, Fit, Part, whitening
from cellapp.discovery.scan import VISIBLE, Seen, displacements, explained_by
from cellapp.discovery.search import UNKNOWN
from cellapp.effects import EFFECTS, Circumstances, EffectColumn, EffectContext, EffectTerm, Law
from cellapp.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.kinematics.transforms import Array

if TYPE_CHECKING:
    from cellapp.discovery.discover import Discovery

_MOST_COLUMNS = 40
_MOST_LAWS = 4
_MOST_UNSEEN = 3
_CURABLE = frozenset({"approach", "step", "dwell", "other_arm"})
"""What the factors of further stops can make vary where a run did not."""
_JOINED = 200


@dataclass(frozen=True, eq=False)
class There:
    """Further stops (m of them) as one fitted model sees them: whitening (3, 3, m), derivatives by the joints and by
    what of the geometry was fitted, both whitened, (3, N, m) and (p, 3 m)."""

    context: EffectContext
    white: Array
    by_joint: Array
    geometric: Array

    @classmethod
    def of(cls, data: ArmData, fit: Fit, q: Array, known: Circumstances) -> There:
        """At configurations ``q`` (m, N) in the circumstances ``known``."""
        model, found = fit.model, fit.identification
        stands = model.true_joints(q, known=known) if model.effects else None
        context = replace(model.context(q, known=known), stands=stands)
        white = whitening(_expected_sigma(data, context), len(q))
        turns = JointAngles.of(q)
        columns = found.parameter_set.columns
        J = jacobian(found.geometry, turns, columns)[1]
        by_joint = np.einsum("acn,cjn->ajn", white, joint_jacobian(found.geometry, turns)[1])
        geometric = np.einsum("acn,ckn->kan", white, J).reshape(len(columns), -1)
        return cls(context, white, by_joint, geometric)

    def columns(self, slug: str, law: Law, names: Sequence[str]) -> Array:
        """Whitened columns (k, 3 m) of a law."""
        found = {column.name: column for column in EFFECTS[slug].columns(self.context, law, frozenset(names))}
        return displacements([found[name] for name in names], self.by_joint, self.white)

    def by_stop(self, rows: Array) -> Array:
        """Rows (p, 3 m), coordinate by coordinate, stop by stop: (p, m, 3)."""
        return rows.reshape(len(rows), 3, -1).transpose(0, 2, 1)


def _expected_sigma(data: ArmData, context: EffectContext) -> Array | None:
    """The uncertainty of further readings: the run's mean one along the beam and across it, turned their way."""
    sigma = data.sigma
    if sigma is None:
        return None
    if sigma.ndim == 1:
        return np.full(len(context), float(np.sqrt(np.mean(sigma**2))))
    frame = _beam_frame(data.context)
    variances = np.mean(np.einsum("nac,nab,nbc->nc", frame, sigma, frame), axis=0)
    frame = _beam_frame(context)
    return np.asarray(np.einsum("nac,c,nbc->nab", frame, variances, frame))


def _beam_frame(context: EffectContext) -> Array:
    """Along the beam, level across it and upward across it as columns, (n, 3, 3)."""
    _, beam = context.beam
    _, _, horizontal, upward = context.across
    return np.stack([beam, horizontal, upward], axis=2)


@dataclass(frozen=True, eq=False)
class Question:
    """Can ``effect`` be told from ``against`` (empty: from nothing at all)?

    ``values`` (k, c) times the columns ``names`` of ``law`` are the signals; ``place`` is the effect's part in ``fit``,
    None where it is no part of it; ``rivals`` are the laws of the other effect with their columns, each of which may
    stand for it; ``needed`` is the lambda from which the answer is clear.
    """

    effect: str
    against: str
    needed: float
    data: ArmData
    fit: Fit
    place: int | None
    law: Law
    names: tuple[str, ...]
    values: Array
    rivals: tuple[tuple[Law, tuple[str, ...]], ...] = ()

    @property
    def variables(self) -> frozenset[str]:
        """All that the models of either side depend on."""
        slugs = [self.effect, *(part.slug for part in self.fit.choice), *([self.against] if self.against else [])]
        return frozenset().union(*(EFFECTS[slug].variables for slug in slugs))

    def contests(self, there: There) -> list[Contest]:
        """One contest for each law of the rival."""
        data, fit = self.data, self.fit
        kept = np.ones(len(fit.rows), dtype=bool)
        further = [there.geometric]
        place = len(fit.rows) - len(fit.columns)
        for number, part in enumerate(fit.choice):
            if number == self.place:
                kept[place : place + len(part.names)] = False
            else:
                further.append(there.columns(part.slug, part.law, part.names))
            place += len(part.names)
        rows, precision = fit.rows[kept], fit.precision[kept]
        own = data.columns(self.effect, self.law, self.names)
        signals = self.values @ displacements(own, fit.by_joint, fit.white)
        signals_there = there.by_stop(self.values @ there.columns(self.effect, self.law, self.names))
        found = []
        for law, names in self.rivals or ((Law(), ()),):
            columns = data.columns(self.against, law, names) if names else []
            more = [there.columns(self.against, law, names)] if names else []
            found.append(
                Contest(
                    rows=np.concatenate([rows, displacements(columns, fit.by_joint, fit.white)]),
                    precision=np.concatenate([precision, [_loose(column) for column in columns]]),
                    signals=signals,
                    stops=there.by_stop(np.concatenate([*further, *more])),
                    there=signals_there,
                )
            )
        return found


def _loose(column: EffectColumn) -> float:
    """Precision of the belief that a parameter is not beyond its physical bounds."""
    bound = max(abs(column.lower), abs(column.upper))
    return 1.0 / bound**2 if math.isfinite(bound) and bound > 0.0 else 0.0


def fitted(data: ArmData, terms: Sequence[EffectTerm], scatter: float) -> tuple[ArmData, Fit]:
    """The fit of what discovery accepted, with its weights, as its search left it.

    ``scatter`` is that of the search: the noise that goes with the prior of free curves.
    """
    choice: Choice = tuple(
        Part(term.slug, term.law, term.names, _curves(term, scatter), note=term.note) for term in terms
    )
    here = data.weighed(choice)
    fit = here.fit(choice)
    here = here.at(fit.model)
    return here, here.fit(choice)


def _curves(term: EffectTerm, scatter: float) -> Curves | None:
    """The prior of a free curve, from the constants of its law."""
    if term.law.name != "curve":
        return None
    constants = term.law.constants
    joints = sorted(int(key.removeprefix("length")) - 1 for key in constants if key.startswith("length"))
    return Curves(
        joints=tuple(joints),
        lengths=np.array([constants[f"length{j + 1}"] for j in joints]),
        amplitudes=np.array([constants[f"amplitude{j + 1}"] for j in joints]),
        noise=scatter if math.isfinite(scatter) else 1.0,
        evidence=0.0,
    )


def questions(data: ArmData, fit: Fit, discovery: Discovery, sample: tuple[Array, Circumstances]) -> list[Question]:
    """What to ask of further stops of one arm; ``sample`` are some of them with all factors.

    Effects that discovery could not tell from the accepted one; else the accepted one against its declared
    look-alikes; else, and where nothing was accepted, the effects that are hardest to see.
    """
    joined = _joined(data, sample)
    asked: list[Question] = []
    parts = list(enumerate(fit.choice))
    for place, _ in parts:
        untold = [rival.slug for rival in discovery.findings[place].rivals if not rival.told_apart]
        for slug in untold:
            asked += [*_apart(data, fit, place, slug, discovery.threshold, joined)]
            asked += _reverse(data, fit, place, slug, discovery.threshold, joined)
    if not asked:
        taken = {part.slug for part in fit.choice}
        for place, part in parts:
            for slug in EFFECTS[part.slug].look_alikes:
                if slug not in taken:
                    asked += _apart(data, fit, place, slug, discovery.threshold, joined)
    return asked or _unseen(data, fit, discovery, joined)


def _apart(data: ArmData, fit: Fit, place: int, rival: str, least: float, joined: EffectContext) -> list[Question]:
    """The question whether a part of a fit can be told from another effect; none where that has no columns at all."""
    part = fit.choice[place]
    begin = sum(len(p.names) for p in fit.choice[:place])
    values = fit.identification.effect_values[begin : begin + len(part.names)][None]
    follower = fit.follower_without(place)
    signal = fit.signal(place)
    M_signal = follower.without(signal)
    ranked = []
    for law in _laws(data, rival, joined):
        columns = data.columns(rival, law)
        B = displacements(columns, fit.by_joint, fit.white)
        there = EFFECTS[rival].columns(joined, law)
        moving = [k for k, column in enumerate(there) if _moves(column)]
        if not moving:
            continue
        if len(moving) > _MOST_COLUMNS:  # those that imitate best, each judged alone
            MB = follower.without(B[moving])
            gains = (B[moving] @ M_signal) ** 2 / np.maximum(np.einsum("kd,kd->k", B[moving], MB), 1e-12)
            moving = sorted(moving[k] for k in np.argsort(-gains, kind="stable")[:_MOST_COLUMNS])
        names = tuple(columns[k].name for k in moving)
        ranked.append((explained_by(B[moving], follower, M_signal), law, names))
    if not ranked:
        return []
    ranked.sort(key=lambda entry: -entry[0])
    needed = least + len(part.names) * math.log(3 * len(data))
    laws = tuple((law, names) for _, law, names in ranked[:_MOST_LAWS])
    return [Question(part.slug, rival, needed, data, fit, place, part.law, part.names, values, laws)]


def _reverse(data: ArmData, fit: Fit, place: int, rival: str, least: float, joined: EffectContext) -> list[Question]:
    """The same question where the rival is the truth, as it would be fitted in the part's place."""
    follower = fit.follower_without(place)
    y = fit.residual + fit.signal(place)
    MY = follower.without(y)
    seen = Seen.of(data.candidates(fit, [rival]), follower)
    scores = seen.scores(MY, float(y @ MY))
    if not scores or not scores[0].names:
        return []
    instead = Part(rival, scores[0].candidate.law, scores[0].names)
    if len(fit.rows) + len(instead.names) >= 3 * len(data):
        return []  # too few readings to fit it
    other = data.fit((*fit.choice[:place], instead, *fit.choice[place + 1 :]))
    return _apart(data, other, place, fit.choice[place].slug, least, joined)


def _unseen(data: ArmData, fit: Fit, discovery: Discovery, joined: EffectContext) -> list[Question]:
    """The effects of which this plan shows least, and those that it cannot show because a factor never varied."""
    faint = sorted(discovery.not_found, key=lambda entry: float(entry["visible_share"]))
    slugs = [str(entry["effect"]) for entry in faint[:_MOST_UNSEEN]]
    for entry in discovery.invisible:
        slug = str(entry["effect"])
        if EFFECTS[slug].variables & _CURABLE and EFFECTS[slug].untestable(data.context):
            slugs.append(slug)
    N = 3 * len(data)
    asked = []
    for slug in slugs:
        laws = _laws(data, slug, joined)
        if slug == UNKNOWN or not laws:
            continue
        law = laws[0]
        columns = data.columns(slug, law)
        there = {column.name: column for column in EFFECTS[slug].columns(joined, law) if _moves(column)}
        columns = [column for column in columns if column.name in there][:_MOST_COLUMNS]
        if not columns:
            continue
        needed = discovery.threshold + math.log(N) + 2.0 * math.log(max(law.tried, 1))
        sizes = np.array([_size(data, fit, column, there[column.name], needed) for column in columns])
        names = tuple(column.name for column in columns)
        asked.append(Question(slug, "", needed, data, fit, None, law, names, np.diag(sizes)))
    return asked


def _size(data: ArmData, fit: Fit, column: EffectColumn, there: EffectColumn, needed: float) -> float:
    """The smallest size of a parameter that the run would show, or else one that moves the SMR by the noise."""
    B = displacements([column], fit.by_joint, fit.white)
    visible, whole = float(np.sum(B * fit.follower.without(B))), float(np.sum(B**2))
    if visible > VISIBLE**2 * whole and visible > 0.0:
        return math.sqrt(needed / visible)
    bound = max(abs(column.lower), abs(column.upper))
    noise = 1.0 if data.sigma is None else float(1.0 / np.sqrt(np.mean(fit.white[0, 0] ** 2)))
    if there.shift_M is not None:
        moved = float(np.sqrt(np.mean(there.shift_M**2)))
    else:
        assert there.offset is not None
        levers = np.sqrt(np.mean(np.sum((fit.by_joint[:, there.joint] * noise) ** 2, axis=0)))
        moved = float(levers * np.sqrt(np.mean(there.offset**2)))
    return min(noise / max(moved, 1e-12), bound)


def _laws(data: ArmData, slug: str, joined: EffectContext) -> list[Law]:
    """The laws of the run, and those that only the factors of further stops let one think of."""
    effect = EFFECTS[slug]
    found = [] if effect.untestable(data.context) else effect.laws(data.context)
    names = {law.name for law in found}
    if not effect.untestable(joined):
        found += [law for law in effect.laws(joined) if law.name not in names]
    return found


def _moves(column: EffectColumn) -> bool:
    moved = column.offset if column.joint is not None else column.shift_M
    return moved is not None and bool(np.any(moved))


def _joined(data: ArmData, sample: tuple[Array, Circumstances]) -> EffectContext:
    """The run and some further stops as one context."""
    q, known = sample
    rows = np.arange(len(q))[:: max(1, len(q) // _JOINED)]
    q, known = q[rows], known.take(rows)
    return data.model.context(
        np.concatenate([data.readings.q, q]), known=_joined_circumstances(data.known, len(data), known, len(q))
    )


def _joined_circumstances(first: Circumstances, n: int, second: Circumstances, m: int) -> Circumstances:
    """Of n stops and of m further ones; NaN where only the others know."""
    joined: dict[str, Any] = {"record": first.record}
    for entry in fields(Circumstances):
        values = [getattr(first, entry.name), getattr(second, entry.name)]
        known = [value for value in values if value is not None]
        if entry.name == "record" or not known:
            continue
        rest = known[0].shape[1:]
        joined[entry.name] = np.concatenate(
            [
                np.full((size, *rest), np.nan) if value is None else np.asarray(value, dtype=np.float64)
                for value, size in zip(values, (n, m), strict=True)
            ]
        )
    return Circumstances(**joined)
