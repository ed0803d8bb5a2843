"""The profile's section ``obstacles``: what stands in the cell, or is mounted on an arm, beside the arms themselves."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.quantities import CellLength, Turn
from drivers.settings import Section

Size = Annotated[CellLength, Field(gt=0.0)]


class Placement(Section):
    """Pose of an obstacle in the frame that it is fixed to; ``rpy``: ``R = rot_z(yaw) rot_y(pitch) rot_x(roll)``."""

    position: tuple[CellLength, CellLength, CellLength] = (0.0, 0.0, 0.0)
    rpy: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)


class Obstacle(Section):
    """What all shapes share. ``fixed_to``: the cell frame C, or base or flange of ``arm``."""

    fixed_to: Literal["cell", "base", "flange"] = "cell"
    arm: str | None = None
    pose: Placement = Placement()

    @model_validator(mode="after")
    def _arm_where_needed(self) -> Self:
        if (self.fixed_to == "cell") != (self.arm is None):
            need = "must not be given" if self.fixed_to == "cell" else "is missing"
            raise ValueError(f"arm: {need} for an obstacle that is fixed to the {self.fixed_to}")
        return self


class BoxObstacle(Obstacle):
    """A box with its centre at the pose; ``size`` are its full lengths along x, y, z."""

    shape: Literal["box"]
    size: tuple[Size, Size, Size]


class CylinderObstacle(Obstacle):
    """A cylinder with flat ends, its axis along z, its centre at the pose."""

    shape: Literal["cylinder"]
    radius: Size
    length: Size


class CapsuleObstacle(Obstacle):
    """All points within ``radius`` of a segment of ``length`` along z, its centre at the pose."""

    shape: Literal["capsule"]
    radius: Size
    length: Size


class SphereObstacle(Obstacle):
    """A sphere with its centre at the pose."""

    shape: Literal["sphere"]
    radius: Size


class MeshObstacle(Obstacle):
    """A triangle mesh from an STL file, relative to the profile; ``scale`` converts its unit to metres."""

    shape: Literal["mesh"]
    file: str
    scale: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0


AnyObstacle = Annotated[
    BoxObstacle | CylinderObstacle | CapsuleObstacle | SphereObstacle | MeshObstacle, Field(discriminator="shape")
]
Obstacles = dict[str, AnyObstacle]
"""Name -> obstacle."""
