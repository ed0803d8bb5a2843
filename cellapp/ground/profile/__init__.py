"""What a cell is: the typed sections of a profile. ``cell.profile`` reads and writes them as YAML."""

from cellapp.ground.profile.schema import (
    Arm,
    CellKind,
    CellPoint,
    Discovery,
    Network,
    Pose,
    Priors,
    Profile,
    Sensors,
    Splits,
    TorqueSensing,
)

__all__ = [
    "Arm",
    "CellKind",
    "CellPoint",
    "Discovery",
    "Network",
    "Pose",
    "Priors",
    "Profile",
    "Sensors",
    "Splits",
    "TorqueSensing",
]
