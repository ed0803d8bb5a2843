"""Arms of the twin for tests of effects, and an independent forward chain that can be displaced at any frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects import EffectColumn, EffectContext, Law, MeasurementConditions, TemperatureRecord
from cellapp.robot.effects.data_driven import ActedOn, Variable, acted_on
from cellapp.robot.effects.unknown import PAIR_ORDER, curve_families, pair_families
from cellapp.robot.kinematics.transforms import rotation_from_vector, rotation_x, rotation_y, rotation_z, transform
from cellapp.robot.model.nominal import bodies_of, nominal_arm, pose_matrix, up_in_tracker
from tests.arms import Array, true_geometry
from tests.sure import sure
from tests.twin import whole_twin

NOTHING = MeasurementConditions()
NORMAL = np.array([0.6, 0.0, 0.8])
EYE = np.eye(3)


def conditions_of(rng: np.random.Generator, n: int, joints: int = 6) -> MeasurementConditions:
    """All quantities known, and varying, at the n stops of a run."""
    step = rng.uniform(-1.0, 1.0, (n, joints))
    conditions = MeasurementConditions(
        approach=np.sign(step),
        step=step,
        dwell_s=rng.uniform(0.5, 5.0, n),
        time_s=np.sort(rng.uniform(100.0, 18000.0, n)),
        order=np.arange(n, dtype=np.float64),
        payload_kg=rng.choice([0.3, 5.0], n),
        air_c=rng.uniform(19.0, 23.0, n),
        joints_c=rng.uniform(25.0, 35.0, (n, joints)),
        other_moment_M=np.column_stack([rng.normal(0.0, 30.0, (n, 2)), np.zeros(n)]),
        other_q=rng.uniform(-2.0, 2.0, (n, joints)),
    )
    assert conditions.time_s is not None
    assert conditions.joints_c is not None
    assert conditions.air_c is not None
    return replace(conditions, record=TemperatureRecord(conditions.time_s, conditions.joints_c, conditions.air_c))


def context_of(
    n: int = 40, seed: int = 0, arm: str = "left", conditions: MeasurementConditions | None = None
) -> EffectContext:
    """An arm of the twin with geometric errors (Hayati angles too) and a tilted base, at n random stops."""
    profile = whole_twin()
    owner = profile.arms[arm]
    rng = np.random.default_rng(seed)
    aslant = transform(rotation_from_vector([0.02, -0.03, 0.01]), [0.0, 0.0, 0.0])
    T_M_B = np.linalg.inv(pose_matrix(sure(profile.tracker.pose))) @ pose_matrix(sure(owner.base)) @ aslant
    return EffectContext(
        q=rng.uniform(-2.5, 2.5, (n, 6)),
        conditions=conditions_of(rng, n) if conditions is None else conditions,
        geometry=true_geometry(nominal_arm(owner).with_T_M_B(T_M_B), np.random.default_rng(99)),
        bodies=bodies_of(owner),
        up_M=up_in_tracker(profile),
        smr_normal=NORMAL,
    )


def under(context: EffectContext, conditions: MeasurementConditions) -> EffectContext:
    """The same stops under other measurement conditions."""
    return replace(context, conditions=conditions)


def rows_of(context: EffectContext, rows: NDArray[np.intp]) -> EffectContext:
    """Some of the stops."""
    return replace(context, q=context.q[rows], conditions=context.conditions.take(rows))


@dataclass(frozen=True)
class Chain:
    """Poses of all frames, base first (N + 1, 4, 4), and the SMR (3,), of one configuration, in the tracker frame."""

    frames: list[Array]
    smr: Array


def chain(
    context: EffectContext,
    row: int,
    *,
    twist: Mapping[int, Array] | None = None,
    shift: Mapping[int, Array] | None = None,
    joints: Array | None = None,
    strain: Array | None = None,
    tool: Array | None = None,
    outside: Array | None = None,
) -> Chain:
    """Forward chain with 4 x 4 matrices.

    ``twist`` and ``shift`` turn [rad] and shift [m] a frame, and all beyond it, in its own coordinates; ``joints`` is
    added to the angles, ``strain`` (N,) lengthens the rows, ``tool`` is added to the SMR offset, ``outside`` (4, 4)
    moves the whole arm in the tracker frame.
    """
    geometry = context.geometry
    q = context.q[row] + (0.0 if joints is None else joints)
    strain = np.zeros(len(q)) if strain is None else strain
    pose = geometry.T_M_B() if outside is None else outside @ geometry.T_M_B()
    frames = []
    for i in range(len(q) + 1):
        if i:
            theta, d, a, alpha, beta = geometry.rows[i - 1]
            along = np.array([a, 0.0, d]) * (1.0 + strain[i - 1])
            pose = pose @ transform(rotation_z(q[i - 1] + theta), np.zeros(3))
            pose = pose @ transform(EYE, along) @ transform(rotation_x(alpha) @ rotation_y(beta), np.zeros(3))
        rotated = rotation_from_vector((twist or {}).get(i, np.zeros(3)))
        pose = pose @ transform(rotated, (shift or {}).get(i, np.zeros(3)))
        frames.append(pose)
    offset = geometry.tool + (0.0 if tool is None else tool)
    return Chain(frames, pose[:3, :3] @ offset + pose[:3, 3])


def slope(smr: Callable[[float], Array], h: float = 1e-5) -> Array:
    """Derivative (3,) of an SMR position at 0."""
    return (smr(h) - smr(-h)) / (2.0 * h)


def by_name(columns: list[EffectColumn]) -> dict[str, EffectColumn]:
    """Columns by name; names must be unique."""
    found = {column.name: column for column in columns}
    assert len(found) == len(columns)
    return found


def shifts(column: EffectColumn) -> Array:
    """The shift of a column that offsets no joint."""
    assert column.joint is None
    return sure(column.shift_M)


def offsets(column: EffectColumn) -> Array:
    """The offset of a column that offsets a joint."""
    assert column.joint is not None
    return sure(column.offset)


def curve_laws(context: EffectContext) -> list[Law]:
    """Laws of all functions of one variable, in every channel."""
    families = curve_families(context)
    return [family.law(acts_on) for acts_on in acted_on(context.joints) for family in families]


def pair_laws(context: EffectContext, acts_on: ActedOn, among: Collection[Variable] | None = None) -> list[Law]:
    """Laws of all functions of two variables, of those ``among`` them if given, in one channel."""
    return [family.law(acts_on) for family in pair_families(context, among, (PAIR_ORDER,))]
