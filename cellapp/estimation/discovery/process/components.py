"""Components of the structured process: an effect's smooth law on the data at hand, and its hyperparameters.

A component is a channel (what moves) with a driver (what it depends on), as a smooth form of a named effect. A turn
about the axis that depends on its own angle is a transmission error, one across the axis a wobble, one that depends on
gravity's torque a compliance, and so on. The columns are weighted by a spectrum that depends on an amplitude and, for
functions of an angle, on a length scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import EFFECTS, Effect, EffectColumn, Law, LawForm
from cellapp.robot.effects.data_driven import FIELD, position_in_base
from cellapp.robot.effects.field import FIELD_LENGTH, box_of, field_frequencies, field_variances
from cellapp.robot.effects.law import AMPLITUDE, CYCLES, LENGTH, LengthRange, SmoothLaw, circle_variances
from cellapp.robot.effects.periodic import CURVE, CURVE_AMPLITUDE, CURVE_LENGTH, TransmissionError
from cellapp.robot.kinematics.transforms import Array

CURVE_CYCLES = 80
"""Highest cycle count of a joint's curve: at the shortest length scale, 3 degrees, 1 % of its variance is beyond."""
_LEAST_LEVER = 0.05
"""Share of the longest rms lever below which a joint gets no curve: its errors do not show at the SMR."""


CURVE_LENGTHS = LengthRange(math.radians(5.0), math.radians(3.0), math.radians(40.0))
"""Length scales of a joint's curve: a gear's errors have periods from a few degrees to a turn; below 3 degrees lines of
the spectrum describe them."""
FIELD_LENGTHS = LengthRange(0.5, 0.2, 3.0)
"""Length scales of a field: layers of air and bent stands act over a good part of the workspace, and shorter fields
need more readings than there are."""


@dataclass(frozen=True, eq=False)
class Component:
    """A smooth law on the data at hand.

    Attributes
    ----------
    slug : str
        The effect.
    columns : tuple of EffectColumn, length m
    rows : array, shape (m, d)
        Their whitened displacements.
    constants : mapping
        Constants of the law that are not hyperparameters.
    form : LawForm
    groups : array, shape (m,)
        Index into ``amplitude_keys`` of each column's amplitude.
    amplitude_keys : tuple of str
        Constants of the law that hold the amplitudes.
    start : float
        First guess of the amplitudes.
    weights : array, shape (m,)
        Relative prior variances if no length scale is fitted; else unused.
    lengths : LengthRange, optional
    length_keys : tuple of str
        Constants of the law that hold the length scale; one value for all.
    frequencies : array, shape (m,), optional
        For a field over the workspace: angular frequency of each column [1/m].
    """

    slug: str
    columns: tuple[EffectColumn, ...]
    rows: Array
    form: LawForm
    constants: Mapping[str, float]
    groups: NDArray[np.intp]
    amplitude_keys: tuple[str, ...]
    start: float
    weights: Array
    lengths: LengthRange | None = None
    length_keys: tuple[str, ...] = ()
    frequencies: Array | None = None

    @property
    def hyperparameters(self) -> int:
        """Number of fitted hyperparameters: amplitudes, and a length scale if there is one."""
        return len(self.amplitude_keys) + (0 if self.lengths is None else 1)

    def relative_variances(self, length: float) -> Array:
        """Return prior variances (m,) at unit amplitude."""
        if self.lengths is None:
            return self.weights
        if self.frequencies is not None:
            return field_variances(length, self.frequencies)
        return np.asarray(circle_variances(length, int(self._cycles.max()))[self._cycles - 1])

    @cached_property
    def _cycles(self) -> NDArray[np.intp]:
        """Cycles a turn of each column (m,), zero for columns that are no waves."""
        return np.array([column.cycles or 0 for column in self.columns], dtype=np.intp)

    def law(self, amplitudes: Array, length: float) -> Law:
        """Return the law with its hyperparameters."""
        found = dict(self.constants)
        found |= dict(zip(self.amplitude_keys, amplitudes.tolist(), strict=True))
        found |= dict.fromkeys(self.length_keys, length)
        return self.form.law(found)

    def of_amplitudes(self, kept: Sequence[int]) -> Component:
        """Return the component with some of its amplitudes only."""
        places = np.flatnonzero(np.isin(self.groups, list(kept)))
        keys = [self.amplitude_keys[k] for k in kept]
        lengths = [key for key in self.length_keys if len(self.length_keys) == 1 or _same_joint(key, keys)]
        some = self._take(places)
        groups = np.searchsorted(np.asarray(sorted(kept)), some.groups)
        return replace(some, groups=groups, amplitude_keys=tuple(keys), length_keys=tuple(lengths))

    def coarse(self) -> Component:
        """Return the component with the slower half of its waves, if it has a length scale."""
        if self.lengths is None:
            return self
        fast = self._cycles if self.frequencies is None else self.frequencies
        return self._take(np.flatnonzero(fast <= 0.5 * fast.max()))

    def _take(self, places: NDArray[np.intp]) -> Component:
        return replace(
            self,
            columns=tuple(self.columns[k] for k in places),
            rows=self.rows[places],
            groups=self.groups[places],
            weights=self.weights[places],
            frequencies=None if self.frequencies is None else self.frequencies[places],
        )


