"""The table ``plan`` of a run file: joint positions of every arm at every planned stop."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.readings_table import vectors_from_json
from cellapp.ground.grouping import grouped

Plan = Mapping[str, NDArray[np.float64]]
"""Arm -> q (n, N) [rad]; row k of all arms is stop k."""


def check_plan(plans: Plan, joints: Mapping[str, int]) -> None:
    """Raise ``ValueError`` if the arms' plans differ in length, have a wrong number of joints, or are not finite."""
    if len({len(q) for q in plans.values()}) > 1:
        raise ValueError("the arms' plans have different numbers of stops")
    for arm, q in plans.items():
        if np.ndim(q) != 2 or np.shape(q)[1] != joints[arm] or not np.all(np.isfinite(q)):
            raise ValueError(f"expected finite joint positions (n, {joints[arm]}) for arm {arm}")


def changed_stops(before: Plan, after: Plan) -> set[int]:
    """Return the stops at which an arm's joint positions differ between two plans, or that only one of them has."""
    changed: set[int] = set()
    for arm in before.keys() | after.keys():
        old, new = before.get(arm, np.empty((0, 1))), after.get(arm, np.empty((0, 1)))
        common = min(len(old), len(new))
        differ = (old[:common] != new[:common]).any(axis=1)
        changed |= {*np.flatnonzero(differ).tolist(), *range(common, max(len(old), len(new)))}
    return changed


def select_plan(connection: sqlite3.Connection, arms: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read the plan of those of ``arms`` that have one."""
    texts: dict[str, list[str]] = grouped(connection.execute("SELECT arm, q FROM plan ORDER BY arm, stop"))
    return {arm: vectors_from_json(texts[arm]) for arm in arms if arm in texts}


def replace_plan(connection: sqlite3.Connection, plans: Plan) -> None:
    """Store a plan in place of the one before."""
    connection.execute("DELETE FROM plan")
    connection.executemany("INSERT INTO plan VALUES (?, ?, ?)", _rows(plans))


def _rows(plans: Plan) -> Iterable[tuple[str, int, str]]:
    for arm, q in plans.items():
        for stop, row in enumerate(np.asarray(q, dtype=np.float64).tolist()):
            yield arm, stop, json.dumps(row)
