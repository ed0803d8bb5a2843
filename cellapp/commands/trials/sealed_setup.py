"""Sealed trials: their cases, and their conditions: stops, joint ranges, masses, laws, what readings state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.planning.plan import make_stops, plan_stops, sample_stops
from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.progress import JobToken
from cellapp.ground.results import Record
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.transforms import Array
from drivers.plant import OUTSIDE, REALISTIC

PAIRS: tuple[tuple[str, ...], ...] = (
    ("joint_compliance", "backlash"),
    ("joint_compliance", "base_drift"),
    ("joint_compliance", "pedestal_coupling"),
    ("encoder_eccentricity", "target_slip"),
    ("backlash", "thermal_growth"),
    ("transmission_error", "base_step"),
    ("transmission_error", "friction_windup"),
    ("joint_compliance", "transmission_error"),
    ("pedestal_coupling", "thermal_growth"),
    ("joint_axis_wobble", "unsettled_measurement"),
    ("link_bending", "backlash"),
    ("encoder_eccentricity", "joint_drift"),
)
"""Ordinary pairs: neither effect imitates the other."""
CONFOUNDED: tuple[tuple[str, ...], ...] = (
    ("joint_compliance", "link_bending"),
    ("backlash", "unsettled_measurement"),
    ("backlash", "friction_windup"),
    ("joint_compliance", "pedestal_compliance"),
    ("joint_compliance", "encoder_eccentricity"),
    ("base_drift", "thermal_growth"),
    ("encoder_eccentricity", "transmission_error"),
)
"""Pairs in which each effect imitates a part of the other."""
TRIPLES: tuple[tuple[str, ...], ...] = (
    ("joint_compliance", "backlash", "base_drift"),
    ("joint_compliance", "encoder_eccentricity", "target_slip"),
    ("transmission_error", "friction_windup", "thermal_growth"),
    ("joint_axis_wobble", "backlash", "pedestal_coupling"),
    ("link_bending", "transmission_error", "unsettled_measurement"),
    ("payload_compliance", "joint_drift", "backlash"),
    ("pedestal_coupling", "encoder_eccentricity", "base_step"),
)
"""Ordinary triples: no effect imitates another."""

POSITION = "position"
"""Stands for any set of variables that states where in the workspace the SMR is."""
EXPECTED: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "dress_pack": ("joint 1", ("q1", "q2")),
    "crosstalk": ("joint 4", ("q5",)),
    "base_sway": ("base shift", ("time",)),
    "tool_sag": ("tool", ("q5",)),
    "wrist_cable": ("joint 6", ("q4",)),
    "draught": ("tracker azimuth", ("time",)),
    "elbow_hose": ("joint 3", ("q3", "q4")),
    "joint_coupling": ("joint 3", ("q2", "q4")),
    "warm_floor": ("base shift", ("temperature",)),
    "workspace_field": ("tracker", (POSITION,)),
}
"""Channel and variables that a correct description of each law outside the library states."""
HARD_CASES: tuple[tuple[str, ...], ...] = (
    ("workspace_field",),
    ("workspace_field", "joint_compliance"),
    ("joint_coupling",),
    ("joint_compliance", "backlash", "base_drift", "transmission_error"),
    ("joint_compliance", "encoder_eccentricity", "thermal_growth", "pedestal_coupling"),
    ("friction_windup", "backlash"),
    ("base_drift",),
    ("tracker_drift",),
    ("crosstalk",),
)
"""Cases once answered with a name too many: fields of short length, couplings, quadruples, slow drift; other laws."""
IN_THE_LIBRARY = {"tracker_drift": "base_drift"}
"""Laws of the plant that one arm's data cannot tell from an effect of the library, and that effect."""
ONE, NONE, OUT, PAIR, TRIPLE, HARD = "one", "none", "outside", "pair", "triple", "hard"
KINDS = (ONE, NONE, OUT, PAIR, TRIPLE)
MIXED = "mixed"
MIXTURE = (ONE, ONE, NONE, ONE, OUT, ONE, ONE, PAIR, ONE, NONE)
"""Kinds of mixed cases; repeated kinds are more frequent."""


@dataclass(frozen=True)
class Case:
    """What one run hides."""

    kind: str
    slugs: tuple[str, ...] = ()
    confounded: bool = False
    arm: str = ""


def library_name(plant: str) -> str:
    """Return the library's name of a plant effect."""
    return IN_THE_LIBRARY.get(plant, plant)


