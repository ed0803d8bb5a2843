"""The jobs of the screen Targets, with the questions before each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cellapp.cell.targets.targets import Target
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.compensate.target_list import stale_model
from cellapp.commands.correct.request import ENDINGS
from cellapp.commands.correct.request import VERB as CORRECT
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Request
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import BEGIN, USE_STALE, WRITE, arms_words, ask_of_calibrated
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.screens.targets_state import why_not


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
