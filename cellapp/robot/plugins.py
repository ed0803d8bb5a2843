"""What installed distributions add to this program, in words, and which of them took part in a run.

The registries do the finding, each in its own group of entry points; see ``drivers.plugins``.
"""

from __future__ import annotations

from collections.abc import Iterable

from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.profile.device_plugins import plugins_of_devices
from cellapp.ground.version import __version__
from cellapp.robot.effects import EFFECTS
from drivers.plugins import Plugin


def in_words(plugins: Iterable[Plugin]) -> dict[str, str]:
    """What each distribution adds, by its name and version: ``"lift 1.0" -> "kind of arm lift, effect belt"``."""
    added = grouped((f"{one.distribution} {one.version}", f"{one.what} {one.name}") for one in plugins)
    return {name: ", ".join(words) for name, words in sorted(added.items())}


def program_of(profile: Profile) -> str:
    """This program and the plug-ins that take part in the work on a profile, with their versions.

    These are the drivers that the profile names, and all effects: each is a candidate in every plan and discovery.
    """
    used = (*plugins_of_devices(profile), *(one for one in EFFECTS.plugins if not one.problem))
    plugins = [f"{name} ({words})" for name, words in in_words(used).items()]
    return " with ".join([f"cellapp {__version__}", *([" and ".join(plugins)] if plugins else [])])