def _same_joint(length_key: str, amplitude_keys: Sequence[str]) -> bool:
    number = length_key.removeprefix(CURVE_LENGTH.name)
    return CURVE_AMPLITUDE.name + number in amplitude_keys


def components(data: ArmData, fit: JointFit) -> list[Component]:
    """Return all components that the data allow beside a fit."""
    smooth = (_plain(data, fit, effect, law) for effect in EFFECTS.values() for law in effect.smooth_laws(data.context))
    found = [_curves(data, fit), *smooth, _field(data, fit)]
    return [one for one in found if one is not None]


def _plain(data: ArmData, fit: JointFit, effect: Effect, law: SmoothLaw) -> Component | None:
    """Build a component with one amplitude and at most one length scale for all its columns; None if nothing moves.

    The columns' priors at unit amplitude are the relative variances.
    """
    form = effect.form(law.form)
    starts = {AMPLITUDE.name: 1.0} if law.lengths is None else {AMPLITUDE.name: 1.0, LENGTH.name: law.lengths.start}
    columns = tuple(data.columns(effect.slug, form.law({**law.constants, **starts})))
    rows = fit.displacements(columns) if columns else np.zeros((0, 3 * len(data)))
    if not rows.any():
        return None
    return Component(
        slug=effect.slug,
        columns=columns,
        rows=rows,
        form=form,
        constants=law.constants,
        groups=np.zeros(len(columns), dtype=np.intp),
        amplitude_keys=(AMPLITUDE.name,),
        start=law.start,
        weights=np.array([column.prior_sd**2 for column in columns]),
        lengths=law.lengths,
        length_keys=() if law.lengths is None else (LENGTH.name,),
    )


def _curves(data: ArmData, fit: JointFit) -> Component | None:
    """Build curves of all joints with a lever: an amplitude for each, one length scale; None if there is none."""
    levers = np.sqrt(np.mean(np.sum(fit.by_joint**2, axis=0), axis=1))
    joints = np.flatnonzero(levers > _LEAST_LEVER * levers.max()).tolist()
    if not joints:
        return None
    constants: dict[str, float] = {CYCLES.name: float(CURVE_CYCLES)}
    keys = {joint: (CURVE_AMPLITUDE.key(joint), CURVE_LENGTH.key(joint)) for joint in joints}
    full = {**constants} | {key: 1.0 for pair in keys.values() for key in pair}
    columns = tuple(data.columns(TransmissionError.slug, CURVE.law(full)))
    place = {joint: k for k, joint in enumerate(joints)}
    return Component(
        slug=TransmissionError.slug,
        columns=columns,
        rows=fit.displacements(columns),
        form=CURVE,
        constants=constants,
        groups=np.array([place[c.joint] for c in columns if c.joint is not None], dtype=np.intp),
        amplitude_keys=tuple(amplitude for amplitude, _ in keys.values()),
        start=2e-4,
        weights=np.ones(len(columns)),
        lengths=CURVE_LENGTHS,
        length_keys=tuple(length for _, length in keys.values()),
    )


def _field(data: ArmData, fit: JointFit) -> Component:
    """Build a field over the workspace: one amplitude for its three directions, one length scale."""
    box = box_of(position_in_base(data.context))
    law = FIELD.law({**box, AMPLITUDE.name: 1.0, FIELD_LENGTH.name: FIELD_LENGTHS.start})
    columns = tuple(data.columns(UNKNOWN, law))
    return Component(
        slug=UNKNOWN,
        columns=columns,
        rows=fit.displacements(columns),
        form=FIELD,
        constants=box,
        groups=np.zeros(len(columns), dtype=np.intp),
        amplitude_keys=(AMPLITUDE.name,),
        start=2e-5,
        weights=np.ones(len(columns)),
        lengths=FIELD_LENGTHS,
        length_keys=(FIELD_LENGTH.name,),
        frequencies=np.tile(field_frequencies(box), 3),
    )
