"""Findings of the doctor about several SMRs on a flange, and about reference nests that tie tracker stations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path

import numpy as np

from cellapp.cell.driving.nests import Nests
from cellapp.cell.run.nests import nest_offsets
from cellapp.cell.run.stations import read_reference_nests, tie_sentences
from cellapp.cell.safety.gate import CellBodies, predicted_smr, visible
from cellapp.estimation.nests import NestShape
from cellapp.estimation.uncertainty.budget import permissible_mm
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.acceptance import MPE_SHARE
from cellapp.ground.profile.smr import Smr
from cellapp.robot.kinematics.transforms import Array
from drivers.findings import Finding

_DISTANCE_M = 1e-3
"""Largest difference [m] between offsets and a stated distance: offsets are often taken from drawings."""
_LOOSE_MM = 0.05
"""Uncertainty [mm] above which a tie is reported as loose: the tracker's own is some 40 µm at 4 m."""


def nest_findings(cell: CellBodies, profile: Profile, homes: Mapping[str, Array]) -> Iterator[Finding]:
    """Check each placed arm with several SMRs: offsets, uncertainty of the orientation, visibility at home."""
    nests = Nests.of(profile.model_copy(update={"arms": {name: profile.arms[name] for name in homes}}), cell)
    for name in nests.names:
        smr, subject = profile.arms[name].smr, f"arm {name}: nests"
        if wrong := _contradictions(smr):
            yield Finding(subject, "failed", f"{'; '.join(wrong)}: correct smr.offset, smr.nests or smr.distances")
            continue
        offsets = nest_offsets(smr)
        known = np.isfinite(offsets).all(axis=1)
        if len(smr.names) < 3:
            yield Finding(subject, "warning", "two nests tell no orientation, but for the rotation between them")
        elif known.all() and not NestShape(smr.names, offsets, float("nan")).spans:
            yield Finding(subject, "failed", "they stand on one line, so that no orientation follows: move one aside")
        else:
            yield Finding(subject, "ok", _orientation(cell, profile, name, homes[name], offsets[known]))
        yield _at_home(cell, nests, profile, name, homes)


def reference_nest_findings(path: Path, cell: CellBodies | None, homes: Mapping[str, Array]) -> Iterator[Finding]:
    """Report how well the nests of a file tie each station to the first one, at the SMR of each arm at home."""
    subject = "reference nests"
    try:
        first, ties = read_reference_nests(path, {})
    except InputError as error:
        yield Finding(subject, "failed", str(error))
        return
    at = {} if cell is None else {arm: predicted_smr(cell, arm, q[None]) for arm, q in homes.items()}
    for (name, tie), sentence in zip(ties.items(), tie_sentences(first, ties, {}), strict=True):
        known_mm = {arm: 1e3 * float(tie.uncertainty(p_M)[0]) for arm, p_M in at.items()}
        words = "".join(f"; a coordinate of arm {arm} at home to {mm:.3f} mm" for arm, mm in known_mm.items())
        loose = max(known_mm.values(), default=0.0) > _LOOSE_MM
        advice = "; more nests, farther apart and around the arms, tie it better" if loose else ""
        yield Finding(f"{subject}: station {name}", "warning" if loose else "ok", f"{sentence}{words}{advice}")


# -- inside -----------------------------------------------------------------------------------------------------------


def _contradictions(smr: Smr) -> list[str]:
    """Return stated distances that known offsets contradict, and nests at the same position."""
    places = dict(zip(smr.names, nest_offsets(smr), strict=True))
    found = []
    for one in smr.distances:
        first, second = one.between
        apart = float(np.linalg.norm(places[first] - places[second]))
        if abs(apart - one.distance) > _DISTANCE_M:  # False if an offset is unknown (NaN)
            said = f"distances say {one.distance * 1e3:.2f} mm"
            found.append(f"offsets put {first} and {second} {apart * 1e3:.2f} mm apart, {said}")
    return found + [
        f"{first} and {second} are at the same place"
        for first, second in combinations(smr.names, 2)
        if float(np.linalg.norm(places[first] - places[second])) < _DISTANCE_M
    ]


def _orientation(cell: CellBodies, profile: Profile, name: str, home: Array, known: Array) -> str:
    """Return how well the nests determine the orientation at home: about the least certain axis."""
    words = f"{len(profile.arms[name].smr.names)} nests"
    if len(known) < 3:
        return f"{words}; what they tell of the orientation is known once they are measured"
    distance_m = float(np.linalg.norm(predicted_smr(cell, name, home[None])[0]))
    sigma_mm = permissible_mm(profile.tracker.transverse, distance_m) * MPE_SHARE[profile.tolerances.mpe]
    r = known - known.mean(axis=0)
    information = np.einsum("ka,ka->", r, r) * np.eye(3) - r.T @ r
    least = float(np.sqrt(1.0 / np.linalg.eigvalsh(information)[0]))
    return f"{words}, which tell the orientation at home to {sigma_mm * least:.2f} mrad about the axis known least"


def _at_home(cell: CellBodies, nests: Nests, profile: Profile, name: str, homes: Mapping[str, Array]) -> Finding:
    """Report which nests the tracker sees with all arms at home."""
    at = {arm: q[None] for arm, q in homes.items()}
    others = {arm: q for arm, q in at.items() if arm != name}
    seen = {nests.names[name]: bool(visible(cell, name, at[name], others)[0])}
    seen |= {nest: bool(rows[0]) for nest, rows in nests.seen(name, at).items()}
    unknown = [nest for nest in profile.arms[name].smr.names if nest not in seen]
    sees = [nest for nest, is_seen in seen.items() if is_seen]
    parts = [f"at home the tracker sees {', '.join(sees) or 'none of them'}"]
    hidden = [nest for nest, is_seen in seen.items() if not is_seen]
    parts += [f"not {', '.join(hidden)}"] if hidden and sees else []
    parts += [f"{', '.join(unknown)} cannot be pointed at: the offset is unknown"] if unknown else []
    return Finding(f"arm {name}: nests at home", "ok", "; ".join(parts))
