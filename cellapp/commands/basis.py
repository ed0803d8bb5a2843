"""The basis of a stage of a run: hashes of the profile, readings, earlier stages and priors that it rests on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from cellapp.cell.run.file import RunFile, former_arrays
from cellapp.cell.run.measured_again import replaced_counts
from cellapp.cell.run.recordings import recordings_digest
from cellapp.estimation.readings.readings import Readings
from cellapp.ground.results import Record, StageName


class ReadingsBasis(Record):
    """Number of readings of one arm, and the hash of their measured arrays and splits; empty if only counted.

    ``again`` counts the readings that later ones had replaced.
    """

    n: int
    sha256: str
    again: int = 0

    def is_same(self, other: ReadingsBasis) -> bool:
        """Return whether both are of the same readings, as far as both know them."""
        hashes = {self.sha256, other.sha256} - {""}
        return (self.n, self.again) == (other.n, other.again) and len(hashes) < 2


class PriorBasis(Record):
    """The earlier run whose calibration of one arm was taken as prior, and ``earlier_digest`` of it then."""

    run: str
    sha256: str


class Basis(Record):
    """SHA-256 hashes of what a stage rests on; ``stages`` maps each earlier stage that it used to its digest,
    ``priors`` each arm to the earlier run that was its prior, ``recordings`` those of motion, if any (``n`` points)."""

    profile: str
    readings: Mapping[str, ReadingsBasis]
    stages: Mapping[StageName, str] = {}
    targets: str | None = None
    priors: Mapping[str, PriorBasis] = {}
    recordings: Mapping[str, ReadingsBasis] = {}


def basis_of(run: RunFile, stages: Mapping[StageName, str] | None = None) -> Basis:
    """Return the basis of a stage that is stored now; ``stages`` maps each earlier stage that it uses to its digest."""
    measured = run.rows if run.removed_kinds() else run.readings
    readings, again = {name: measured(name) for name in run.arms()}, replaced_counts(run)
    return Basis(
        profile=sha256_of(run.profile_text),
        readings={
            name: ReadingsBasis(n=len(arm), sha256=readings_digest(arm), again=again.get(name, 0))
            for name, arm in readings.items()
        },
        stages=stages or {},
        recordings=recordings_basis(run),
    )


def recordings_basis(run: RunFile) -> dict[str, ReadingsBasis]:
    """Return the count and hash of each arm's recordings of motion; empty if there are none."""
    found = {name: recordings_digest(run, name) for name in run.profile.arms}
    return {name: ReadingsBasis(n=n, sha256=digest) for name, (n, digest) in found.items() if digest}


def counted_basis(run: RunFile) -> Basis:
    """Return the basis as ``basis_of`` does, but only count the readings, which is quick.

    No verb changes readings in place, so counts suffice. ``collect`` adds readings, stops measured again are counted,
    and splits are drawn only for readings without one, before a calibration uses them.
    """
    again = replaced_counts(run)
    counts = {name: sum(splits.values()) for name, splits in run.split_counts().items()}
    return Basis(
        profile=sha256_of(run.profile_text),
        readings={name: ReadingsBasis(n=n, sha256="", again=again.get(name, 0)) for name, n in counts.items()},
        recordings=recordings_basis(run),
    )


def readings_digest(readings: Readings) -> str:
    """Hash the names and little-endian values of all measured arrays of one arm, and its splits (SHA-256)."""
    digest = hashlib.sha256()
    arrays = {entry.name: getattr(readings, entry.name) for entry in fields(readings)}
    for name, values in (arrays | former_arrays(readings)).items():
        if isinstance(values, np.ndarray):
            digest.update(f"{name} {values.shape}\n".encode())
            digest.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes())
    digest.update(json.dumps(readings.split).encode())
    return digest.hexdigest()


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
