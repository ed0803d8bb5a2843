"""The list of targets that the screen Targets edits, with its undo history. Draws nothing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from cellapp.cell.targets.targets import Target, list_problems
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.compensate.target_list import stale_model
from cellapp.commands.correct import ENDINGS
from cellapp.commands.correct import VERB as CORRECT
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Request
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.offers import BEGIN, USE_STALE, WRITE, arms_words, ask_of_calibrated
from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.screens.base import DayScreen
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


# -- The jobs of the screen Targets, with the questions before each ---------------------------------------------------


def begin_compensate(screen: DayScreen, targets: Sequence[Target]) -> None:
    """Compute commands for a list."""
    if (folder := _ready(screen, targets)) is not None:
        screen.start(work.job_of(COMPENSATE, folder=folder, targets=tuple(targets)))


def ask_push(screen: DayScreen, targets: Sequence[Target]) -> None:
    """Ask, then drive to the targets."""
    if (given := _pushed(screen, targets, verify=False)) is None:
        return

    def begin(answer: str | None) -> None:
        if answer == "begin":
            screen.start(work.job_of(PUSH, **given))

    stale = _stale(screen)
    text = _push_words(screen, targets, "", stale)
    screen.app.push_screen(Choice("Push?", text, USE_STALE if stale else BEGIN), begin)


def ask_verify(screen: DayScreen, targets: Sequence[Target]) -> None:
    """Ask, also how often each target is corrected; then drive to the targets and measure."""
    if (given := _pushed(screen, targets, verify=True)) is None:
        return

    def begin(request: Request | None) -> None:
        if request is not None:
            screen.start(work.verb_job(PUSH, request))

    stale = _stale(screen)
    measured = " with the nominal and the compensated command, measured by the tracker"
    text = _push_words(screen, targets, measured, stale)
    screen.app.push_screen(VerbQuestion(PUSH, text, USE_STALE if stale else BEGIN, given), begin)


def ask_locate(screen: DayScreen) -> None:
    """Ask how, then measure the pose of the tracker after it was moved."""
    ask_of_calibrated(screen, LOCATE, LOCATE.summary)


def ask_correct(screen: DayScreen) -> None:
    """Ask for a program and the file of its corrected copy."""
    if (calibrated := screen.calibrated_run()) is None:
        return
    folder, _, calibration = calibrated
    arms = tuple(calibration.arms)

    def write(request: Request | None) -> None:
        if request is not None:
            screen.start(work.verb_job(CORRECT, request))

    def ask(program: Path | None) -> None:
        if program is not None:
            given = {"folder": folder, "program": program}
            proposed = {
                "out": program.with_stem(f"{program.stem}-corrected"),
                "arm": arms[0] if len(arms) == 1 else None,
            }
            text = f"{program.name}; nothing moves."
            dialog = VerbQuestion(CORRECT, text, WRITE, given, proposed=proposed, choices={"arm": arms})
            screen.app.push_screen(dialog, write)

    title = f"A program of a UR controller ({', '.join(ENDINGS)})"
    screen.app.push_screen(FilePicker(title, Path.cwd(), lambda path: path.suffix in ENDINGS), ask)


# -- inside -----------------------------------------------------------------------------------------------------------


def _ready(screen: DayScreen, targets: Sequence[Target]) -> Path | None:
    """Return the run's folder if commands can be computed for a list; else say why not and return None."""
    if reason := why_not(screen.workspace, screen.state, targets):
        screen.say(reason, "warning")
        return None
    return screen.workspace.folder


def _pushed(screen: DayScreen, targets: Sequence[Target], *, verify: bool) -> dict[str, Any] | None:
    """Return the request values of a push except those of the question; None with a sentence if it cannot be pushed."""
    if (folder := _ready(screen, targets)) is None:
        return None
    stale = bool(_stale(screen))
    return {"folder": folder, "targets": tuple(targets), "verify": verify, "out_of_date": stale}


def _stale(screen: DayScreen) -> str:
    results = screen.workspace.results
    return "" if results is None else stale_model(results)


def _push_words(screen: DayScreen, targets: Sequence[Target], measured: str, stale: str) -> str:
    """Return where a push drives to, and what a person must know."""
    counts = Counter(arm for target in targets for arm in target.arms)
    where = " and ".join(f"arm {arm} to {n}" for arm, n in counts.items())
    pairs = any(target.partner is not None for target in targets)
    others = "the other arm waits at home, except at cooperative targets" if pairs else "the other arm waits at home"
    text = f"Drive {where} targets{measured}; {others}; {arms_words(screen.workspace)}."
    if stale:
        text += f"\nThe model is not up to date: {stale}. Better calibrate or discover again first."
    return text
