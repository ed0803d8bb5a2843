"""A data-driven term in words: channel, variables, its curve, and a short formula where one fits as well."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.discovery.data import ArmData, Fit
from cellapp.discovery.scan import Candidate, Follower, Seen, displacements, explained_by
from cellapp.effects import EffectColumn, Law
from cellapp.effects.unknown import channel_directions, values_of
from cellapp.kinematics.transforms import Array

_POINTS = 60


@dataclass(frozen=True)
class Description:
    """What is known of an effect that has no name.

    ``formula`` is empty where none of the short ones explains it as well as the curve; ``gain`` is the score of the
    formula less that of the curve. ``curve`` is (variable, value of the term), in SI units, of one variable.
    """

    channel: str
    variables: tuple[str, ...]
    size_um: float
    formula: str
    gain: float | None
    curve: tuple[tuple[float, float], ...]
    sentence: str


def describe(data: ArmData, fit: Fit, place: int) -> Description:
    """Describe the data-driven part at ``place`` of a fitted choice."""
    part = fit.choice[place]
    channel, *variables = part.law.name.split("|")
    begin = sum(len(p.names) for p in fit.choice[:place])
    columns = fit.columns[begin : begin + len(part.names)]
    values = fit.identification.effect_values[begin : begin + len(part.names)]
    curve_values = np.zeros(len(data))
    for column, value in zip(columns, values.tolist(), strict=True):
        if column.offset is not None:
            curve_values += value * column.offset
    by_joint = columns[0].joint is not None
    # only what geometry cannot follow has a size: a slow drift holds any amount of what the base pose takes back
    seen = fit.follower_without(place).without(fit.signal(place)).reshape(3, -1)
    moved = np.linalg.solve(fit.white.transpose(2, 0, 1), seen.T[:, :, None])[..., 0]
    size = float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
    known = [values_of(data.context, name) for name in variables]
    formula, gain = _formula(data, fit, place, channel, variables, known)
    curve: tuple[tuple[float, float], ...] = ()
    if len(variables) == 1 and by_joint:
        order = np.argsort(known[0], kind="stable")
        picked = order[np.linspace(0, len(order) - 1, min(_POINTS, len(order))).astype(np.intp)]
        curve = tuple((float(known[0][i]), float(curve_values[i])) for i in picked)
    depends = " and ".join(variables)
    shape = f", about {formula}" if formula else ""
    sentence = f"{channel} depends on {depends}{shape}; {size * 1e6:.0f} um rms at the SMR"
    return Description(channel, tuple(variables), size * 1e6, formula, gain, curve, sentence)


def _shapes(variables: list[str], known: list[Array]) -> list[tuple[str, Array]]:
    """Short formulas to try, each with the free factor ``c`` left out: text and values (n, k) of its columns."""
    shapes: list[tuple[str, Array]] = []

    def add(text: str, *columns: Array) -> None:
        stacked = np.stack(columns, axis=1)
        if np.isfinite(stacked).all() and np.ptp(stacked, axis=0).max() > 0.0:
            shapes.append((text, stacked))

    def singles(v: str, x: Array) -> None:
        add(f"c {v}", x)
        add(f"c {v}^2", x**2)
        add(f"c |{v}|", np.abs(x))
        spread = float(np.ptp(x)) or 1.0
        if v == "time":
            for count in np.arange(0.5, 24.25, 0.25):
                period = spread / float(count)
                phase = 2.0 * np.pi * x / period
                add(f"c sin(2 pi time / {period / 60.0:.3g} min + phase)", np.cos(phase), np.sin(phase))
            for share in (0.05, 0.1, 0.2, 0.4, 0.8):
                add(f"c exp(-time / {share * spread / 60.0:.3g} min)", np.exp(-(x - x.min()) / (share * spread)))
            return
        turning = v.startswith(("q", "other q")) or v in ("azimuth", "elevation", "incidence")
        for k in range(1, 9 if turning else 1):
            add(f"c sin({k} {v} + phase)" if k > 1 else f"c sin({v} + phase)", np.cos(k * x), np.sin(k * x))
        for k in range(1, 5 if turning else 1):
            label = f"{k} {v}" if k > 1 else v
            add(f"c |sin({label})|", np.abs(np.sin(k * x)))
            add(f"c |cos({label})|", np.abs(np.cos(k * x)))
        for width in (0.1, 0.2, 0.4, 0.8):
            add(f"c tanh({v} / {width * spread:.2g})", np.tanh((x - np.median(x)) / (width * spread)))

    for v, x in zip(variables, known, strict=True):
        singles(v, x)
    if len(variables) == 2:
        (v, w), (x, y) = variables, known
        for a, b in ((1, 1), (1, -1), (1, 0.5), (0.5, 1), (1, -0.5), (0.5, -1), (2, 1), (1, 2)):
            total = a * x + b * y
            text = f"{_times(a, v)} {'+' if b > 0 else '-'} {_times(abs(b), w)}"
            add(f"c sin({text} + phase)", np.cos(total), np.sin(total))
            for width in (0.3, 0.6, 1.0, 1.6):
                add(f"c tanh(({text}) / {width:g})", np.tanh(total / width))
        add(f"c {v} {w}", x * y)
        for f, name in ((np.sin, "sin"), (np.cos, "cos")):
            for g, other in ((np.sin, "sin"), (np.cos, "cos")):
                add(f"c {name}({v}) {other}({w})", f(x) * g(y))
    return shapes


def _times(factor: float, name: str) -> str:
    return name if factor == 1 else f"{factor:g} {name}"


def _formula(
    data: ArmData, fit: Fit, place: int, channel: str, variables: list[str], known: list[Array]
) -> tuple[str, float | None]:
    """The short formula that explains at least nearly as well as the curve for its number of parameters."""
    if any(not np.isfinite(values).all() for values in known):
        return "", None
    begin = sum(len(p.names) for p in fit.choice[:place])
    part = fit.choice[place]
    basis = fit.columns[begin]
    follower: Follower = fit.follower_without(place)
    y = fit.residual + fit.signal(place)
    MY = follower.without(y)
    square = float(y @ MY)
    directions = [] if basis.joint is not None else channel_directions(data.context, channel)
    candidates = []
    shapes = _shapes(variables, known)
    for text, values in shapes:
        common = ("", text, -math.inf, math.inf, basis.where)
        if basis.joint is not None:
            columns = tuple(
                EffectColumn(f"{text}#{k}", *common, joint=basis.joint, offset=values[:, k])
                for k in range(values.shape[1])
            )
        else:
            columns = tuple(
                EffectColumn(f"{text}#{k}#{d}", *common, shift_M=values[:, k, None] * direction)
                for k in range(values.shape[1])
                for d, direction in enumerate(directions)
            )
        law = Law(text, {}, len(shapes))
        candidates.append(Candidate("unknown", law, columns, displacements(columns, fit.by_joint, fit.white)))
    if not candidates:
        return "", None
    own = fit.rows[len(fit.rows) - len(fit.columns) + begin :][: len(part.names)]
    seen = Seen.of(candidates, follower)
    best = seen.scores(MY, square)[0]
    share = min(explained_by(own, follower, MY) / square, 1.0 - 1e-12)
    curve_score = -len(y) * math.log1p(-share) - len(own) * math.log(len(y))
    gain = best.value - curve_score
    # as good as the curve in what it explains, or better for having fewer parameters
    if gain < 0.0 and best.explained < 0.95 * share:
        return "", gain
    return best.candidate.law.name, gain
