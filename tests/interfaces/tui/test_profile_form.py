"""The first run and the form of a profile: keys in, a profile on the disk out; nothing is lost without a question."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from textual.geometry import Region
from textual.pilot import Pilot
from textual.widgets import Button, Static, TabbedContent, TextArea

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import copy_starter
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.first_run import Welcome, edit_profile, offer_first_run
from cellapp.interfaces.tui.dialogs.points import PointsDialog
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.plots import ChartPlot
from cellapp.interfaces.tui.screens.profile_form import ProfileForm
from cellapp.interfaces.tui.widgets.form_fields import FieldRow
from cellapp.interfaces.tui.widgets.stop import StopButton
from cellapp.robot.kinematics.transforms import apply, invert
from cellapp.robot.model.nominal import pose_matrix
from tests.interfaces.tui.pilot import SIZES, SMALL, shown_text, shows, until

TWIN = Path("profiles/twin.yaml")


@pytest.fixture
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellApp:
    """The application in an empty folder; what waits for a rest in typing waits a moment only."""
    for module in ("screens.profile_form", "dialogs.points"):
        monkeypatch.setattr(f"cellapp.interfaces.tui.{module}._PAUSE_S", 0.01)
    monkeypatch.chdir(tmp_path)
    return CellApp(Path("profiles"))


@pytest.fixture
def with_twin(app: CellApp) -> CellApp:
    """The application in a folder with the twin."""
    copy_starter("twin", app.profiles)
    return app


def form(app: CellApp) -> ProfileForm:
    return next(screen for screen in app.screen_stack if isinstance(screen, ProfileForm))


def row(app: CellApp, field: str) -> FieldRow:
    return next(row for row in form(app).query(FieldRow) if row.field_id == field)


async def show(pilot: Pilot[None], app: CellApp, section: str) -> None:
    """Show a section and wait for its fields."""
    form(app).query_one(TabbedContent).active = f"section-{section}"
    name = section.replace("arm-", "arms.").replace("cell", "name")
    await until(pilot, lambda: any(row.field_id.startswith(name) for row in form(app).query(FieldRow)), section)


def text(app: CellApp, field: str) -> str:
    return row(app, field).input.value


def problem(app: CellApp, field: str) -> str:
    return str(row(app, field).query_one(".problem", Static).content)


async def judged(pilot: Pilot[None], app: CellApp, field: str, words: str) -> None:
    """Wait until a field is judged, which a thread does, and ``words`` stand beside it."""
    await until(pilot, lambda: words in problem(app, field), words)


async def drawn(pilot: Pilot[None], app: CellApp, words: str) -> None:
    """Wait until the map says ``words``."""

    def says() -> bool:
        chart = form(app).query_one(ChartPlot).chart
        return chart is not None and words in chart.message

    await until(pilot, says, words)


def title(app: CellApp) -> str:
    return "".join(str(part.content) for part in form(app).query("#form-title").results(Static))


async def shown(pilot: Pilot[None], app: CellApp, words: str) -> None:
    """Wait until the form was judged and its title says ``words``."""
    await until(pilot, lambda: words in title(app), words)


async def fill(pilot: Pilot[None], app: CellApp, field: str, value: str) -> None:
    """Replace the text of a field as a paste does."""
    first, _, rest = field.partition(".")
    await show(pilot, app, f"arm-{rest[0]}" if first == "arms" else "tracker" if first == "tracker" else "cell")
    row(app, field).input.value = value
    await pilot.pause()


async def edit(pilot: Pilot[None], app: CellApp) -> None:
    edit_profile(app, TWIN)
    await until(pilot, lambda: isinstance(app.screen, ProfileForm), "the form")
    await shown(pilot, app, "every field holds")


async def asked(pilot: Pilot[None], app: CellApp, *words: str) -> None:
    """Wait for a question with these words."""

    def asks() -> bool:
        said = " ".join(str(part.content) for part in app.screen.query(Static))
        return isinstance(app.screen, Choice) and all(word in said for word in words)

    await until(pilot, asks, f"the question {words}")


# -- first run --------------------------------------------------------------------------------------------------------


async def test_enter_in_an_empty_folder_opens_the_twin(app: CellApp) -> None:
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Welcome), "the question")
        await pilot.pause()
        for answer in ("Try the simulated twin (t)", "Write a profile for my cell (w)", "Open a profile elsewhere (o)"):
            await shows(pilot, answer)
        await pilot.press("enter")
        await until(pilot, lambda: app.workspace.profile is not None, "the twin")
        assert app.workspace.kind == "simulated"
        assert load_profile(TWIN) == app.workspace.profile
        assert not offer_first_run(app), "there is a profile now"


async def test_what_cannot_be_written_or_edited_gets_a_sentence(app: CellApp) -> None:
    Path("profiles").write_text("a file", "utf-8")
    async with app.run_test(size=SMALL) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Welcome), "the question")
        edit_profile(app, Path("nothing.yaml"))
        assert app.message == "nothing.yaml: file not found; give the path of a profile"
        await pilot.press("t")
        await until(pilot, lambda: "profiles" in app.message and "give" in app.message, "the sentence")


# -- a new profile ----------------------------------------------------------------------------------------------------

ANSWERS = {
    "name": "hall 3",
    "plan.floor": "-0.2",
    "arms.0.host": "192.168.0.10",
    "arms.0.position": "0, 0.85, 0",
    "arms.0.smr_offset": "0.045, 0.02, 0.06",
    "arms.1.host": "192.168.0.11",
    "arms.1.position": "0, -850 mm, 0",
    "arms.1.smr_offset": "unknown",
    "tracker.address": "192.168.0.1",
    "tracker.position": "3.8, 0, 0.6",
}


async def test_a_new_cell_is_written_with_what_the_form_asks_for(app: CellApp) -> None:
    async with app.run_test(size=(120, 40)) as pilot:
        await until(pilot, lambda: isinstance(app.screen, Welcome), "the question")
        await pilot.press("w")
        await until(pilot, lambda: isinstance(app.screen, ProfileForm), "the form")
        await shown(pilot, app, "9 fields to correct")
        await pilot.press("f4")  # from the name to the first problem of the left arm
        await until(pilot, lambda: "Controller: address" in shown_text(app), "the next problem")
        assert app.focused is row(app, "arms.0.host").input
        await judged(pilot, app, "arms.0.host", "missing; it must be given")
        for field, value in ANSWERS.items():
            await fill(pilot, app, field, value)
        await shown(pilot, app, "hall-3.yaml · not saved · every field holds")
        await drawn(pilot, app, "left at 0.00, 0.85 m")
        await pilot.press("ctrl+s")
        await shown(pilot, app, "· saved ·")
        await pilot.press("escape")
        await until(pilot, lambda: app.workspace.profile is not None, "the new profile")
    profile = load_profile(Path("profiles/hall-3.yaml"))
    assert profile == app.workspace.profile
    assert app.workspace.kind == "real"
    assert profile.arms["right"].smr.offset == "unknown"


# -- an existing profile ----------------------------------------------------------------------------------------------


async def test_undo_steps_by_field_and_a_problem_stands_beside_its_field(with_twin: CellApp) -> None:
    app = with_twin
    async with app.run_test(size=(160, 40)) as pilot:
        await edit(pilot, app)
        await pilot.press("down", "end", "backspace", "5", "down", "end", "x")
        assert (text(app, "plan.stops"), text(app, "plan.clearance")) == ("405", "50 mmx")
        await pilot.press("ctrl+z")
        assert (text(app, "plan.stops"), text(app, "plan.clearance")) == ("405", "50 mm")
        await pilot.press("ctrl+z")
        assert text(app, "plan.stops") == "400"
        await pilot.press("ctrl+y", "ctrl+y")
        assert (text(app, "plan.stops"), text(app, "plan.clearance")) == ("405", "50 mmx")
        await pilot.press("ctrl+z", "ctrl+z")
        await pilot.press("f6")
        await until(pilot, lambda: app.focused is row(app, "arms.0.name").input, "the section")
        await pilot.press("down", "down", "down", "end", "backspace", "k", "m")
        await shown(pilot, app, "1 field to correct")
        assert text(app, "arms.0.position") == "0.0, 0.85, 0.km"
        await judged(pilot, app, "arms.0.position", "'km' is not a unit of length; use one of m,")
        await shows(pilot, "left (1)")
        await pilot.press("ctrl+z")
        await shown(pilot, app, "unchanged · every field holds")
        assert text(app, "arms.0.position") == "0.0, 0.85, 0.0"
        await until(pilot, lambda: problem(app, "arms.0.position") == "", "no problem")


async def test_saving_asks_and_overwrites_nothing_silently(with_twin: CellApp) -> None:
    app = with_twin
    before = TWIN.read_text("utf-8")
    async with app.run_test(size=SMALL) as pilot:
        await edit(pilot, app)
        await fill(pilot, app, "plan.stops", "120")
        await pilot.press("ctrl+s")
        await asked(pilot, app, "Saving changes profiles/twin.yaml: 1 line taken out, 1 line put in.")
        await pilot.press("enter")  # the first answer: not
        await until(pilot, lambda: isinstance(app.screen, ProfileForm), "the form")
        assert TWIN.read_text("utf-8") == before
        await pilot.press("ctrl+s")
        await asked(pilot, app)
        await pilot.press("s")
        await shown(pilot, app, "· saved ·")
        assert TWIN.read_text("utf-8") == before.replace("stops: 400", "stops: 120")
        await fill(pilot, app, "plan.floor", "")
        TWIN.write_text(TWIN.read_text("utf-8") + "# a colleague\n", "utf-8")
        await pilot.press("ctrl+s")
        lost = "Comments that go with keys that are no longer there: both bases stand on plinths"
        await asked(pilot, app, "was changed by others since it was opened", lost)
        await pilot.press("n", "escape")
        await asked(pilot, app, "Some fields are not saved yet")
        await pilot.press("l")
        await until(pilot, lambda: not any(isinstance(s, ProfileForm) for s in app.screen_stack), "the end of the form")
    assert TWIN.read_text("utf-8").endswith("# a colleague\n")


async def test_the_fields_are_those_of_the_arms_and_their_drivers(with_twin: CellApp) -> None:
    app = with_twin
    async with app.run_test(size=SMALL) as pilot:
        await edit(pilot, app)
        await show(pilot, app, "arm-0")
        assert not row(app, "arms.0.host").display
        await fill(pilot, app, "arms.0.kind", "ur")
        await fill(pilot, app, "tracker.kind", "bridge")
        await until(pilot, lambda: row(app, "arms.0.host").display, "the fields of the driver")
        assert row(app, "tracker.url").display
        assert not row(app, "tracker.address").display
        await shown(pilot, app, "2 fields to correct")
        await pilot.press("ctrl+z", "ctrl+z")
        await pilot.press("f7")
        await shown(pilot, app, "1 field to correct")
        await judged(pilot, app, "arms.2.name", "each arm needs a name")
        await pilot.press("f8")
        await shown(pilot, app, "unchanged · every field holds")
        await pilot.press("ctrl+z")
        await shown(pilot, app, "1 field to correct")


def point_lines() -> str:
    """Four points of an arm that stands at (1, 2, 0), turned by 90 deg, before the tracker of the twin."""
    tracker = load_profile(TWIN).tracker.pose
    assert tracker is not None
    p_B = np.array([[0.8, 0.1, 0.3], [-0.2, 0.7, 0.9], [-0.6, -0.5, 0.2], [0.1, -0.4, 1.1]])
    p_C = p_B @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [1.0, 2.0, 0.0]
    p_M = apply(invert(pose_matrix(tracker)), p_C)
    pairs = zip(p_B.tolist(), p_M.tolist(), strict=True)
    return "\n".join(f"{', '.join(map(str, b))} ; {', '.join(map(str, m))}" for b, m in pairs)


async def test_a_base_is_found_from_tracker_points(with_twin: CellApp) -> None:
    app = with_twin
    async with app.run_test(size=SMALL) as pilot:
        await edit(pilot, app)
        await pilot.press("f6", "f2")
        await until(pilot, lambda: isinstance(app.screen, PointsDialog), "the points")
        dialog = app.screen

        def fit() -> str:
            return str(dialog.query_one("#fit", Static).content)

        dialog.query_one(TextArea).text = "1, 2, 3"
        await until(pilot, lambda: "line 1: expected two lists" in fit(), "the refusal")
        assert dialog.query_one("#use", Button).disabled
        dialog.query_one(TextArea).text = point_lines()
        await until(pilot, lambda: "4 points fit to 0.00 mm rms" in fit(), "the fit")
        await pilot.press("ctrl+s")
        await until(pilot, lambda: app.screen is form(app), "the form")
        assert text(app, "arms.0.position") == "1.0000, 2.0000, 0.0000"
        assert text(app, "arms.0.rpy").endswith("90.000 deg")
        await pilot.press("ctrl+z")
        assert text(app, "arms.0.position") == "0.0, 0.85, 0.0"


async def test_an_obstacle_is_added_judged_drawn_and_removed(with_twin: CellApp) -> None:
    app = with_twin
    async with app.run_test(size=SMALL) as pilot:
        await edit(pilot, app)
        form(app).query_one(TabbedContent).active = "section-obstacles"
        await until(pilot, lambda: "F7 adds one" in shown_text(app), "the sentence where there is none")
        await pilot.press("f7")
        await until(pilot, lambda: app.focused is row(app, "obstacles.0.name").input, "the name of the new one")
        row(app, "obstacles.0.name").input.value = "table"
        row(app, "obstacles.0.size").input.value = "1.2, 0.8, -5 cm"
        await until(pilot, lambda: "more than 0" in problem(app, "obstacles.0.size"), "the problem")
        row(app, "obstacles.0.shape").input.value = "sphere"
        row(app, "obstacles.0.radius").input.value = "5 cm"
        await shown(pilot, app, "every field holds")
        await until(
            pilot,
            lambda: row(app, "obstacles.0.radius").display > row(app, "obstacles.0.size").display,
            "the fields of the shape",
        )
        await drawn(pilot, app, "table")
        await pilot.press("f8")
        await until(pilot, lambda: not form(app)._draft.obstacles, "the removal")


# -- every size -------------------------------------------------------------------------------------------------------


async def test_stop_and_map_at_every_size(with_twin: CellApp) -> None:
    app = with_twin
    async with app.run_test(size=SIZES[-1]) as pilot:
        await edit(pilot, app)
        await pilot.press("f6")
        for size in SIZES:
            await pilot.resize_terminal(*size)
            await pilot.pause()
            assert form(app).query_one(StopButton).region == Region(size[0] - 11, 0, 11, 1)
            assert ("From above" in shown_text(app)) == (size != SMALL)
            for label in ("Name", "Arm type", "Base position", "SMR offset", "Home", "Speed"):
                await shows(pilot, label)
            await pilot.press("f3")
            await pilot.pause()
            await shows(pilot, "From above: left at 0.00, 0.85 m")
            await pilot.press("f3")
            await pilot.pause()
