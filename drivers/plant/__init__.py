"""The simulated cell: physics written apart from any model that is fitted to it.

Arms are axes in space with bodies on them, statics is solved at the deflected posture, hidden effects have forms of
their own. A calibration that fits this cell has learnt something and has not read its own code back.
"""

from drivers.plant.clearance import Clearance
from drivers.plant.config import ArmConfig, CapsuleConfig, GeometryErrors, PlantConfig, TrackerConfig
from drivers.plant.mechanism import gravity_torques
from drivers.plant.plant import Plant, Target
from drivers.plant.suggest import OUTSIDE, REALISTIC, suggest

__all__ = [
    "OUTSIDE",
    "REALISTIC",
    "ArmConfig",
    "CapsuleConfig",
    "Clearance",
    "GeometryErrors",
    "Plant",
    "PlantConfig",
    "Target",
    "TrackerConfig",
    "gravity_torques",
    "suggest",
]
