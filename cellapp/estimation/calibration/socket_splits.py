"""Choice of held-out points for a ball in sockets: whole points, with all points that known distances tie to them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.robot.kinematics.transforms import Array

_HELD_OUT = 4
"""Every fourth placement is held out, at least one."""
_FEWEST = 3
"""Number of placements from which one can be spared; with fewer, a fifth of the readings is held out."""
_FIFTH = 5


def draw_point_splits(
    readings: Mapping[str, Readings], positions: Mapping[str, Array], seed: int
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """Draw a split for each reading of each arm by the seed; return splits and notes.

    ``positions`` (n, 3) [m] are approximate positions of the ball. The points of one placement are held out together,
    so that the evaluation is at a place from which the arm has not learnt.
    """
    words: dict[str, tuple[str | None, ...]] = {}
    notes: list[str] = []
    generator = np.random.default_rng([seed, 0x50C])
    for name, its in readings.items():
        contacts = Contacts.of(its)
        groups = contacts.placements(contacts.centres(positions[name]))[contacts.index]
        placements = generator.permutation(np.unique(groups))
        if len(placements) < _FEWEST:
            held_out = generator.permutation(len(its)) % _FIFTH == 0
            notes.append(
                f"arm '{name}': {len(placements)} placement(s) of sockets, too few to hold one out; held-out readings"
                " share their points with those that are learnt from: touch sockets at three places or more"
            )
        else:
            held_out = np.isin(groups, placements[: max(1, len(placements) // _HELD_OUT)])
        words[name] = tuple("validate" if out else "identify" for out in held_out.tolist())
    return words, tuple(notes)
