"""Possible changes of an arm since an earlier calibration: candidates, and proven ones in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from cellapp.estimation.calibration.records import SignatureChange
from cellapp.estimation.prior.belief import Belief
from cellapp.estimation.prior.evidence import Candidate, Estimate
from cellapp.robot.effects import EFFECTS, EffectColumn
from cellapp.robot.kinematics.chain import parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array

SURE = 5.0
"""Gain of the log likelihood that a change needs beyond the log of the number of candidates: twice of it is very strong
evidence (Kass, Raftery, J. Am. Stat. Ass. 90 (1995) 773)."""
_ALIKE = 3.0
"""Difference of gains within which another change counts as equally good: a Bayes factor of 20."""
_GONE = 2.0
"""Standard errors within which the new value of an effect counts as zero."""
_SHOWN = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}
"""Displayed units and their factors."""
_WORDS = {"theta": "zero of joint", "d": "length d of link", "a": "length a of link", "alpha": "twist alpha of link"}
_BETA = "twist beta of link"


def candidates(belief: Belief, columns: Sequence[EffectColumn]) -> list[Candidate]:
    """Return the candidates: single geometric parameters, and the parameters of each effect at each place.

    ``columns`` are those of the belief's effects, in the order of their values.
    """
    names, size = parameter_names(belief.nominal.joints), belief.jump_sd
    found = [
        Candidate(parameter_words(names[column]), np.array([place], dtype=np.intp), size[[place]])
        for place, column in enumerate(belief.columns)
    ]
    first = len(belief.columns)
    places: dict[str, list[int]] = {}
    slugs = [term.slug for term in belief.terms for _ in term.names]
    for k, (slug, column) in enumerate(zip(slugs, columns, strict=True)):
        places.setdefault(f"{EFFECTS[slug].title}, {column.where}", []).append(first + k)
    for what, some in places.items():
        rows = np.array(some, dtype=np.intp)
        found.append(Candidate(what, rows, size[rows]))
    return found


def change_of(
    belief: Belief, one: Candidate, found: Estimate, rows: Array, rivals: Sequence[str], since: str, tested: int
) -> SignatureChange:
    """Describe a proven change; ``rows`` (r, d) [m] are the derivatives of the SMR coordinates by its parameters."""
    part = belief.parts[int(one.places[0])]
    moved = float(np.sqrt(3.0 * np.mean((found.values @ rows) ** 2))) * 1e3
    errors = np.sqrt(np.diag(found.covariance))
    gone = part == "effects" and bool(np.all(np.abs(belief.mean[one.places] + found.values) <= _GONE * errors))
    after = f"; as likely: {', '.join(rivals)}" if rivals else ""
    change = SignatureChange(
        what=one.what,
        part=part,
        evidence=2.0 * found.gain,
        moved_mm=moved,
        rivals=tuple(rivals),
        sentence=f"{one.what} {'vanished' if gone else 'changed'} since {since}: {moved:.3f} mm rms at the SMR"
        f" (evidence {2.0 * found.gain:.0f}){after}",
    )
    if len(one.places) > 1:
        return change
    value, error = float(found.values[0]), float(errors[0])
    sigmas = abs(value) / error
    unit = _unit(belief, int(one.places[0]))
    factor, shown = _SHOWN.get(unit, (1.0, unit))
    return change.model_copy(
        update={
            "value": value,
            "standard_error": error,
            "unit": unit,
            "sigmas": sigmas,
            "p_value": min(1.0, tested * float(scipy.special.erfc(sigmas / math.sqrt(2.0)))),
            "sentence": f"{one.what}: {'vanished, ' if gone else ''}{factor * value:+.3g} {shown}"
            f" +- {factor * error:.2g} since {since} ({sigmas:.1f} sigma){after}",
        }
    )


def alike(all_candidates: Sequence[Candidate], found: Sequence[Estimate], best: int) -> list[str]:
    """Return the candidates that explain the readings about as well as the best one."""
    limit = found[best].gain - _ALIKE
    return [
        one.what
        for number, (one, its) in enumerate(zip(all_candidates, found, strict=True))
        if number != best and its.gain > limit
    ]


def _unit(belief: Belief, place: int) -> str:
    if place < len(belief.columns):
        return parameter_unit(parameter_names(belief.nominal.joints)[belief.columns[place]])
    units = [unit for term in belief.terms for unit in term.units]
    return units[place - len(belief.columns)]


def parameter_words(name: str) -> str:
    """Return a parameter in words: ``theta3`` as ``zero of joint 3``."""
    letters = name.rstrip("0123456789")
    number = name.removeprefix(letters)
    return f"{_WORDS.get(letters, _BETA)} {number}"
