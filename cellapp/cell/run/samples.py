"""Samples of recordings as readings: what later verbs use of arms that were recorded in motion."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import FIRST_SAMPLE, joined

_DOCUMENT = "motion_samples"


def keep_samples(run: RunFile, samples: Mapping[str, Readings]) -> None:
    """Store samples of recordings, timed by the clocks that the calibration found, in place of earlier ones."""
    content = {
        arm: {
            "time_s": its.time_s.tolist(),
            "sigma_m": None if its.sigma_m is None else its.sigma_m.tolist(),
            "q": its.q.tolist(),
            "approach": its.approach.tolist(),
            "p_M": its.p_M.tolist(),
            "split": its.split,
            **({} if its.other_q is None else {"other_q": its.other_q.tolist()}),
        }
        for arm, its in samples.items()
    }
    run.write_result(_DOCUMENT, json.dumps(content))


def known_readings(run: RunFile, arm: str) -> Readings:
    """Return the readings of one arm at rest, followed by the samples of its recordings that the calibration stored."""
    measured, text = run.readings(arm), run.read_result(_DOCUMENT)
    kept = None if text is None else json.loads(text).get(arm)
    if kept is None:
        return measured
    first = (1 + [*run.profile.arms].index(arm)) * FIRST_SAMPLE  # samples of two arms are never a common stop
    samples = Readings(
        configuration=first + np.arange(len(kept["time_s"])),
        time_s=np.full(len(kept["time_s"]), np.nan),
        q=np.array(kept["q"]),
        approach=np.array(kept["approach"], dtype=np.int8),
        p_M=np.array(kept["p_M"]),
        sigma_m=None if kept["sigma_m"] is None else np.array(kept["sigma_m"]),
        other_q=np.array(kept["other_q"]) if "other_q" in kept else None,
        split=tuple(kept["split"]),
    )
    return joined([measured, samples]) if len(measured) else samples


def all_known_readings(run: RunFile) -> dict[str, Readings]:
    """Return ``known_readings`` of every arm that has some."""
    found = {arm: known_readings(run, arm) for arm in run.profile.arms}
    return {arm: its for arm, its in found.items() if len(its)}
