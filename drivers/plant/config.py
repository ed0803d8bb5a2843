"""Configuration of the simulated cell. SI units; T_C_B maps base coordinates into the cell frame C (z up)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def _array(owner: str, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{owner}: {name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{owner}: {name} holds a value that is not a finite number")
    array.setflags(write=False)
    return array


def broadcast(name: str, value: ArrayLike | None, default: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return ``value``, or ``default`` if it is None, broadcast to ``shape``. Raises ``ValueError``."""
    array = np.asarray(default if value is None else value, dtype=np.float64)
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}") from None


@dataclass(frozen=True, eq=False)
class CapsuleConfig:
    """All points within ``radius`` [m] of the segment ``start`` to ``end`` (3,), in D-H frame ``frame`` (0: base)."""

    frame: int
    start: Array
    end: Array
    radius: float

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            object.__setattr__(self, name, _array("capsule", name, getattr(self, name), (3,)))


@dataclass(frozen=True, eq=False)
class ArmConfig:
    """One nominal arm of N joints: geometry, base pose, payload and hidden effects.

    Attributes
    ----------
    rows : array, shape (N, 4)
        theta, d, a, alpha of ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)`` [rad, m, m, rad].
    limits, speed, acceleration : arrays, shapes (N, 2), (N,), (N,)
        Joint ranges [rad], greatest speeds and accelerations [rad/s, rad/s^2].
    T_C_B : array, shape (4, 4)
        Nominal base pose in the cell.
    smr_offset, smr_normal : arrays, shape (3,)
        SMR centre and viewing direction in the flange frame (D-H frame N).
    smr_acceptance : float
        Half-angle about the viewing direction within which the SMR returns the beam [rad].
    probe : array, shape (3, 3), or None
        Rotation of a 6-D probe's frame, whose origin the SMR is, in the flange frame; None: there is no such probe.
    probe_sigma : float
        Standard deviation of a measured orientation about each axis [rad].
    masses, centers_of_mass : arrays, shapes (N,), (N, 3)
        Of the body fixed to D-H frame i, in that frame [kg, m].
    payload_mass, payload_center : float, array (3,)
        Load in the flange frame [kg, m].
    effects : mapping
        Effect name -> its parameters; see ``drivers.plant.effects``.
    home : array, shape (N,), or None
        Joint angles at the start of the simulation [rad]; None: the zero position, clipped to the limits.
    """

    name: str
    rows: Array
    limits: Array
    speed: Array
    acceleration: Array
    T_C_B: Array
    smr_offset: Array
    smr_normal: Array
    smr_acceptance: float
    masses: Array
    centers_of_mass: Array
    payload_mass: float = 0.0
    payload_center: Array = field(default_factory=lambda: np.zeros(3))
    capsules: tuple[CapsuleConfig, ...] = ()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    home: Array | None = None
    probe: Array | None = None
    probe_sigma: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.rows)
        shapes: dict[str, tuple[int, ...]] = {
            "rows": (n, 4),
            "limits": (n, 2),
            "speed": (n,),
            "acceleration": (n,),
            "T_C_B": (4, 4),
            "smr_offset": (3,),
            "smr_normal": (3,),
            "masses": (n,),
            "centers_of_mass": (n, 3),
            "payload_center": (3,),
        }
        if self.home is not None:
            shapes["home"] = (n,)
        if self.probe is not None:
            shapes["probe"] = (3, 3)
        for name, shape in shapes.items():
            object.__setattr__(self, name, _array(f"arm {self.name}", name, getattr(self, name), shape))
        if self.home is None:
            object.__setattr__(self, "home", np.clip(np.zeros(n), self.limits[:, 0], self.limits[:, 1]))
        for capsule in self.capsules:
            if not 0 <= capsule.frame <= n:
                raise ValueError(f"arm {self.name}: capsule in frame {capsule.frame}, but frames are 0 to {n}")

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return len(self.rows)


@dataclass(frozen=True, eq=False)
class TrackerConfig:
    """The tracker: pose, field of view and accuracy.

    ``transverse`` and ``range`` are maximum permissible errors (constant [m], proportional [m/m]); half of one is one
    standard deviation at ``averaging_s`` seconds of averaging. Azimuth, elevation [rad], distance [m] limit its field.
    """

    T_C_M: Array
    transverse: tuple[float, float] = (15e-6, 6e-6)
    range: tuple[float, float] = (10e-6, 0.3e-6)
    azimuth: tuple[float, float] = (-2.0 * np.pi, 2.0 * np.pi)
    elevation: tuple[float, float] = (-np.pi / 2.0, np.pi / 2.0)
    distance: tuple[float, float] = (0.0, 80.0)
    averaging_s: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_C_M", _array("tracker", "T_C_M", self.T_C_M, (4, 4)))


@dataclass(frozen=True)
class TrueErrors:
    """Standard deviations of the true cell's differences from the nominal one.

    ``length`` [m]: offset of each axis line in both transverse directions. ``angle`` [rad]: its tilt about both, and
    the joint zero. ``base_length``, ``base_angle``: each coordinate of the base pose. ``smr`` [m]: each coordinate of
    the SMR offset. ``mass``: mass of each body, relative to the nominal one. ``probe`` [rad]: rotation of
    a 6-D probe about each axis.
    """

    length: float = 0.0
    angle: float = 0.0
    base_length: float = 0.0
    base_angle: float = 0.0
    smr: float = 0.0
    mass: float = 0.0
    probe: float = 0.0


@dataclass(frozen=True, eq=False)
class PlantConfig:
    """The whole simulated cell.

    ``repeatability`` [rad]: standard deviation of each joint's stop position. ``noise``: whether the tracker has noise.
    ``floor`` [m]: height in C of the floor plane of the collision monitor. ``holding_k`` [K]: steady-state rise of a
    joint at rest above the air; 5 to 15 K on real arms.
    ``earlier_jobs``: how often the cell was measured before, with noise of its own each time.
    ``factory``: how well controllers know their arms' axes from the factory; None: they have the published rows.
    """

    seed: int
    arms: tuple[ArmConfig, ...]
    tracker: TrackerConfig
    errors: TrueErrors = TrueErrors()
    repeatability: float = 0.0
    temperature_c: float = 20.0
    noise: bool = True
    floor: float = 0.0
    holding_k: float = 0.0
    factory: TrueErrors | None = None
    earlier_jobs: int = 0

    def random(self, stream: int) -> np.random.Generator:
        """Return the random numbers of one purpose: others for each job that measures."""
        jobs = (self.earlier_jobs,) if self.earlier_jobs else ()
        return np.random.default_rng(np.random.SeedSequence([self.seed, stream], spawn_key=jobs))

    def __post_init__(self) -> None:
        names = [arm.name for arm in self.arms]
        if len(set(names)) != len(names):
            raise ValueError(f"plant: two arms have the same name among {', '.join(names)}")
