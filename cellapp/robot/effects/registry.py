"""The registry of effects, and what installed distributions add to this program: in words, and for a run.

A new effect is one file and one line here, or a plug-in; effects of plug-ins come after all others.

The registries do the finding, each in its own group of entry points; see ``drivers.plugins``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.profile.device_plugins import plugins_of_devices
from cellapp.ground.version import __version__
from cellapp.robot.effects.backlash import Backlash, FrictionWindup
from cellapp.robot.effects.base_motion import BaseDrift, BaseStep
from cellapp.robot.effects.effect import Effect
from cellapp.robot.effects.joint_axis import JointAxisRunout, JointAxisWobble
from cellapp.robot.effects.joint_compliance import JointCompliance, PayloadCompliance
from cellapp.robot.effects.link_bending import LinkBending
from cellapp.robot.effects.measurement import (
    TargetIncidence,
    TargetSlip,
    TrackerAngleError,
    TrackerDistanceOffset,
    TrackerScale,
    UnsettledMeasurement,
)
from cellapp.robot.effects.pedestal import PedestalCompliance, PedestalCoupling
from cellapp.robot.effects.periodic import EncoderEccentricity, TransmissionError
from cellapp.robot.effects.thermal import JointDrift, ThermalGrowth
from cellapp.robot.effects.unknown import Unknown
from drivers.plugins import Plugin, Registry

_DECLARED = ("slug", "title", "meaning", "variables", "forms")
"""What every effect declares, besides its columns."""


def registered(effects: Iterable[Effect]) -> Mapping[str, Effect]:
    """Map slugs to effects; raise ``ValueError`` if a declaration is incomplete or ambiguous."""
    found: dict[str, Effect] = {}
    for effect in effects:
        if effect.slug in found:
            raise ValueError(f"two effects are called {effect.slug}")
        found[effect.slug] = effect
        names = [form.name for form in effect.forms]
        if len(set(names)) < len(names):
            raise ValueError(f"effect {effect.slug}: two laws have the same name")
        silent = [form.name for form in effect.forms if not form.words]
        if silent or not effect.title:
            raise ValueError(f"effect {effect.slug}: no words for people{f' for law {silent[0]}' if silent else ''}")
    return found


def _effect(name: str, found: object) -> Effect:
    """Return the effect of a plug-in; raise ``ValueError`` if it is no effect or its declaration is invalid."""
    if not (isinstance(found, type) and issubclass(found, Effect)):
        raise ValueError(f"expected a class made from cellapp.robot.effects.Effect, got {found!r}")
    lacking = [*sorted(found.__abstractmethods__), *(one for one in _DECLARED if not hasattr(found, one))]
    if lacking:
        raise ValueError(f"class {found.__name__} lacks {', '.join(lacking)}")
    if found.slug != name:
        raise ValueError(f"class {found.__name__} has the slug '{found.slug}'; the entry point must have the same name")
    return registered((found(),))[name]


_LIBRARY: Mapping[str, Effect] = registered(
    (
        JointCompliance(),
        PayloadCompliance(),
        EncoderEccentricity(),
        TransmissionError(),
        Backlash(),
        FrictionWindup(),
        UnsettledMeasurement(),
        JointAxisWobble(),
        JointAxisRunout(),
        ThermalGrowth(),
        JointDrift(),
        BaseDrift(),
        BaseStep(),
        TargetSlip(),
        PedestalCompliance(),
        PedestalCoupling(),
        LinkBending(),
        TrackerScale(),
        TrackerDistanceOffset(),
        TrackerAngleError(),
        TargetIncidence(),
    )
)
EFFECTS: Registry[Effect] = Registry("cellapp.robot.effects", "effect", _LIBRARY, _effect, last={Unknown.slug: Unknown})


# -- Plug-ins of effects and devices ----------------------------------------------------------------------------------


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
