"""The simulated cell: physics that shares no code with the models fitted to it.

Arms are axes in space with bodies on them, statics is solved at the deflected posture, and hidden effects have their
own equations. A calibration that fits this cell therefore does not merely reproduce its own code.
"""

from drivers.plant.clearance import Clearance
from drivers.plant.config import ArmConfig, CapsuleConfig, PlantConfig, TrackerConfig, TrueErrors
from drivers.plant.mechanism import gravity_torques
from drivers.plant.plant import Plant
from drivers.plant.random_effects import ONLY_MOVING, OUTSIDE, REALISTIC, suggest, suggest_other_law
from drivers.plant.true_arm import TrueTarget

__all__ = [
    "ONLY_MOVING",
    "OUTSIDE",
    "REALISTIC",
    "ArmConfig",
    "CapsuleConfig",
    "Clearance",
    "Plant",
    "PlantConfig",
    "TrackerConfig",
    "TrueErrors",
    "TrueTarget",
    "gravity_torques",
    "suggest",
    "suggest_other_law",
]
