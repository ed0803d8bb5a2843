"""The form of a profile, section by section: checked while typing, drawn as a map, saved as commented YAML."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.events import DescendantFocus
from textual.message import Message
from textual.timer import Timer
from textual.widget import Widget
from textual.widgets import Footer, Input, Static, TabbedContent, TabPane

from cellapp.cell.profile.draft import (
    ArmDraft,
    ObstacleDraft,
    ProfileDraft,
    arm_kinds,
    fields_of,
    file_name,
    tracker_kinds,
    with_text,
)
from cellapp.cell.profile.draft_check import FieldProblem
from cellapp.cell.profile.draft_fields import (
    ARM_FIELDS,
    ARM_NAME_FIELD,
    NAME_FIELD,
    OBSTACLE_FIELDS,
    OBSTACLE_NAME_FIELD,
    PLAN_FIELDS,
    TRACKER_FIELDS,
    FormField,
)
from cellapp.cell.profile.draft_file import OpenProfile, before_saving, changed_on_disk, new_text, save
from cellapp.cell.profile.starters import arm_type_files
from cellapp.commands.view.charts import Chart
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile.arm_types import ARM_TYPES
from cellapp.ground.profile.obstacles import SHAPES
from cellapp.interfaces.tui.dialogs.points import PointsDialog
from cellapp.interfaces.tui.dialogs.question import Answer, Choice, Question
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.form_fields import FieldRow
from cellapp.interfaces.tui.widgets.stop import StopButton

_PAUSE_S = 0.2
"""Pause after the last key before the fields are checked, which takes about 0.1 s in another thread."""
_NO_OBSTACLES = "No obstacles: tables, pillars, guards, cables on an arm. F7 adds one."


class Judged(Message):
    """The draft was checked by the profile's rules; ``chart`` is its map, None if it could not be read."""

    def __init__(self, draft: ProfileDraft, problems: tuple[FieldProblem, ...], chart: Chart | None = None) -> None:
        super().__init__()
        self.draft, self.problems, self.chart = draft, problems, chart


