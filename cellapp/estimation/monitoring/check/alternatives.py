"""Changes that a check looks for: of single parameters, of effects, and rigid motions of tracker, bases and SMRs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.monitoring.check.model import LENGTH_M, TRACKER, TURN_RAD, ArmBelief, ChangeKind, CheckBelief
from cellapp.estimation.prior.belief import is_own, is_smooth
from cellapp.estimation.prior.changes import parameter_words
from cellapp.estimation.prior.linear_model import design, term_columns
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import all_names, parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array

GROWTH = "growth of all links, as by temperature"
_FEWEST_LENGTHS = 2
"""Fewest lengths with which growth of all of them differs from the change of one."""
_TWIST_WORDS = ("along x", "along y", "along z", "about x", "about y", "about z")


@dataclass(frozen=True, eq=False)
class Direction:
    """One quantity that may change, and the size of the change that has to be detected.

    ``places`` are indices of the arm's parameters, or of the six components of the tracker's twist, each of which
    changes by its share; ``step`` is the size in ``unit``.
    """

    arm: str
    kind: ChangeKind
    what: str
    places: tuple[int, ...]
    step: float
    unit: str
    shares: tuple[float, ...] = (1.0,)

    def row_of(self, rows: Array) -> Array:
        """Compute the motion by one step from the motions (p, ...) by a unit of each parameter."""
        return np.asarray(self.step * np.tensordot(np.array(self.shares), rows[list(self.places)], axes=1))


@dataclass(frozen=True, eq=False)
class Alternative:
    """A nameable change: directions that change together, as indices into the list of directions."""

    arm: str
    kind: ChangeKind
    what: str
    members: tuple[int, ...]


def directions_of(belief: CheckBelief) -> list[Direction]:
    """List all directions of change of a cell: the tracker's twist, then those of every arm, parameter by parameter.

    The tracker rotates about the centre of the calibration's points.
    """
    found = [
        Direction(
            TRACKER, "tracker", f"tracker {words}", (k,), LENGTH_M if k < 3 else TURN_RAD, "m" if k < 3 else "rad"
        )
        for k, words in enumerate(_TWIST_WORDS)
    ]
    for name, arm in belief.arms.items():
        found += _of_geometry(name, arm)
        found += _of_effects(name, arm)
    return found


def alternatives_of(belief: CheckBelief, directions: Sequence[Direction]) -> list[Alternative]:
    """List what may have changed, causes that affect most points first: tracker, bases, SMRs, parameters, effects.

    Each parameter is an alternative; so are all values of an effect at one place together. A tracker that was set up
    anew is not an alternative.
    """
    places: dict[tuple[str, ChangeKind, str], list[int]] = {}
    for k, one in enumerate(directions):
        what = {"tracker": "tracker", "base": "base", "smr": "SMR"}.get(one.kind, one.what)
        places.setdefault((one.arm, one.kind, what), []).append(k)
    order = ("tracker", "base", "smr", "parameter", "effect")
    found = [Alternative(*key, tuple(members)) for key, members in places.items()]
    if belief.station_free:
        found = [one for one in found if one.kind != "tracker"]
    return sorted(found, key=lambda one: order.index(one.kind))


def centre_of(belief: CheckBelief) -> Array:
    """Return the centre (3,) of the points of the calibration [m]."""
    return np.asarray(np.concatenate([arm.positions.readings.p_M for arm in belief.arms.values()]).mean(axis=0))


def _of_geometry(name: str, arm: ArmBelief) -> list[Direction]:
    joints = arm.model.geometry.joints
    names, found = all_names(joints), []
    for place, column in enumerate(arm.columns):
        word = names[column]
        kind: ChangeKind = "parameter" if is_own(column, joints) else ("base" if column < 6 else "smr")
        what = parameter_words(word) if kind == "parameter" else f"{kind} {word}"
        unit = parameter_unit(word)
        found.append(Direction(name, kind, what, (place,), LENGTH_M if unit == "m" else TURN_RAD, unit))
    return found


def _of_effects(name: str, arm: ArmBelief) -> list[Direction]:
    """List values of laws; a step moves the SMR by 0.05 mm rms over the readings of the calibration.

    If orientation is measured, motion and rotation count together, with 50 µrad equal to 0.05 mm.

    Values of free functions are left out (many, and small by their priors), and values whose step is physically
    impossible: a joint without load shows no stiffness.
    """
    columns = term_columns(arm.model, arm.measured)
    every = design(arm.model, arm.measured, arm.columns)
    rms = np.sqrt(np.sum(every[len(arm.columns) :] ** 2, axis=1) / len(arm.positions))
    found, place = _growth(name, arm, every), len(arm.columns)
    for term in arm.model.effects:
        for value, unit in enumerate(term.units):
            k = place - len(arm.columns)
            if not is_smooth(term) and value < len(term.law_names) and rms[k] * columns[k].upper > LENGTH_M:
                what = f"{EFFECTS[term.slug].title}, {columns[k].where}"
                found.append(Direction(name, "effect", what, (place,), LENGTH_M / float(rms[k]), unit))
            place += 1
    return found


def _growth(name: str, arm: ArmBelief, rows: Array) -> list[Direction]:
    """Build the direction of proportional growth of all link lengths (temperature) from motions ``rows`` (p, d)."""
    nominal, names = arm.model.nominal.vector(), parameter_names(arm.model.geometry.joints)
    places = [
        place
        for place, column in enumerate(arm.columns)
        if is_own(column, arm.model.geometry.joints) and parameter_unit(names[column]) == "m" and nominal[column]
    ]
    if len(places) < _FEWEST_LENGTHS:
        return []
    shares = nominal[[arm.columns[place] for place in places]]
    rms = math.sqrt(float(np.sum((shares @ rows[places]) ** 2)) / len(arm.positions))
    return [Direction(name, "effect", GROWTH, tuple(places), LENGTH_M / rms, "m/m", tuple(shares.tolist()))]
