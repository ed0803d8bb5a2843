"""Charts of the rotation that the model's effects add to each joint, over its angle, with bands of the posterior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.commands.view.charts import Axis, Chart, Limit, Series, enumerated, series
from cellapp.commands.view.words import TWO_SIDED
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectContext, EffectTerm, MeasurementConditions, displacement
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_POINTS = 121
"""Number of angles of a curve: three degrees apart over a whole turn."""
_BEYOND = 0.15
"""How far a curve extends beyond the measured angles, as a share of their range: there its band widens."""
_LEAST_BEYOND = np.radians(5.0)
"""The same for a joint that hardly moved [rad]."""
_LEAST_URAD = 0.05
"""Contributions below this are left out: a tenth of an encoder's step."""
_SUM_STYLE, _DOWN_STYLE = 0, 1
"""Styles of the sum of all effects, after upward and after downward motion; single effects have others."""
_URAD = 1e6


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Rotations (n,) [rad] of one joint over its angle alone: by each term, and in S draws of each term."""

    terms: tuple[EffectTerm, ...]
    offsets: Array
    draws: Array | None

    @property
    def shown(self) -> list[int]:
        """The terms that turn this joint."""
        return [k for k, offset in enumerate(self.offsets) if np.abs(offset).max() * _URAD > _LEAST_URAD]

    def band(self, rows: list[int]) -> Array | None:
        """Return the half width (n,) [urad] of the 95 % band of the sum of some terms; None without a posterior."""
        if self.draws is None:
            return None
        return np.asarray(TWO_SIDED * _URAD * np.sqrt(np.mean(self.draws[rows].sum(axis=0) ** 2, axis=0)))


def joint_curve_charts(
    name: str, model: ArmModel, readings: Readings, conditions: MeasurementConditions, stop: int
) -> Iterator[Chart]:
    """Yield a chart for each joint that effects turn; other joints and all conditions are those of row ``stop``."""
    rows = np.full(_POINTS, stop)
    for joint in range(readings.q.shape[1]):
        measured = np.array([readings.q[:, joint].min(), readings.q[:, joint].max()])
        beyond = max(_BEYOND * float(np.ptp(measured)), _LEAST_BEYOND)
        angles = np.linspace(measured[0] - beyond, measured[1] + beyond, _POINTS)
        up, down = (
            _sweep(model, _context(model, readings.q[stop], conditions.take(rows), joint, angles, sign), joint)
            for sign in (1.0, -1.0)
        )
        if up.shown or down.shown:
            number = int(readings.configuration[stop])
            yield _chart(name, joint, np.degrees(angles), np.degrees(measured), (up, down), number)


def _context(
    model: ArmModel, q: Array, conditions: MeasurementConditions, joint: int, angles: Array, sign: float
) -> EffectContext:
    """Return the context of a stop with one joint angle replaced, reached by a motion of that joint with ``sign``."""
    swept = np.tile(q, (len(angles), 1))
    swept[:, joint] = angles
    approach = np.zeros(swept.shape) if conditions.approach is None else np.array(conditions.approach, dtype=np.float64)
    approach[:, joint] = sign
    return model.context(swept, conditions=replace(conditions, approach=approach))


def _sweep(model: ArmModel, context: EffectContext, joint: int) -> _Sweep:
    moved = displacement(model.effects, EFFECTS, context)
    actual = replace(context, q_actual=context.q + moved.joints)
    offsets = [displacement([term], EFFECTS, actual).joints[:, joint] for term in model.effects]
    draws = None if model.posterior is None else model.posterior.joint_offsets(model.effects, actual)[..., joint]
    return _Sweep(model.effects, np.array(offsets).reshape(-1, len(context)), draws)


def _chart(name: str, joint: int, degrees: Array, measured: Array, sweeps: tuple[_Sweep, _Sweep], stop: int) -> Chart:
    """Show the sum of the effects with its band, for both directions of motion if they differ; then each effect."""
    up, down = sweeps
    both = bool(np.abs(up.offsets - down.offsets).max(initial=0.0) * _URAD > _LEAST_URAD)
    drawn = [_curve(up, degrees, up.shown, " after upward motion" if both else "", _SUM_STYLE)]
    if both:
        drawn.append(_curve(down, degrees, down.shown, " after downward motion", _DOWN_STYLE))
    if len(up.shown) > 1:
        drawn += [_curve(up, degrees, [row], "", style) for style, row in enumerate(up.shown, start=2)]
    limits = tuple(Limit("ends of the measured range", at, "x") for at in measured.tolist())
    message = f"{_message(joint, degrees, measured, drawn[: 1 + both])} The other joints stay as at stop {stop}."
    title = f"Arm {name}: what effects turn joint {joint + 1} by, over its angle"
    return Chart(title, Axis(f"joint {joint + 1}", "deg"), Axis("offset", "µrad"), tuple(drawn), message, limits)


def _curve(sweep: _Sweep, degrees: Array, rows: list[int], after: str, style: int) -> Series:
    """Return the curve of the sum of some terms, with its band."""
    words = enumerated(sweep.terms[row].slug.replace("_", " ") for row in rows)
    offset = sweep.offsets[rows].sum(axis=0) * _URAD
    return series(f"{words}{after}", degrees, offset, band=sweep.band(rows), style=style)


def _message(joint: int, degrees: Array, measured: Array, drawn: Sequence[Series]) -> str:
    """Say by how much the joint is turned within the measured angles, and how well that is known."""
    inside = (degrees >= measured[0]) & (degrees <= measured[1])
    parts = []
    for one in drawn:
        low, high = f"{one.y[inside].min():.0f}", f"{one.y[inside].max():.0f}"
        known = "" if one.band is None else f" (known to ±{one.band[inside].max():.1f} µrad)"
        parts.append(f"{one.name}: {low if low == high else f'{low} to {high}'} µrad{known}")
    return (
        f"Offset of joint {joint + 1} over the measured angles, {measured[0]:.0f} to {measured[1]:.0f} deg, by"
        f" {'; by '.join(parts)}."
    )
