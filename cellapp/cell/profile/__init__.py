"""The profile as a file: the description of a cell in YAML, checked and frozen."""

from cellapp.cell.profile.loader import load_profile, profile_from_dict, profile_from_json, profile_to_json

__all__ = ["load_profile", "profile_from_dict", "profile_from_json", "profile_to_json"]
