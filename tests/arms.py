"""Arms for tests: published tables and random ones, and small simulated cells made of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cellapp.robot.effects import EFFECTS, EffectTerm, Law
from cellapp.robot.kinematics.chain import Geometry, nominal_geometry, parallel_rows, parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import rotation_from_vector, transform
from cellapp.robot.model import ArmModel
from drivers.plant import ArmConfig, CapsuleConfig, Plant, PlantConfig, TrackerConfig, TrueErrors

Array = NDArray[np.float64]
HALF_TURN = np.pi / 2.0


def dh(theta: list[float], d: list[float], a: list[float], alpha: list[float]) -> Array:
    """D-H rows (N, 4)."""
    return np.column_stack([theta, d, a, alpha])


UR_ALPHA = [HALF_TURN, 0.0, 0.0, HALF_TURN, -HALF_TURN, 0.0]
UR10 = dh([0.0] * 6, [0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922], [0.0, -0.612, -0.5723, 0.0, 0.0, 0.0], UR_ALPHA)
UR5 = dh([0.0] * 6, [0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823], [0.0, -0.425, -0.39225, 0.0, 0.0, 0.0], UR_ALPHA)
UR10_MASSES = np.array([7.1, 12.7, 4.27, 2.0, 2.0, 0.365])
UR10_CENTERS = np.array(
    [[0.021, 0, 0.027], [0.38, 0, 0.158], [0.24, 0, 0.068], [0, 0.007, 0.018], [0, 0.007, 0.018], [0, 0, -0.026]]
)
UR5_MASSES = np.array([3.7, 8.393, 2.33, 1.219, 1.219, 0.1879])
UR5_CENTERS = np.array(
    [[0, -0.02561, 0.00193], [0.2125, 0, 0.11336], [0.15, 0, 0.0265], [0, -0.0018, 0.01634], [0, 0.0018, 0.01634],
     [0, 0, -0.001159]]
)  # fmt: skip
# seven joints, none of whose neighbours are parallel (KUKA LBR iiwa 7 R800's published lengths)
SEVEN = dh(
    [0.0] * 7,
    [0.340, 0.0, 0.400, 0.0, 0.400, 0.0, 0.126],
    [0.0] * 7,
    [-HALF_TURN, HALF_TURN, HALF_TURN, -HALF_TURN, -HALF_TURN, HALF_TURN, 0.0],
)
OFF_AXIS = np.array([0.045, 0.020, 0.060])
ON_AXIS = np.array([0.0, 0.0, 0.060])
STATION = transform(rotation_from_vector([0.05, -0.08, 2.0]), [2.6, 0.9, -0.7])


def dh_frames(rows: ArrayLike, q: ArrayLike) -> list[Array]:
    """Frames 0 to N, each (..., 4, 4), of a D-H chain at ``q`` (..., N), entry by entry."""
    angles = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    chain = [np.broadcast_to(np.eye(4), (*angles.shape[1:], 4, 4))]
    for (theta, d, a, alpha), angle in zip(np.asarray(rows), angles, strict=True):
        c, s, ca, sa = np.cos(angle + theta), np.sin(angle + theta), np.cos(alpha), np.sin(alpha)
        step = np.zeros((*angle.shape, 4, 4))
        step[..., 0, :] = np.stack([c, -s * ca, s * sa, a * c], axis=-1)
        step[..., 1, :] = np.stack([s, c * ca, -c * sa, a * s], axis=-1)
        step[..., 2, 1:], step[..., 3, 3] = (sa, ca, d), 1.0
        chain.append(chain[-1] @ step)
    return chain


def true_geometry(
    nominal: Geometry, rng: np.random.Generator, length: float = 0.3e-3, angle: float = 0.05 * np.pi / 180.0
) -> Geometry:
    """An arm that left its nominal table: every row parameter (beta only between parallel axes) and the tool."""
    vector = nominal.vector()
    betas = {f"beta{i + 1}" for i in parallel_rows(nominal)}
    for place, name in enumerate(parameter_names(nominal.joints)[6:], start=6):
        if name.startswith("beta") and name not in betas:
            continue
        vector[place] += rng.normal(0.0, angle if parameter_unit(name) == "rad" else length)
    return nominal.with_vector(vector)


def at_station(rows: Array, tool: Array, T_M_B: Array = STATION) -> Geometry:
    """The nominal geometry of an arm that stands in front of the tracker."""
    return nominal_geometry(rows, tool, T_M_B)


def effect_term(
    slug: str, values: Mapping[str, float], unit: str = "rad", error: float = 0.0, law: Law | None = None
) -> EffectTerm:
    """A term of an effect: values by the names of their columns, of one unit and standard error."""
    size = np.array(list(values.values()))
    law = EFFECTS[slug].law() if law is None else law
    return EffectTerm(slug, tuple(values), size, np.full(len(size), error), (unit,) * len(size), law)


def measured_rotations(model: ArmModel, q: Array, sigma_rad: float, rng: np.random.Generator) -> Array:
    """Quaternions (n, 4) that a tracker measures of an arm's probe."""
    noise = Rotation.from_rotvec(sigma_rad * rng.standard_normal((len(q), 3)))
    return np.asarray((noise * Rotation.from_matrix(model.orientation(q))).as_quat(scalar_first=True))


