"""Samples of recordings that stand for readings of arms without any at rest: what later verbs know of the arm's use."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.estimation.readings import Readings

_DOCUMENT = "motion_samples"


def keep_samples(run: RunFile, samples: Mapping[str, Readings]) -> None:
    """Store samples of recordings at the clocks that the calibration found, in place of earlier ones."""
    content = {
        arm: {
            "time_s": its.time_s.tolist(),
            "q": its.q.tolist(),
            "approach": its.approach.tolist(),
            "p_M": its.p_M.tolist(),
            "split": its.split,
        }
        for arm, its in samples.items()
    }
    run.write_result(_DOCUMENT, json.dumps(content))


def known_readings(run: RunFile, arm: str) -> Readings:
    """The readings of one arm at rest; where it has none, samples of its recordings as the calibration keeps them."""
    measured = run.readings(arm)
    text = None if len(measured) else run.read_result(_DOCUMENT)
    kept = None if text is None else json.loads(text).get(arm)
    if kept is None:
        return measured
    return Readings(
        configuration=np.arange(len(kept["time_s"])),
        time_s=np.array(kept["time_s"]),
        q=np.array(kept["q"]),
        approach=np.array(kept["approach"], dtype=np.int8),
        p_M=np.array(kept["p_M"]),
        split=tuple(kept["split"]),
    )


def all_known_readings(run: RunFile) -> dict[str, Readings]:
    """``known_readings`` of every arm that has some."""
    found = {arm: known_readings(run, arm) for arm in run.profile.arms}
    return {arm: its for arm, its in found.items() if len(its)}
