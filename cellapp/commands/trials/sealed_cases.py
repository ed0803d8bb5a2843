"""Cases of sealed trials: single effects, pairs, triples, laws outside the library, nothing; order and arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.robot.effects import EFFECTS
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
LOOK_ALIKES: tuple[tuple[str, ...], ...] = (
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
IN_MOTION: tuple[tuple[str, ...], ...] = (
    ("joint_compliance",),
    ("backlash",),
    ("friction_windup",),
    ("encoder_eccentricity",),
    ("transmission_error",),
    ("joint_compliance", "backlash"),
    ("transmission_error", "friction_windup"),
)
"""Effects of joints, which recordings of motion show."""
FLIPPED: tuple[tuple[str, ...], ...] = (("backlash",), ("friction_windup",))
"""Effects that show in approach signs; hidden in cases whose signs have the wrong convention."""

IN_THE_LIBRARY = {"tracker_drift": "base_drift"}
"""Laws of the plant that one arm's data cannot tell from an effect of the library, and that effect."""
ONE, NONE, OUT, PAIR, TRIPLE, HARD, FLIP = "one", "none", "outside", "pair", "triple", "hard", "flipped"
MOTION = "motion"
KINDS = (ONE, NONE, OUT, PAIR, TRIPLE)
MIXED = "mixed"
MIXTURE = (ONE, ONE, NONE, ONE, OUT, ONE, ONE, PAIR, ONE, NONE)
"""Kinds of mixed cases; repeated kinds are more frequent."""


@dataclass(frozen=True)
class Case:
    """What one run hides."""

    kind: str
    slugs: tuple[str, ...] = ()
    look_alikes: bool = False
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
        PAIR: [*((pair, False) for pair in PAIRS), *((pair, True) for pair in LOOK_ALIKES)],
        TRIPLE: [(triple, False) for triple in TRIPLES],
        HARD: [(hard, False) for hard in HARD_CASES],
        FLIP: [(one, False) for one in FLIPPED],
        MOTION: [(joints, False) for joints in IN_MOTION],
    }
    counts = dict.fromkeys(menus, 0)
    found = []
    for place in range(n):
        here = MIXTURE[place % len(MIXTURE)] if kind == MIXED else kind
        menu, turn = menus[here], counts[here]
        counts[here] += 1
        slugs, look_alikes = menu[(seed + turn) % len(menu)]
        # with an even number of laws, each law would otherwise always be in the same arm
        shifted = turn + (turn // len(menu) if len(menu) % 2 == 0 else 0)
        found.append(Case(here, slugs, look_alikes, arms[shifted % len(arms)] if slugs else ""))
    order = np.random.default_rng([seed, 0x0DE2]).permutation(n)
    return [found[place] for place in order]
