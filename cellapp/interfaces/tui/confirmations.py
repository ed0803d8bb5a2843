"""Questions before the application begins something larger, or ends. None begins anything without an answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from cellapp.commands.record import Verb
from cellapp.commands.registry import records
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.dialogs.question import BEGIN, Choice, ChosenAnswer
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.workspace import Workspace, new_folder

if TYPE_CHECKING:
    from cellapp.ground.results import StageName
    from cellapp.interfaces.tui.jobs import Job


def offer_again(screen: DayScreen, title: str, stage: StageName, job: Job) -> None:
    """Begin the job of a stage; if a valid result exists, first ask whether to repeat the work."""
    results = screen.workspace.results
    if results is None or screen.workspace.stored(stage) is None or stage in results.out_of_date:
        screen.start(job)
        return
    mark = screen.state.marks[screen.STEP]
    text = (
        f"The run has a result that holds ({mark.words}). Nothing it rests on has changed since; what is stored stays."
    )
    answers = (ChosenAnswer("no", "Not now", "n"), ChosenAnswer("begin", "Do it again", "b", "warning"))
    screen.ask(Choice(title, text, answers), lambda: screen.start(job))


def offer_whole_day(app: Host) -> None:
    """Offer to plan, collect, calibrate, discover, push and verify in a new run."""
    profile, path = app.workspace.file_profile, app.workspace.profile_path
    if profile is None or path is None:
        app.say(app.state.no_profile, "warning")
        return
    folder, cell = new_folder(profile), Workspace(path, profile)
    day = f"Plan, collect, calibrate, discover, push and verify with '{profile.name}' into {folder}"
    text = f"{day}; {cell.arms_words}."

    def begin(answer: str | None) -> None:
        if answer == "begin" and app.start_job(verb_jobs.whole_day(path, folder, profile), cell):
            app.action_show("collect")

    app.push_screen(Choice("Everything, unattended?", text, BEGIN), begin)


def verbs_of_run() -> tuple[Verb, ...]:
    """Return the verbs that work on a run and whose other required fields a dialog can ask for."""
    return tuple(
        verb
        for verb in records()
        if verb.opens_run
        and all(name == "folder" or not verb.is_needed(name) or words.label for name, words in verb.request.asked())
    )


def offer_verb(screen: DayScreen, verb: Verb) -> None:
    """Ask for the request of any verb on the open run, or on the open profile, then run it and show its view."""
    path = screen.open_folder() if verb.opens_run else screen.workspace.profile_path
    if path is not None:
        given = {"folder" if verb.opens_run else "profile": path}
        screen.ask_verb(verb, verb.summary, given, shows_result=screen.read_result)
    elif not verb.opens_run:
        screen.say(screen.state.no_profile, "warning")


class QuitQuestion(Choice):
    """Whether to quit, and what that ends."""


def offer_to_quit(app: Host, leave: Callable[[bool], None]) -> None:
    """Ask whether to quit while a job runs; ``leave`` receives the answer."""
    if app.jobs.watched:
        stay, quits = "Stay", ChosenAnswer("leave", "Quit, it goes on", "y", "warning")
        text = f"'{app.record.name}' runs in another process and goes on; its arms are not stopped."
    else:
        stay, quits = "Continue", ChosenAnswer("leave", "Stop and quit", "y", "error")
        brake = "Brake all arms, end it" if app.jobs.control.has_brakes else "End it"
        text = f"'{app.record.name}' is in progress. {brake} and quit?"
    question = QuitQuestion("Quit?", text, (ChosenAnswer("stay", stay, "n"), quits))
    app.push_screen(question, lambda answer: leave(answer == "leave"))


def offer_at_rest(app: Host, arm: str) -> None:
    """Record that a person has seen an arm at rest that counts as moving."""
    folder = app.workspace.folder
    if folder is None:
        return

    def record(answer: str | None) -> None:
        if answer == "seen":
            from cellapp.commands.job import VERB as AT_REST
            from cellapp.commands.job import AtRestRequest

            app.start_job(verb_jobs.verb_job(AT_REST, AtRestRequest(folder=folder, arm=arm)))

    answers = (ChosenAnswer("no", "No", "n"), ChosenAnswer("seen", "I see it at rest", "s", "warning"))
    text = f"Its stop was not confirmed: {app.workspace.unseen.get(arm, '')}. Say so only if you look at it now."
    app.push_screen(Choice(f"Is arm {arm} at rest?", text, answers), record)
