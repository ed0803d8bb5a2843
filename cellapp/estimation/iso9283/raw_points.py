"""Table of every measured point of the tests with its time, from which another program can compute the same results.

A row is ``commanded``, the target position of an SMR, or ``measured``. Commanded positions appear once for each place
of a test. Those of a path are its evaluation points, in order, with the direction of the path: the normal of the plane
whose crossing is evaluated. Measured points of a path are all points of each cycle in order of time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from cellapp.estimation.iso9283.evaluate import ArmProgramme, Measurements, Place
from cellapp.estimation.iso9283.evaluate_paths import PathRuns, PathTrack
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.robot.kinematics.transforms import Array, quaternions_of

HEADER = (
    "row",
    "test",
    "commands",
    "arm",
    "place",
    "approach",
    "speed_percent",
    "group",
    "cycle",
    "time_s",
    "x_m",
    "y_m",
    "z_m",
    "direction_x",
    "direction_y",
    "direction_z",
    "quat_w",
    "quat_x",
    "quat_y",
    "quat_z",
)
"""Positions are in the tracker frame [m], times on the cell's clock [s]; ``cycle`` and ``group`` count from 1.
``speed_percent`` is the share of the profile's speed if a test was repeated at another speed, else empty.
Quaternions are those of a 6-D probe in the tracker frame; empty without a measured orientation."""
_NO_DIRECTION = ("", "", "")
_NOT_TURNED = ("", "", "", "")

Row = tuple[str, ...]


def raw_rows(
    programmes: Mapping[tuple[str, IsoCommands], ArmProgramme],
    measured: Measurements,
    paths: Sequence[PathRuns],
) -> Iterator[Row]:
    """Yield all rows: commanded and measured positions at rest, then paths."""
    for place in dict.fromkeys(one.place for one in measured.visits):
        for name, pose in zip(place.arms, place.poses, strict=True):
            where = _place_cells(place, name)
            yield (
                "commanded",
                *where,
                "",
                "",
                "",
                *_numbers(programmes[name, place.commands].position_M[pose]),
                *_NO_DIRECTION,
                *_commanded_turn(programmes[name, place.commands], pose),
            )
    for one in measured.visits:
        for name, p_M in one.p_M.items():
            counted = (str(one.group + 1), str(one.cycle + 1), repr(float(one.time_s)))
            turned = _numbers(one.turned[name][0]) if name in one.turned else _NOT_TURNED
            yield ("measured", *_place_cells(one.place, name), *counted, *_numbers(p_M), *_NO_DIRECTION, *turned)
    for runs in paths:
        yield from _of_path(runs)


def _of_path(runs: PathRuns) -> Iterator[Row]:
    where = ("path", runs.commands, runs.arm, runs.name, "", _percent(runs.series))
    for place_M, tangent_M in zip(runs.commanded_M, runs.tangents_M, strict=True):
        yield ("commanded", *where, "", "", "", *_numbers(place_M), *_numbers(tangent_M), *_NOT_TURNED)
    yield from _of_tracks(where, runs.tracks)


def _of_tracks(where: Row, tracks: Sequence[PathTrack]) -> Iterator[Row]:
    for number, track in enumerate(tracks, start=1):
        for time_s, p_M in zip(track.time_s, track.p_M, strict=True):
            yield (
                "measured",
                *where,
                "1",
                str(number),
                repr(float(time_s)),
                *_numbers(p_M),
                *_NO_DIRECTION,
                *_NOT_TURNED,
            )


def _place_cells(place: Place, name: str) -> tuple[str, ...]:
    return place.test, place.commands, name, "+".join(place.poses), place.approach, _percent(place.speed)


def _percent(share: float) -> str:
    return f"{100.0 * share:g}" if share else ""


def _commanded_turn(arm: ArmProgramme, pose: str) -> Row:
    """Return the cells of a probe's commanded orientation as a quaternion; empty if there is none."""
    if pose not in arm.rotation_M:
        return _NOT_TURNED
    return _numbers(quaternions_of(arm.rotation_M[pose]))


def _numbers(vector: Array) -> Row:
    """Return the cells of numbers with all their digits."""
    return tuple(repr(float(value)) for value in vector)
