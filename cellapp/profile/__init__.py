"""The profile: the description of a cell in YAML, checked and frozen."""

from cellapp.profile.loader import load_profile, profile_from_json, profile_to_json
from cellapp.profile.schema import Arm, CellPoint, Discovery, Pose, Priors, Profile, Sensors, Splits

__all__ = [
    "Arm",
    "CellPoint",
    "Discovery",
    "Pose",
    "Priors",
    "Profile",
    "Sensors",
    "Splits",
    "load_profile",
    "profile_from_json",
    "profile_to_json",
]
