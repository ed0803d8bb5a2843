"""The handbook in the terminal: contents, search, links by keys and by the mouse, pictures by their words."""

from __future__ import annotations

from textual.widgets import Input, OptionList, Tree

from cellapp.commands.docs.handbook import CHAPTERS, PARTS
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.handbook import Handbook, SectionText
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until


def at_top(app: CellApp) -> str:
    """Heading of the section whose text begins highest in the window of the chapter."""
    window = app.screen.query_one("#chapter").region
    visible = sorted((one.region.y, one.section.heading) for one in app.screen.query(SectionText))
    return next((heading for y, heading in visible if y >= window.y), "")


def label(contents: Tree[object]) -> str:
    """What stands under the cursor of the contents."""
    return "" if contents.cursor_node is None else str(contents.cursor_node.label)


async def test_chapters_are_searched_read_and_followed_through_their_links() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        await pilot.press("f1")
        await until(pilot, lambda: isinstance(app.screen, Handbook) and bool(app.screen.query(SectionText)), "a text")
        contents = app.screen.query_one("#contents", Tree)
        assert [str(part.label) for part in contents.root.children] == list(PARTS)
        assert [str(node.label) for part in contents.root.children for node in part.children] == list(CHAPTERS)
        await pilot.press("slash", *"hayati angle", "enter")
        await until(pilot, lambda: app.focused is contents, "the focus")
        await pilot.press("down", "up")
        await until(pilot, lambda: at_top(app) == "Hayati angle", "the section that was found")
        assert any("Picture: Nearly parallel" in line for line in shown_text(app).splitlines())
        links = app.screen.query_one("#links", OptionList)
        assert [option.id for option in links.options] == ["exports.md"]
        await pilot.press("tab", "enter")
        await until(pilot, lambda: "other programs" in at_top(app), "the chapter of the link")
        await pilot.press("comma")
        await until(pilot, lambda: at_top(app) == "Hayati angle", "where the link was")
        await pilot.press("q")
        await until(pilot, lambda: not isinstance(app.screen, Handbook), "the end of the handbook")


async def test_a_link_is_followed_by_a_click_and_pages_elsewhere_are_only_named() -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=(200, 60)) as pilot:
        await opened(pilot, app)
        app.push_screen(Handbook("effects.md#backlash"))
        await until(pilot, lambda: bool(app.screen.query(SectionText)), "the text")
        await until(pilot, lambda: at_top(app) == "backlash", "the section")
        handbook = app.screen
        assert isinstance(handbook, Handbook)
        lines = shown_text(app).splitlines()
        row = next(number for number, line in enumerate(lines) if "• friction_windup" in line)
        await pilot.click(offset=(lines[row].index("• friction_windup") + 4, row))
        await until(pilot, lambda: at_top(app) == "friction_windup", "the effect that was clicked")
        contents = handbook.query_one("#contents", Tree)
        await until(pilot, lambda: label(contents) == "friction_windup", "the cursor at that effect")
        await handbook.action_follow("https://example.org")
        await until(pilot, lambda: "https://example.org is not a part" in shown_text(app), "the address")
        handbook.query_one("#words", Input).value = "friction_windup"
        await until(pilot, lambda: len(contents.root.children) != len(PARTS), "what was found")
        await handbook.action_follow("effects.md#friction_windup")
        await until(pilot, lambda: label(contents) == "effects: friction_windup", "the cursor at what was found")
        handbook.query_one("#words", Input).value = "nosuchword"
        await pilot.pause()
        await until(pilot, lambda: len(contents.root.children) == len(PARTS), "nothing found: all parts")
