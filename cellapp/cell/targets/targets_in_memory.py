"""Targets in memory instead of a file: keys with values, a list of them, or a data frame; checked as all targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cellapp.cell.profile.messages import dotted
from cellapp.cell.run.table_in_memory import is_frame, table_of_frame
from cellapp.cell.targets.target_csv import source_of_table
from cellapp.cell.targets.target_source import TargetSource
from cellapp.cell.targets.targets import Target, targets_of
from cellapp.ground.errors import InputError
from cellapp.ground.plain_data import plain_data
from cellapp.ground.profile import Profile

if TYPE_CHECKING:
    import pandas as pd


def targets_in_memory(given: Mapping[str, Any] | Sequence[Any] | pd.DataFrame, profile: Profile) -> tuple[Target, ...]:
    """Return the targets of a cell.

    Parameters
    ----------
    given : sequence, mapping or data frame
        A list of ``Target`` objects or of mappings with the keys that a target has in a YAML file; a mapping with the
        keys of such a file (``targets``, ``frames``, ``conditions``); or a data frame with the columns of a CSV file of
        targets. A plain number is in metres or radians.

    Raises
    ------
    InputError
        As ``load_targets``; problems are located by the target, or the row of the data frame.
    """
    if is_frame(given):
        joints = {name: len(arm.type.joints) for name, arm in profile.arms.items()}
        return targets_of(source_of_table(table_of_frame(given), joints), profile)
    content = plain_data(given)
    if isinstance(content, list):
        content = {"targets": content}
    if not isinstance(content, dict):
        raise InputError(f"targets: expected a path, a list, keys with values or a data frame, got {given!r:.60}")
    content = {"schema": "cellapp-targets", "version": 1, **content}
    return targets_of(TargetSource(content, lambda at: "targets", lambda inside: dotted(inside)), profile)
