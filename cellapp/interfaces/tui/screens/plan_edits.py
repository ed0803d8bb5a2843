"""Keys of the screen Plan that change a plan: freeze, add, design again, write and read a table."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.record import Request
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.tui import work as verbs
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.new_run import NewRunQuestion
from cellapp.interfaces.tui.dialogs.question import Answer, Choice
from cellapp.interfaces.tui.dialogs.save_as import SaveAs
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.plan_tables import StopsTable
from cellapp.interfaces.tui.workspace import new_folder

NO_PLAN = f"This run has no plan: its readings were imported. {SHOWN['go']} plans a new run."
_PLAN_FILE = "plan.csv"
"""Default file name of a plan as a table."""
_FURTHER = 50
"""Default number of stops that are appended."""
_TAKE = (Answer("take", "Take", "t", "success"), Answer("no", "Close", "c"))


class PlanEdits(DayScreen):
    """A screen with the stops of the open run's plan; subclasses show them."""

    def planned_folder(self) -> Path | None:
        """Return the folder of the open run if it has a plan; else say why not and return None."""
        folder = self.open_folder()
        if folder is not None and not self.state.planned:
            self.say(NO_PLAN, "warning")
            return None
        return folder

    def action_freeze(self) -> None:
        """Exclude the marked stops from later designs; without marks, none."""
        if folder := self.planned_folder():
            marked = ",".join(map(str, sorted(self.query_one(StopsTable).marked)))
            self.start(verbs.job_of(PLAN, folder=folder, freeze=marked or "none"))

    def action_add(self) -> None:
        """Ask how many stops to append."""
        folder = self.planned_folder()
        if folder is None:
            return

        def begin(request: Request | None) -> None:
            if request is not None:
                self.start(verbs.verb_job(PLAN, request))

        text = "They tell most beside those that are planned or measured already. Nothing moves."
        proposed = {"add": _FURTHER}
        self.app.push_screen(VerbQuestion(PLAN, text, _TAKE, {"folder": folder}, proposed=proposed), begin)

    def action_replan(self) -> None:
        """Ask, then design the unmeasured stops again."""
        folder = self.planned_folder()
        if folder is None:
            return

        def begin(answer: str | None) -> None:
            if answer == "replan":
                self.start(verbs.job_of(PLAN, folder=folder, replan=True))

        text = (
            "Stops that are measured, proposed by discovery or frozen stay, as far as they could be reached; all others"
            " of this run are replaced. Nothing moves."
        )
        answers = (Answer("no", "Leave the plan", "l"), Answer("replan", "Design again", "d", "warning"))
        self.app.push_screen(Choice("Design the rest again?", text, answers), begin)

    def action_write(self) -> None:
        """Ask where to write the plan."""
        folder = self.planned_folder()
        if folder is None:
            return

        def begin(path: Path | None) -> None:
            if path is not None:
                self.start(verbs.verb_job(EXPORT, ExportRequest(folder=folder, plan=path), RENEWED))

        self.app.push_screen(SaveAs("the plan", None, folder / _PLAN_FILE), begin)

    def action_read(self) -> None:
        """Ask for an edited plan, and check it."""
        profile = self.workspace.profile_path
        if self.workspace.file_profile is None or profile is None:
            self.say(self.state.no_profile, "warning")
            return

        def begin(path: Path | None) -> None:
            if path is not None:
                self.start(verbs.job_of(PLAN, profile=profile, check=path))

        start = self.workspace.folder or Path()
        self.app.push_screen(FilePicker("A plan as CSV", start, lambda path: path.suffix == ".csv"), begin)

    def offer_file(self, file: Path) -> None:
        """Ask what to do with a plan that is safe."""
        profile, path = self.workspace.file_profile, self.workspace.profile_path
        if profile is None or path is None:
            return

        def into(around: bool) -> None:
            def begin(folder: Path | None) -> None:
                if folder is not None:
                    how_used = {"keep" if around else "source": file}
                    self.start(verbs.job_of(PLAN, profile=path, folder=folder, **how_used))

            how = "with other stops designed around these" if around else "exactly as it is written"
            self.app.push_screen(
                NewRunQuestion(f"The plan of {file}, {how}. Nothing moves.", new_folder(profile)), begin
            )

        def answered(answer: str | None) -> None:
            if answer in ("from", "keep"):
                into(answer == "keep")

        answers = (
            Answer("look", "Only look", "l"),
            Answer("from", "New run with it", "n"),
            Answer("keep", "New run around it", "a"),
        )
        self.app.push_screen(Choice("This plan is safe", f"{file} holds at every stop and way.", answers), answered)
