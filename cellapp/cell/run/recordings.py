"""Recordings of motion in the run file: their columns, compressed, each with its name.

Samples of recordings as readings: what later verbs use of arms that were recorded in motion.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from cellapp.cell.run.columns import Kind, joint_stream, point_stream
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings_csv import RecordedStreams, read_recordings
from cellapp.cell.run.records import RecordingState
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import FIRST_SAMPLE, joined
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile

_SINCE = 6
"""Schema version of the run file that introduced recordings."""


def store_recording(run: RunFile, recorded: RecordedStreams) -> None:
    """Add a recording; on return it is on disk. Raise ``InputError`` if the arm has one of this name."""
    state, digest = recorded.state, hashlib.sha256()
    rows = []
    for kind, table in (("joints", recorded.joints), ("points", recorded.points)):
        for place, (name, values) in enumerate(table.columns.items()):
            words = json.dumps(table.words[name]) if name in table.words else None
            data = packed(values)
            digest.update(f"{kind} {name} {words}\n".encode())
            digest.update(data)
            rows.append((state.arm, state.name, kind, place, name, words, data))
    with run.change() as connection:
        there = "SELECT 1 FROM recording WHERE arm = ? AND name = ?"
        if connection.execute(there, (state.arm, state.name)).fetchone():
            raise InputError(f"{run.path}: recording '{state.name}' of arm {state.arm} is stored already")
        connection.execute(
            "INSERT INTO recording VALUES (?, ?, ?, ?)",
            (state.arm, state.name, state.model_dump_json(), digest.hexdigest()),
        )
        connection.executemany("INSERT INTO stream VALUES (?, ?, ?, ?, ?, ?, ?)", rows)


def recordings_from_csv(
    profile: Profile,
    joints: Sequence[Path],
    points: Sequence[Path],
    arm: str | None = None,
    taken: Collection[str] = (),
) -> tuple[frozenset[str], Callable[[RunFile], None]]:
    """Read and check files of recordings; return the arms that have one, and a function that stores them in a new run.

    Raises ``InputError`` as ``read_recordings``.
    """
    recorded, notes = read_recordings(profile, joints, points, arm, taken)

    def fill(run: RunFile) -> None:
        for one in recorded:
            store_recording(run, one)
            state = one.state
            run.log(
                "info",
                f"imported recording '{state.name}' of arm {state.arm}: {state.joints.n} samples of joints from"
                f" {one.joints.path}, {state.points.n} points from {one.points.path}",
            )
        for note in notes:
            run.log("note", note)

    return frozenset(one.state.arm for one in recorded), fill


def recording_states(run: RunFile) -> tuple[RecordingState, ...]:
    """Return the description of each recording of a run, arm by arm; none in a file of an older schema."""
    return tuple(state for state, _ in _listed(run))


def recordings_digest(run: RunFile, arm: str) -> tuple[int, str]:
    """Return the number of points of an arm's recordings, and a SHA-256 of their values; 0 and "" if there are none."""
    its = [(state.points.n, sha) for state, sha in _listed(run) if state.arm == arm]
    digest = hashlib.sha256(" ".join(sha for _, sha in its).encode()).hexdigest() if its else ""
    return sum(n for n, _ in its), digest


def _listed(run: RunFile) -> list[tuple[RecordingState, str]]:
    """List the recordings in the order of arms, then of their import, with the hash of each."""
    rows = run.select("SELECT about, sha256 FROM recording ORDER BY rowid", _SINCE)
    found = [(RecordingState.model_validate_json(about), str(sha)) for about, sha in rows]
    order = [*run.profile.arms]
    return sorted(found, key=lambda one: order.index(one[0].arm))


def read_recordings_of(run: RunFile, arm: str) -> tuple[Recording, ...]:
    """Return the recordings of one arm for estimation; those of one session are joined in the order of time."""
    joints = len(run.profile.arms[arm].type.joints)
    sessions = grouped((state.session or state.name, state) for state in recording_states(run) if state.arm == arm)
    found = []
    for name, states in sessions.items():
        samples = _in_order([read_stream(run, state, "joints")[0] for state in states])
        streams = [read_stream(run, state, "points") for state in states]
        points = point_stream(_in_order([its for its, _ in streams]), streams[0][1].get("split"))
        found.append(Recording(name=name, arm=arm, joints=joint_stream(samples, joints), points=points))
    return tuple(found)