class ProfileForm(Question[Path]):
    """Write or edit a profile. Returns the path of the saved file; None if nothing was saved.

    Parameters
    ----------
    opened : OpenProfile
    """

    HORIZONTAL_BREAKPOINTS = DayScreen.HORIZONTAL_BREAKPOINTS
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+s", "save", "Save", priority=True),
        Binding("escape", "close", "Close"),
        Binding("f10", "close", "Close", show=False),  # while a job runs, Escape stops it
        Binding("ctrl+z", "undo", "Undo", priority=True),
        Binding("ctrl+y", "redo", "Redo", show=False, priority=True),
        Binding("f2", "points", "Points", tooltip="the base of this arm from tracker points"),
        Binding("f3", "map", "Map"),
        Binding("f4", "next_problem", "Problem", tooltip="the next field to correct"),
        Binding("f6", "next_section", "Section", tooltip="the next section"),
        Binding("f7", "add", "Add", tooltip="add an arm, or in the section of obstacles an obstacle"),
        Binding("f8", "remove", "Del", tooltip="remove this arm or this obstacle"),
    ]
    DEFAULT_CSS = """
    ProfileForm { align: left top; background: $background; }
    ProfileForm #form-top { height: 1; background: $panel; }
    ProfileForm #form-title { width: 1fr; padding: 0 1; text-style: bold; }
    ProfileForm #form-body { height: 1fr; }
    ProfileForm #sections { width: 3fr; }
    ProfileForm #form-map { width: 2fr; }
    ProfileForm.-narrow #form-map { display: none; }
    ProfileForm.map #sections { display: none; }
    ProfileForm.map #form-map { display: block; }
    ProfileForm #form-help { height: 2; padding: 0 1; background: $panel; }
    """

    def __init__(self, opened: OpenProfile) -> None:
        super().__init__()
        self._opened, self._draft = opened, opened.draft
        self._before: list[ProfileDraft] = []
        self._after: list[ProfileDraft] = []
        self._typing_in = ""
        self._judged: ProfileDraft | None = None
        self._problems: tuple[FieldProblem, ...] = ()
        self._section, self._wanted = "section-cell", ""
        self._timer: Timer | None = None
        self._saved: Path | None = None

    # -- widgets -------------------------------------------------------------------------------------------------------

    def compose(self) -> ComposeResult:
        with Horizontal(id="form-top"):
            yield Static("", id="form-title", markup=False)
            yield StopButton()
        last = len(self._draft.arms) - 1
        if (self._present_arm() or 0) > last:  # it was removed
            self._section = f"section-arm-{last}"
        with Horizontal(id="form-body"):
            with TabbedContent(id="sections", initial=self._section):
                for name, title in self._titles().items():
                    yield TabPane(title, VerticalScroll(can_focus=False), id=f"section-{name}")
            yield ChartPlot(id="form-map")
        yield Static("", id="form-help", markup=False)
        yield Footer(compact=True)

    def _titles(self) -> dict[str, str]:
        """Return the sections and their titles."""
        arms = {f"arm-{index}": arm.name or "arm" for index, arm in enumerate(self._draft.arms)}
        return {"cell": "Cell", **arms, "tracker": "Tracker", "obstacles": "Obstacles"}

    def _section_rows(self, section: str) -> Iterator[FieldRow]:
        """Yield the fields of a section; those that its driver or shape does not have are hidden."""
        if section.startswith("arm-"):
            index = int(section.removeprefix("arm-"))
            rows = self._arm_rows(index, self._draft.arms[index])
        elif section == "tracker":
            rows = self._rows("tracker", self._draft.tracker, TRACKER_FIELDS)
        elif section == "obstacles":
            rows = self._obstacle_rows()
        else:
            rows = self._cell_rows()
        shown = self._shown_ids()
        for row in rows:
            row.display = row.field_id in shown
            yield row

    def _cell_rows(self) -> Iterator[FieldRow]:
        yield FieldRow("name", NAME_FIELD, self._draft.name)
        yield from self._rows("plan", self._draft.plan, PLAN_FIELDS)

    def _arm_rows(self, index: int, arm: ArmDraft) -> Iterator[FieldRow]:
        yield FieldRow(f"arms.{index}.name", ARM_NAME_FIELD, arm.name)
        yield from self._rows(f"arms.{index}", arm, ARM_FIELDS)

    def _obstacle_rows(self) -> Iterator[FieldRow]:
        for index, obstacle in enumerate(self._draft.obstacles):
            yield FieldRow(f"obstacles.{index}.name", OBSTACLE_NAME_FIELD, obstacle.name, begins=True)
            yield from self._rows(f"obstacles.{index}", obstacle, OBSTACLE_FIELDS)

    def _rows(self, prefix: str, section: object, forms: tuple[FormField, ...]) -> Iterator[FieldRow]:
        types = (*(f"arms/{path.name}" for path in arm_type_files()), *ARM_TYPES)
        choices = {
            "kind": tracker_kinds() if prefix == "tracker" else arm_kinds(),
            "type": types,
            "shape": tuple(SHAPES),
            "fixed_to": ("cell", "base", "flange"),
            "arm": tuple(arm.name for arm in self._draft.arms),
        }
        for form in forms:
            text = str(getattr(section, form.name))
            yield FieldRow(f"{prefix}.{form.name}", form, text, choices.get(form.name, ()))

    @on(TabbedContent.TabActivated)
    async def begin_section(self, event: TabbedContent.TabActivated) -> None:
        """Create the fields of a section when it is first shown: all at once would delay the keys."""
        self._section = str(event.pane.id)
        if not event.pane.query(FieldRow):
            rows: list[Widget] = [*self._section_rows(self._section.removeprefix("section-"))]
            nothing = Static(_NO_OBSTACLES, classes="muted", markup=False)
            await event.pane.query_one(VerticalScroll).mount(*(rows or [nothing]))
        if self._judged is not self._draft:
            self._judge()
        self._draw_problems()
        self._focus_field(event.pane)

    def _focus_field(self, pane: TabPane) -> None:
        """Focus the wanted field, or else the first one of the section."""
        rows = [row for row in pane.query(FieldRow) if row.display]
        wanted = next((row for row in rows if row.field_id == self._wanted), None)
        if not rows:
            self.query_one("#sections Tabs").focus()
        elif wanted is not None or self.focused not in [row.input for row in rows]:
            (wanted or rows[0]).input.focus()
        self._wanted = ""

    # -- editing -------------------------------------------------------------------------------------------------------

    @on(Input.Changed)
    def take_text(self, event: Input.Changed) -> None:
        """Apply typed text to the draft; keys in one field are one undo step."""
        event.stop()
        row = event.input.parent
        if not isinstance(row, FieldRow) or self._text_of(row.field_id) == event.value:
            return
        draft = with_text(self._draft, row.field_id, event.value)
        if row.form.name in ("position", "rpy") and row.field_id.startswith("arms."):
            draft = with_text(draft, f"{row.field_id.rpartition('.')[0]}.note", "")  # typed, no longer surveyed
        if self._typing_in == row.field_id:
            self._draft = draft
            self._changed()
        else:
            self._change(draft)
            self._typing_in = row.field_id

    def _change(self, draft: ProfileDraft) -> None:
        self._before.append(self._draft)
        self._after.clear()
        self._draft, self._typing_in = draft, ""
        self._changed()

    def _changed(self) -> None:
        self._draw_kinds()
        if self._timer is not None:
            self._timer.stop()
        self._timer = self.set_timer(_PAUSE_S, self._judge)

    async def action_undo(self) -> None:
        """Undo the last edit."""
        await self._step(self._before, self._after, "Nothing to undo.")

    async def action_redo(self) -> None:
        """Redo the last undone edit."""
        await self._step(self._after, self._before, "Nothing to redo.")

    async def _step(self, taken: list[ProfileDraft], kept: list[ProfileDraft], nothing: str) -> None:
        if not taken:
            self.notify(nothing)
            return
        kept.append(self._draft)
        await self._show_draft(taken.pop())

    async def _show_draft(self, draft: ProfileDraft) -> None:
        """Show another draft in the fields."""
        before = (len(self._draft.arms), len(self._draft.obstacles))
        self._draft, self._typing_in = draft, ""
        if (len(draft.arms), len(draft.obstacles)) != before:
            self._judged = None
            await self.recompose()
        for row in self.query(FieldRow):
            row.show_text(self._text_of(row.field_id))
        self._changed()

    async def action_add(self) -> None:
        """Add an obstacle in the section Obstacles, else an arm like the last one with its individual fields empty."""
        arms, obstacles = self._draft.arms, self._draft.obstacles
        if self._section == "section-obstacles":
            new_obstacle = ObstacleDraft(shape="box", fixed_to="cell", position="0, 0, 0", rpy="0, 0, 0 deg")
            self._wanted = f"obstacles.{len(obstacles)}.name"
            await self._replace(replace(self._draft, obstacles=(*obstacles, new_obstacle)))
            return
        like = arms[-1] if arms else ArmDraft(kind=arm_kinds()[0])
        new = replace(like, name="", host="", serial="", position="", source="", note="")
        self._section = f"section-arm-{len(arms)}"
        await self._replace(replace(self._draft, arms=(*arms, new)))

    async def action_remove(self) -> None:
        """Remove the obstacle of the focused field, or the arm whose section is shown."""
        if self._section == "section-obstacles":
            await self._remove_obstacle()
            return
        index = self._present_arm()
        if index is None or len(self._draft.arms) == 1:
            self.notify("Show the section of the arm to remove; one arm has to stay.")
            return
        name = self._draft.arms[index].name
        arms = self._draft.arms[:index] + self._draft.arms[index + 1 :]
        await self._replace(replace(self._draft, arms=arms))
        self.notify(f"Arm {name} removed; Ctrl+Z brings it back.")

    async def _remove_obstacle(self) -> None:
        row = self.focused.parent if self.focused is not None else None
        if not isinstance(row, FieldRow):
            self.notify("Go to a field of the obstacle to remove.")
            return
        index = int(row.field_id.split(".")[1])
        obstacles = self._draft.obstacles
        await self._replace(replace(self._draft, obstacles=obstacles[:index] + obstacles[index + 1 :]))
        self.notify(f"Obstacle {obstacles[index].name} removed; Ctrl+Z brings it back.")

    async def _replace(self, draft: ProfileDraft) -> None:
        self._before.append(self._draft)
        self._after.clear()
        await self._show_draft(draft)

    def action_points(self) -> None:
        """Compute the base pose of the shown arm from tracker points."""
        index = self._present_arm()
        if index is None:
            self.notify("Show the section of an arm first (F6).")
            return
        self.app.push_screen(PointsDialog(self._draft, index, self._opened.path), self._use_base)

    async def _use_base(self, draft: ProfileDraft | None) -> None:
        if draft is not None:
            await self._replace(draft)

    # -- judging and drawing -------------------------------------------------------------------------------------------

    def _judge(self) -> None:
        self._judge_draft(self._target(), self._draft)

    @work(thread=True, exclusive=True, group="judge")
    def _judge_draft(self, opened: OpenProfile, draft: ProfileDraft) -> None:
        from cellapp.commands.plan.charts_placement import placement_chart  # loads scipy: not in the thread of the keys

        try:
            checked = new_text(opened, draft).checked
        except InputError as error:
            self.post_message(Judged(draft, (FieldProblem("", "", str(error)),)))
        else:
            chart = placement_chart(checked.bases, checked.tracker, checked.obstacles)
            self.post_message(Judged(draft, checked.problems, chart))

    @on(Judged)
    def show_judged(self, event: Judged) -> None:
        """Draw the problems beside their fields, and the map, if they belong to the current draft."""
        if event.draft is not self._draft:
            return
        self._judged = event.draft
        self._problems = event.problems
        self._draw_problems()
        if event.chart is not None:
            self.query_one(ChartPlot).chart = event.chart
        self._draw_titles()
        self._draw_help()

    def _draw_problems(self) -> None:
        """Draw the problems beside the existing fields."""
        words: dict[str, str] = {}
        for problem in self._problems:
            words.setdefault(problem.field, problem.words)
        for row in self.query(FieldRow):
            row.show_problem(words.get(row.field_id, ""))

    def _draw_titles(self) -> None:
        """Draw name, state and number of problems, in total and for each section."""
        counts = Counter(self._section_of(problem.field) for problem in self._problems)
        sections = self.query_one("#sections", TabbedContent)
        for name, title in self._titles().items():
            mark = f" ({counts[name]})" if counts[name] else ""
            sections.get_tab(f"section-{name}").label = f"{title}{mark}"
        state = "not saved" if self._draft != self._opened.draft else "saved" if self._saved else "unchanged"
        count = len(self._problems)
        problems = f"{counted(count, 'field')} to correct" if count else "every field holds"
        self.query_one("#form-title", Static).update(f"{self._target().path} · {state} · {problems}")

    def _draw_help(self) -> None:
        """Draw the help of the focused field, and what is wrong with it."""
        row = self.focused.parent if self.focused is not None else None
        if not isinstance(row, FieldRow):
            return
        own = [problem.words for problem in self._problems if problem.field == row.field_id]
        other = [str(problem) for problem in self._problems if not problem.field]
        wrong = "; ".join([*own, *other])
        help_text = f"{row.form.label}: {row.form.help}"
        self.query_one("#form-help", Static).update(f"{help_text}\n{wrong}" if wrong else help_text)

    def _draw_kinds(self) -> None:
        """Show only the fields that the chosen kinds of devices have."""
        shown = self._shown_ids()
        for row in self.query(FieldRow):
            row.display = row.field_id in shown

    def _shown_ids(self) -> set[str]:
        names = {f"arms.{index}.name" for index in range(len(self._draft.arms))}
        names |= {f"obstacles.{index}.name" for index in range(len(self._draft.obstacles))}
        return names | {item.id for item in fields_of(self._draft)}

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        """Explain the field; the next key in it begins a new undo step."""
        self._typing_in = ""
        self._draw_help()

    def action_map(self) -> None:
        """Switch between the map alone and the fields."""
        self.toggle_class("map")

    def action_next_section(self) -> None:
        """Show the next section."""
        panes = [str(pane.id) for pane in self.query(TabPane)]
        self.query_one("#sections", TabbedContent).active = panes[(panes.index(self._section) + 1) % len(panes)]

    def action_next_problem(self) -> None:
        """Go to the next field with a problem."""
        wrong = list(dict.fromkeys(problem.field for problem in self._problems if problem.field))
        if not wrong:
            self.notify("Every field holds.")
            return
        row = self.focused.parent if self.focused is not None else None
        here = wrong.index(row.field_id) if isinstance(row, FieldRow) and row.field_id in wrong else -1
        self._wanted = wrong[(here + 1) % len(wrong)]
        section = f"section-{self._section_of(self._wanted)}"
        if section == self._section:
            self._focus_field(self.query_one(f"#{section}", TabPane))
        else:
            self.query_one("#sections", TabbedContent).active = section

    # -- saving --------------------------------------------------------------------------------------------------------

    @work(exclusive=True, group="save")
    async def action_save(self) -> None:
        """Save; ask before anything is replaced or lost."""
        opened, draft = self._target(), self._draft
        try:
            new = await asyncio.to_thread(new_text, opened, draft)
            sentences = before_saving(opened, new, changed=await asyncio.to_thread(changed_on_disk, opened))
            if sentences and not await self._agreed("\n".join(sentences)):
                self.notify("Nothing was saved.")
                return
            self._opened = await asyncio.to_thread(save, opened, draft, new)
        except InputError as error:
            self.notify(str(error), severity="error", timeout=10.0)
            return
        self._saved = self._opened.path
        if self._draft is draft:
            await self._show_draft(self._opened.draft)
        self._judge()
        self.notify(f"Saved as {self._saved}.")

    async def _agreed(self, text: str) -> bool:
        answers = (Answer("no", "Do not save", "n"), Answer("save", "Save", "s", "warning"))
        return await self.app.push_screen_wait(Choice("Save?", text, answers)) == "save"

    def action_close(self) -> None:
        """Close; ask if there are unsaved changes."""
        if self._draft == self._opened.draft:
            self.dismiss(self._saved)
            return
        answers = (Answer("stay", "Continue editing", "c"), Answer("leave", "Leave without saving", "l", "warning"))
        text = "Some fields are not saved yet (Ctrl+S saves)."

        def leave(answer: str | None) -> None:
            if answer == "leave":
                self.dismiss(self._saved)

        self.app.push_screen(Choice("Leave the form?", text, answers), leave)

    # -- small questions -----------------------------------------------------------------------------------------------

    def _target(self) -> OpenProfile:
        """Return the file to write; until it is saved, a new profile's file is named after the cell."""
        if self._opened.text is not None or not self._draft.name.strip():
            return self._opened
        return replace(self._opened, path=self._opened.path.with_name(file_name(self._draft)))

    def _text_of(self, field_id: str) -> str:
        section: object = self._draft
        for name in field_id.split("."):
            section = section[int(name)] if isinstance(section, tuple) else getattr(section, name)
        return str(section)

    def _present_arm(self) -> int | None:
        name = self._section.removeprefix("section-")
        return int(name.removeprefix("arm-")) if name.startswith("arm-") else None

    def _section_of(self, field_id: str) -> str:
        first, *rest = field_id.split(".")
        return f"arm-{rest[0]}" if first == "arms" else first if first in ("tracker", "obstacles") else "cell"
