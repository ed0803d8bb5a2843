"""Findings while the tests are driven, and the results made from them, complete or not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.cell.driving.iso9283.alignment import Alignment
from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube
from cellapp.estimation.iso9283.evaluate import (
    ArmProgramme,
    Measurements,
    PathRuns,
    Place,
    cooperative_characteristics,
    directional_characteristics,
    distance_characteristics,
    drift_characteristics,
    path_characteristics,
    pose_characteristics,
)
from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.estimation.iso9283.records import (
    ArmIso9283,
    BaseAlignment,
    CommandedTests,
    PairIso9283,
    PathCharacteristics,
    SpeedSeries,
)
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, xyz_of
from cellapp.robot.model import CellModel

_ENDED = "the job ended before"
_NO_PAIR = "there are no two poses at which both arms are clear and seen together"


@dataclass(eq=False)
class IsoFindings:
    """Measurements, refusals and notes so far."""

    model: CellModel | None = None
    measured: Measurements = field(default_factory=Measurements)
    alignments: dict[str, Alignment] = field(default_factory=dict)
    cubes: dict[str, ChosenCube] = field(default_factory=dict)
    programmes: dict[tuple[str, IsoCommands], ArmProgramme] = field(default_factory=dict)
    pairs: dict[tuple[str, str], list[tuple[str, str]]] = field(default_factory=dict)
    refused: dict[str, dict[str, str]] = field(default_factory=dict)
    wanted: dict[Place, int] = field(default_factory=dict)
    missed: dict[Place, str] = field(default_factory=dict)
    paths: list[PathRuns] = field(default_factory=list)
    also_speeds: tuple[float, ...] = ()
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def refuse(self, name: str, tests: Iterable[IsoTest], reason: str) -> None:
        """Record why an arm's tests are not made, or not completely."""
        reasons = self.refused.setdefault(name, {})
        for test in tests:
            reasons[test] = f"{reasons[test]}; {reason}" if test in reasons else reason


def arm_results(
    profile: Profile, found: IsoFindings, arms: Sequence[str], rng: np.random.Generator
) -> dict[str, ArmIso9283]:
    """Return cube, base and characteristics of each arm that was to be tested."""
    results = {}
    for name in arms:
        kinds = [kind for arm, kind in found.programmes if arm == name]
        tests = {kind: _commanded(found, name, kind, rng) for kind in kinds}
        results[name] = ArmIso9283(
            payload_kg=profile.arms[name].payload.mass,
            cube=found.cubes[name].record() if name in found.cubes else None,
            base=_base(found, name),
            tests={kind: one for kind, one in tests.items() if one != CommandedTests()},
            refused=found.refused.get(name, {}),
        )
    return results


def pair_results(found: IsoFindings, rng: np.random.Generator) -> tuple[PairIso9283, ...]:
    """Return the characteristics of each pair of arms whose cooperative test was requested."""
    return tuple(_pair(found, pair, rng) for pair in found.pairs)


def missing_words(found: IsoFindings, tests: Sequence[IsoTest]) -> tuple[str, ...]:
    """Return places and paths with too few cycles, and arms and pairs that were not tested at all, with reasons.

    ``tests`` are the requested ones. If a cell can make some tests but not another, that one is refused, not missing.
    """
    words = []
    for place, wanted in found.wanted.items():
        groups = found.measured.groups(place) or [0]
        n = min(len(found.measured.at(place, group)) for group in groups)
        if n < wanted:
            words.append(f"{place}: {n} of {counted(wanted, 'cycle')}: {found.missed.get(place, _ENDED)}")
    for where, runs in _runs_of_paths(found):
        if (n := len(runs.tracks)) < runs.wanted:
            words.append(f"{where}: {n} of {counted(runs.wanted, 'cycle')}: {'; '.join(runs.problems) or _ENDED}")
    for name, refused in found.refused.items():
        if set(tests) - {"cooperative"} <= set(refused):
            words += [f"arm {name}: {reason}" for reason in dict.fromkeys(refused.values())]
    words += [f"cooperative of {' and '.join(pair)}: {_NO_PAIR}" for pair, poses in found.pairs.items() if not poses]
    return tuple(words)


def lost_beam_words(found: IsoFindings) -> tuple[str, ...]:
    """Return the paths on which the beam broke, and what was done."""
    lost = ((where, sum(track.lost_beams for track in runs.tracks)) for where, runs in _runs_of_paths(found))
    return tuple(
        f"{where}: the beam broke {counted(count, 'time')}; these cycles were driven again from their beginning"
        for where, count in lost
        if count
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _runs_of_paths(found: IsoFindings) -> Iterator[tuple[str, PathRuns]]:
    """Yield every path that was to be driven, with its name."""
    for runs in found.paths:
        at = f", {runs.series:.0%} of the speed" if runs.series else ""
        yield f"path of {runs.arm}, {runs.commands} commands, {runs.name}{at}", runs


def _commanded(found: IsoFindings, name: str, kind: IsoCommands, rng: np.random.Generator) -> CommandedTests:
    arm, measured, base_M = found.programmes[name, kind], found.measured, _base_rotation(found, name, kind)
    series = [
        SpeedSeries(
            speed_share=share,
            pose=pose_characteristics(arm, measured, base_M, rng, share),
            path=_paths(found, name, kind, rng, share),
        )
        for share in found.also_speeds
    ]
    return CommandedTests(
        pose=pose_characteristics(arm, measured, base_M, rng),
        multidirectional=directional_characteristics(arm, measured, base_M, rng),
        distance=distance_characteristics(arm, measured, rng),
        drift=drift_characteristics(arm, measured, base_M, rng),
        path=_paths(found, name, kind, rng),
        series=tuple(one for one in series if one.pose or one.path),
    )


def _paths(
    found: IsoFindings, name: str, kind: IsoCommands, rng: np.random.Generator, series: float = 0.0
) -> tuple[PathCharacteristics, ...]:
    own = [runs for runs in found.paths if (runs.arm, runs.commands, runs.series) == (name, kind, series)]
    return tuple(one for runs in own if (one := path_characteristics(runs, rng)) is not None)


def _base_rotation(found: IsoFindings, name: str, kind: IsoCommands) -> Array:
    """Return the rotation (3, 3) of the base in M that the commands assume."""
    assert found.model is not None
    arm = found.model.arms[name]
    return np.asarray((arm.nominal if kind == "nominal" else arm.geometry).T_M_B()[:3, :3])


def _base(found: IsoFindings, name: str) -> BaseAlignment | None:
    alignment = found.alignments.get(name)
    if alignment is None:
        return None
    frames = [frame for (arm, _), one in found.programmes.items() if arm == name for frame in one.frame.values()]
    variance = float(np.mean([np.trace(frame) / 3.0 for frame in frames])) if frames else 0.0
    return BaseAlignment(
        n=alignment.n,
        rms_mm=alignment.rms_m * 1e3,
        uncertainty_mm=float(np.sqrt(variance)) * 1e3,
        smr_offset_mm=xyz_of(alignment.arm.geometry.tool * 1e3),
    )


def _pair(found: IsoFindings, pair: tuple[str, str], rng: np.random.Generator) -> PairIso9283:
    first, second = pair
    vector, distance = {}, {}
    for (name, kind), programme in found.programmes.items():
        other = found.programmes.get((second, kind))
        if name != first or other is None:
            continue
        vectors, lengths = cooperative_characteristics((programme, other), found.measured, rng)
        if vectors:
            vector[kind], distance[kind] = vectors, lengths
    return PairIso9283(arms=pair, vector=vector, distance=distance, refused="" if found.pairs[pair] else _NO_PAIR)