def _in_order(parts: Sequence[dict[str, NDArray[np.float64]]]) -> dict[str, NDArray[np.float64]]:
    """Concatenate the columns that all parts have, in the order of the parts' first timestamps."""
    parts = sorted(parts, key=lambda part: float(part["time_s"][0]))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if all(name in p for p in parts)}


def read_stream(
    run: RunFile, state: RecordingState, kind: Kind
) -> tuple[dict[str, NDArray[np.float64]], dict[str, tuple[str, ...]]]:
    """Read the columns of a stream in the order of its file, each (n,), and the texts of those that hold texts."""
    n = state.joints.n if kind == "joints" else state.points.n
    with run.look() as connection:
        rows = connection.execute(
            "SELECT name, words, data FROM stream WHERE arm = ? AND recording = ? AND kind = ? ORDER BY place",
            (state.arm, state.name, kind),
        ).fetchall()
    try:
        columns = {name: unpacked(data, n) for name, _, data in rows}
    except ValueError:
        raise InputError(
            f"{run.path} is damaged (recording '{state.name}' of arm {state.arm}); restore it from a copy"
        ) from None
    return columns, {name: tuple(json.loads(words)) for name, words, _ in rows if words is not None}


# -- Lossless compression of columns of recordings: differences of neighbours, grouped by byte position ---------------
#
# Samples of a motion resemble their neighbours: sign, exponent and leading digits of a difference are mostly zero, and
# these bytes are stored together. A million points of a tracker take some 16 MB and are read in a tenth of a second.


_BYTES = 8
_FAST = 1
"""Level of compression; higher ones save one percent and take ten times as long."""


def packed(values: NDArray[np.float64]) -> bytes:
    """Compress a column (n,)."""
    step = np.diff(np.ascontiguousarray(values, dtype="<f8").view("<i8"), prepend=np.int64(0))
    zigzag = (step << 1) ^ (step >> 63)  # small steps of either sign have small codes
    return zlib.compress(zigzag.view(np.uint8).reshape(-1, _BYTES).T.tobytes(), _FAST)


def unpacked(data: bytes, n: int) -> NDArray[np.float64]:
    """Decompress a column (n,). Raise ``ValueError`` if the data are not those of n numbers."""
    try:
        planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(_BYTES, n)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    zigzag = np.ascontiguousarray(planes.T).view("<u8")[:, 0]
    step = (zigzag >> np.uint64(1)).astype("<i8") ^ -(zigzag & np.uint64(1)).astype("<i8")
    return np.cumsum(step).view("<f8").astype(np.float64, copy=False)


_DOCUMENT = "motion_samples"
_KEPT = ("time_s", "sigma_m", "q", "approach", "p_M", "other_q", "split")
"""What is stored of samples."""
_STORED = TypeAdapter(dict[str, dict[str, Any]])


def keep_samples(run: RunFile, samples: Mapping[str, Readings]) -> None:
    """Store samples of recordings, timed by the clocks that the calibration found, in place of earlier ones."""
    content = {
        arm: {name: np.asarray(value).tolist() for name in _KEPT if (value := getattr(its, name)) is not None}
        for arm, its in samples.items()
    }
    run.write_document(_DOCUMENT, json.dumps(content))


def known_readings(run: RunFile, arm: str) -> Readings:
    """Return the readings of one arm at rest, followed by the samples of its recordings that the calibration stored."""
    measured, stored = run.readings(arm), run.read_checked(_DOCUMENT, _STORED, {}, "calibrate again").get(arm)
    if stored is None:
        return measured
    kept: dict[str, Any] = {name: np.array(values) for name, values in stored.items() if values is not None}
    first = (1 + [*run.profile.arms].index(arm)) * FIRST_SAMPLE  # samples of two arms are never a common stop
    kept["configuration"] = first + np.arange(len(kept["time_s"]))
    kept["time_s"] = np.full(len(kept["time_s"]), np.nan)
    kept["approach"] = kept["approach"].astype(np.int8)
    samples = Readings(**{**kept, "split": tuple(stored["split"])})
    return joined([measured, samples]) if len(measured) else samples


def all_known_readings(run: RunFile) -> dict[str, Readings]:
    """Return ``known_readings`` of every arm that has some."""
    found = {arm: known_readings(run, arm) for arm in run.profile.arms}
    return {arm: its for arm, its in found.items() if len(its)}
