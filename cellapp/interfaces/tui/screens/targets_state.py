"""The list of targets that the screen Targets edits, with its undo history. Draws nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from cellapp.cell.targets.targets import Target, list_problems
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.workspace import Workspace

EMPTY = f"No targets: {SHOWN['open']} opens a list (YAML), {SHOWN['add']} adds a target."


@dataclass(frozen=True)
class TargetEdits:
    """A list, its file, and its undo history.

    Attributes
    ----------
    path : Path or None
        None for a list that has no file yet.
    saved, targets : tuple of Target
        The list in the file, and the current list.
    before, after : tuple of lists
        For undo and redo; the last one is used first.
    """

    path: Path | None = None
    saved: tuple[Target, ...] = ()
    targets: tuple[Target, ...] = ()
    before: tuple[tuple[Target, ...], ...] = ()
    after: tuple[tuple[Target, ...], ...] = ()

    @property
    def edited(self) -> bool:
        """Whether there are unsaved edits."""
        return self.targets != self.saved

    def changed(self, targets: Sequence[Target]) -> Self:
        """Return the edits with another list, after an edit."""
        return replace(self, targets=tuple(targets), before=(*self.before, self.targets), after=())

    def with_target(self, index: int, target: Target) -> Self:
        """Return the edits with one target replaced; an index behind the last appends it."""
        return self.changed((*self.targets[:index], target, *self.targets[index + 1 :]))

    def without(self, index: int) -> Self:
        """Return the edits with one target removed."""
        return self.changed((*self.targets[:index], *self.targets[index + 1 :]))

    def undone(self) -> Self | None:
        """Return the edits before the last edit; None if there is none."""
        if not self.before:
            return None
        *before, targets = self.before
        return replace(self, targets=targets, before=tuple(before), after=(*self.after, self.targets))

    def redone(self) -> Self | None:
        """Return the edits with the last undone edit redone; None if there is none."""
        if not self.after:
            return None
        *after, targets = self.after
        return replace(self, targets=targets, before=(*self.before, self.targets), after=tuple(after))

    def saved_as(self, path: Path, targets: tuple[Target, ...]) -> Self:
        """Return the edits after ``targets`` were written to a file."""
        return replace(self, path=path, saved=targets)

    @property
    def heading(self) -> str:
        """File, number of targets, and whether they are saved."""
        if self.path is None and not self.targets:
            return EMPTY
        count = counted(len(self.targets), "target")
        name = "no file yet" if self.path is None else str(self.path)
        state = f" · NOT SAVED ({SHOWN['save']} saves)" if self.edited else ""
        gone = (
            f" · the file is gone, {SHOWN['save']} writes it again"
            if self.path is not None and not self.path.is_file()
            else ""
        )
        return f"{name} · {count}{state}{gone}" + ("" if self.targets else f" · {EMPTY}")


def listed_path(workspace: Workspace) -> Path | None:
    """Return the path of the target list that the profile names; None if it names none."""
    if workspace.profile is None or workspace.profile_path is None or workspace.profile.targets is None:
        return None
    return workspace.profile_path.parent / workspace.profile.targets


def new_name(like: str, targets: Sequence[Target]) -> str:
    """Return a name that no target has: ``like`` with the next free number."""
    stem, number = re.fullmatch(r"(.*?)(\d*)", like, re.DOTALL).groups()  # type: ignore[union-attr]
    taken = {target.name for target in targets}
    count = int(number or 1) + 1
    while (name := f"{stem}{count:0{len(number)}d}" if number else f"{stem}-{count}") in taken:
        count += 1
    return name


def why_not(workspace: Workspace, state: RunState, targets: Sequence[Target]) -> str:
    """Return why commands cannot be computed for the list, and what to do; empty if they can."""
    if state.not_calibrated or workspace.profile is None:
        return state.not_calibrated
    if not targets:
        return EMPTY
    return _unfit(targets, workspace.profile)


def _unfit(targets: Sequence[Target], profile: Profile) -> str:
    """Return the problem of the first target that does not fit the cell of the run; empty if there is none."""
    first = next(list_problems(targets, profile), None)
    if first is None:
        return ""
    index, problem = first
    return f"Target '{targets[index].name}'{problem.text}. Enter edits it."