def cases(arms: Sequence[str], kind: str, n: int, seed: int) -> list[Case]:
    """Return what each of ``n`` runs hides: every law of a kind in turn, alternating between arms, in random order.

    The seed decides which law comes first, so that small numbers of runs do not always hide the same.
    """
    known = [slug for slug in REALISTIC if library_name(slug) in EFFECTS]
    menus: dict[str, list[tuple[tuple[str, ...], bool]]] = {
        ONE: [((slug,), False) for slug in known],
        NONE: [((), False)],
        OUT: [((slug,), False) for slug in OUTSIDE],
        PAIR: [*((pair, False) for pair in PAIRS), *((pair, True) for pair in CONFOUNDED)],
        TRIPLE: [(triple, False) for triple in TRIPLES],
        HARD: [(hard, False) for hard in HARD_CASES],
    }
    counts = dict.fromkeys(menus, 0)
    found = []
    for place in range(n):
        here = MIXTURE[place % len(MIXTURE)] if kind == MIXED else kind
        menu, turn = menus[here], counts[here]
        counts[here] += 1
        slugs, confounded = menu[(seed + turn) % len(menu)]
        # with an even number of laws, each law would otherwise always be in the same arm
        shifted = turn + (turn // len(menu) if len(menu) % 2 == 0 else 0)
        found.append(Case(here, slugs, confounded, arms[shifted % len(arms)] if slugs else ""))
    order = np.random.default_rng([seed, 0x0DE2]).permutation(n)
    return [found[place] for place in order]


MASS_ERROR = 0.05
"""Relative standard deviation of true link masses about the nominal ones: they are never known better."""
FEWEST_HELD_OUT = 10
FEWEST_STOPS = 15 + FEWEST_HELD_OUT
"""Least number of stops: 15 just determine the geometry, the others are held out."""
_NARROW_RAD = (math.radians(10.0), math.radians(50.0))
"""Range of the width of narrow joint ranges."""
_CENTRES = 30
"""Centres of narrow ranges that are tried: around some the wrist never shows the SMR to the tracker."""


class Setup(Record):
    """Conditions of a set of trials.

    Attributes
    ----------
    kind : str
        What is hidden: one of ``KINDS``, hard or mixed.
    laws : str
        same: by laws of the library's shape; other: by laws of other shapes.
    stops : int or None
        Stops of each run, in place of the profile's.
    ranges : str
        full; narrow: each joint moves over 10 to 50 degrees about a sampled centre.
    stated : bool
        Whether readings state their uncertainty.
    plan_method : str
        random or designed: how the stops of each run are chosen.
    """

    kind: str = ONE
    laws: str = "same"
    stops: int | None = None
    ranges: str = "full"
    stated: bool = True
    plan_method: str = "random"

    def check(self) -> None:
        """Raise ``InputError`` for an unknown word, or for what does not belong together."""
        for name, word, known in (
            ("kind", self.kind, (*KINDS, HARD, MIXED)),
            ("laws", self.laws, ("same", "other")),
            ("ranges", self.ranges, ("full", "narrow")),
            ("plan", self.plan_method, ("random", "designed")),
        ):
            if word not in known:
                raise InputError(f"--{name}: '{word}' is not known; {name.rstrip('s')}s are {', '.join(known)}")
        if self.plan_method == "designed" and self.ranges != "full":
            raise InputError("--plan designed needs the full joint ranges; leave out --ranges narrow")
        if self.stops is not None and self.stops < FEWEST_STOPS:
            raise InputError(f"--stops: {self.stops} are too few to identify the geometry; give {FEWEST_STOPS} or more")

    def cell(self, profile: Profile) -> Profile:
        """Return the profile with these trials' number of stops, splits and masses, and nothing hidden."""
        assert profile.plant is not None
        geometry = profile.plant.geometry.model_copy(update={"mass": MASS_ERROR})
        plant = profile.plant.model_copy(update={"geometry": geometry, "effects": {}})
        changes: dict[str, object] = {"plant": plant}
        if (stops := self.stops) is not None:
            quarter = stops // 4
            identify, validate = max(quarter, 15), max(quarter, FEWEST_HELD_OUT)
            splits = {
                "identify": identify,
                "validate_": validate,
                "train": stops - identify - validate,
                "pair_identify": quarter,
                "pair_validate": quarter,
            }
            changes["plan"] = profile.plan.model_copy(update={"stops": stops, "reserve": 0})
            changes["splits"] = profile.splits.model_copy(update=splits)
        return profile.model_copy(update=changes)

    def plan(self, profile: Profile, seed: int, job: JobToken) -> Mapping[str, Array] | PlannedStops:
        """Return stops of all arms, sampled or designed by ``seed``. Raises ``InputError`` if none are found."""
        if self.ranges == "full":
            if self.plan_method == "random":
                return plan_stops(profile.model_copy(update={"seed": seed}), job=job)
            designed = profile.plan.model_copy(update={"method": "designed"})
            return make_stops(profile.model_copy(update={"seed": seed, "plan": designed}), job=job)[0]
        rng = np.random.default_rng([seed, 0x4A44])
        for _ in range(_CENTRES):
            narrowed = _narrowed(profile, rng)
            try:
                return sample_stops(cell_bodies(narrowed), narrowed, profile.plan.stops, rng, job)
            except InputError:
                continue
        raise InputError(f"--ranges narrow: about none of {_CENTRES} centres does the tracker see enough stops")

    def reported(self, readings: Readings) -> Readings:
        """Return the readings as a run of these trials holds them."""
        return readings if self.stated else replace(readings, covariance_M=None)


USUAL_SETUP = Setup()
"""Default: one hidden effect in each run, by the library's laws, and stated Gaussian noise."""


def _narrowed(profile: Profile, rng: np.random.Generator) -> Profile:
    """Return the profile with joint limits of 10 to 50 degrees about a stop at which all SMRs are visible."""
    centre = sample_stops(cell_bodies(profile), profile, 1, rng)
    arms: dict[str, Arm] = {}
    for name, arm in profile.arms.items():
        outer = np.array(arm.joint_limits)
        half = 0.5 * rng.uniform(*_NARROW_RAD, len(outer))
        low, high = np.maximum(centre[name][0] - half, outer[:, 0]), np.minimum(centre[name][0] + half, outer[:, 1])
        limits = tuple(zip(low.tolist(), high.tolist(), strict=True))
        arms[name] = arm.model_copy(update={"limits": limits})
    return profile.model_copy(update={"arms": arms, "plan": profile.plan.model_copy(update={"ranges": None})})
