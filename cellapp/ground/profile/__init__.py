"""What a cell is: the typed sections of a profile. ``cell.profile`` reads and writes them as YAML."""

from cellapp.ground.profile.schema import (
    SAME_PAYLOAD_KG,
    Arm,
    CellKind,
    DiscoverySettings,
    Network,
    Pose,
    Priors,
    Profile,
    Sensors,
    Splits,
)
from cellapp.ground.profile.sections import CellPoint

__all__ = [
    "SAME_PAYLOAD_KG",
    "Arm",
    "CellKind",
    "CellPoint",
    "DiscoverySettings",
    "Network",
    "Pose",
    "Priors",
    "Profile",
    "Sensors",
    "Splits",
]