_PUBLISHED = {"ur10": (UR10, UR10_MASSES, UR10_CENTERS), "ur5": (UR5, UR5_MASSES, UR5_CENTERS)}


def arm_config(kind: str = "ur10", name: str = "left", x: float = 0.0, **changes: Any) -> ArmConfig:
    """A simulated UR10 or UR5 at x on a 0.5 m table, its SMR visible from everywhere; fields changed."""
    rows, masses, centers = _PUBLISHED[kind]
    values: dict[str, Any] = {
        "name": name,
        "rows": rows,
        "limits": np.tile([-2 * np.pi, 2 * np.pi], (6, 1)),
        "speed": np.full(6, 2.0),
        "acceleration": np.full(6, 3.0),
        "T_C_B": transform(np.eye(3), [x, 0.0, 0.5]),
        "smr_offset": np.array([0.04, 0.03, 0.05]),
        "smr_normal": np.array([0.0, 0.0, 1.0]),
        "smr_acceptance": np.pi,
        "masses": masses,
        "centers_of_mass": centers,
        "capsules": (
            CapsuleConfig(0, np.zeros(3), np.array([0.0, 0.0, 0.1]), 0.08),
            CapsuleConfig(2, np.zeros(3), np.array([-rows[1, 2], 0.0, 0.0]), 0.07),
            CapsuleConfig(3, np.zeros(3), np.array([-rows[2, 2], 0.0, 0.0]), 0.06),
            CapsuleConfig(6, np.zeros(3), np.array([0.0, 0.0, -0.1]), 0.05),
        ),
    }
    return ArmConfig(**(values | changes))


def plant_config(*arms: ArmConfig, tracker: dict[str, Any] | None = None, **changes: Any) -> PlantConfig:
    """A perfect, noiseless cell of some arms, or of a UR10, the tracker 3 m away; fields changed."""
    values: dict[str, Any] = {
        "seed": 1,
        "arms": arms or (arm_config(),),
        "tracker": TrackerConfig(**({"T_C_M": transform(np.eye(3), [0.3, -3.0, 1.1])} | (tracker or {}))),
        "errors": TrueErrors(),
        "noise": False,
    }
    return PlantConfig(**(values | changes))


def plant_of(
    rows: Array, tool: Array, T_M_B: Array = STATION, errors: TrueErrors | None = None, seed: int = 0
) -> Plant:
    """A noisy plant of one arm, without effects and bodies, whose tracker frame is the cell frame."""
    n = len(rows)
    arm = arm_config(
        name="arm", rows=rows, limits=np.tile([-2.0 * np.pi, 2.0 * np.pi], (n, 1)), speed=np.ones(n),
        acceleration=np.ones(n), T_C_B=T_M_B, smr_offset=tool, masses=np.ones(n), centers_of_mass=np.zeros((n, 3)),
        capsules=(),
    )  # fmt: skip
    own = {"repeatability": 0.0, "temperature_c": 20.0, "floor": -10.0, "noise": True, "errors": errors or TrueErrors()}
    return Plant(plant_config(arm, tracker={"T_C_M": np.eye(4)}, seed=seed, **own))
