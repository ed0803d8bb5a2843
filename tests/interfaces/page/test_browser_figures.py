"""The page's figures in a browser: values under the pointer, a cell that turns, still pictures where nothing can."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from cellapp.cell.run import RunFile
from cellapp.interfaces.page.page import page_text
from tests.interfaces.page.cases import discovery
from tests.interfaces.page.parsed_page import NOON
from tests.interfaces.page.runs import LEFT, RIGHT, store_discovery

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")

NAMES = ("chromium", "chromium-browser", "google-chrome")
IN_SOFTWARE = [
    "--no-sandbox",
    "--disable-background-networking",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
NO_WEBGL = """
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : context.call(this, kind, ...more);
};
"""
PATIENCE_MS = 60_000
"""Far more than a page needs: a busy machine draws in software."""

Open = Callable[..., "Page"]


@pytest.fixture(scope="module")
def report(calibrated_folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    shutil.copytree(calibrated_folders / "double", folder / "run")
    with RunFile.open(folder / "run", write=True) as run:
        store_discovery(run, discovery(LEFT, RIGHT))
        path = folder / "report.html"
        path.write_text(page_text(run, NOON), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium here; Debian's package chromium has one")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=IN_SOFTWARE, timeout=PATIENCE_MS)
        yield browser
        browser.close()


@pytest.fixture
def opened(browser: Browser, report: Path) -> Iterator[Open]:
    """Opens the page; fails at the end if it asked for anything or had an error."""
    pages: list[Page] = []
    faults: list[str] = []
    asked: list[str] = []

    def open_page(before: str = "", **options: Any) -> Page:
        page = browser.new_context(**{"viewport": {"width": 700, "height": 560}, **options}).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        if before:
            page.add_init_script(before)
        page.goto(report.as_uri())
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.context.close()
    assert faults == []
    # what the page unpacks by itself has an address of its own, but comes from nowhere else
    assert {url for url in asked if not url.startswith(("blob:", "data:"))} <= {report.as_uri()}


def shown(page: Page, key: str) -> Locator:
    """The figure, with the sections around it unfolded and in view."""
    figure = page.locator(f"#{key}")
    unfold = "e => { for (let p = e.closest('details'); p; p = p.parentElement.closest('details')) p.open = true; }"
    figure.evaluate(unfold)
    figure.scroll_into_view_if_needed()
    return figure


def alive(page: Page, key: str) -> Locator:
    """The same, drawn by the script."""
    figure = shown(page, key)
    figure.locator("xpath=self::*[contains(@class, 'is-live')]").wait_for()
    return figure


def stroke(figure: Locator) -> str:
    return str(figure.locator(".live .xtick text").first.evaluate("e => getComputedStyle(e).fill"))


@pytest.mark.slow
def test_logarithmic_axes_are_labelled_by_whole_numbers_that_ascend(opened: Open) -> None:
    """Not 2, 1, 5, 2, the first digits alone."""
    figure = alive(opened(), "accuracy-1")
    labels = figure.locator(".live .ytick text")
    labels.first.wait_for()
    values = [float(words) for words in labels.all_text_contents() if words]
    assert len(values) >= 2
    assert values == sorted(values)


@pytest.mark.slow
def test_values_are_under_the_pointer_and_the_legend_hides_series(opened: Open) -> None:
    page = opened()
    figure = alive(page, "accuracy-1")
    assert not figure.locator(".drawing").is_visible()
    points = figure.locator(".live .scatterlayer .trace")
    stages = points.count()
    point = points.last.locator(".point").first
    point.hover(force=True)
    words = figure.locator(".hoverlayer .hovertext")
    words.first.wait_for()
    text = words.first.text_content() or ""
    assert "configuration" in text
    assert " mm" in text
    figure.get_by_role("button", name="nominal").click()
    page.wait_for_function(
        "n => document.querySelectorAll('#accuracy-1 .scatterlayer .trace').length === n", arg=stages - 1
    )


@pytest.mark.slow
def test_the_cell_turns(opened: Open) -> None:
    page = opened()
    figure = alive(page, "cell-1")
    camera = "JSON.stringify(document.querySelector('#cell-1 .live')._fullLayout.scene._scene.getCamera().eye)"
    before = json.loads(page.evaluate(camera))
    box = figure.locator(".live canvas").first.bounding_box()
    assert box is not None
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 150.0, y + 20.0, steps=5)
    page.mouse.up()
    page.wait_for_function(f"before => {camera} !== before", arg=page.evaluate("x => JSON.stringify(x)", before))
    # hostile names of arms are text in the legend, and the errors can be enlarged
    assert figure.get_by_role("button", name=f"arm {LEFT}").count() == 1
    figure.locator("input[type=range]").fill("3")
    assert figure.locator("output").text_content() == "1000"


@pytest.mark.slow
def test_figures_follow_the_theme_and_print_as_still_pictures(opened: Open) -> None:
    page = opened(color_scheme="light")
    figure = alive(page, "accuracy-1")
    light = stroke(figure)
    page.emulate_media(color_scheme="dark")
    page.wait_for_function(
        "was => getComputedStyle(document.querySelector('#accuracy-1 .live .xtick text')).fill !== was", arg=light
    )
    page.emulate_media(media="print")
    assert figure.locator(".drawing svg").is_visible()
    assert not figure.locator(".live").is_visible()


@pytest.mark.slow
def test_without_a_script_every_figure_is_a_still_picture_with_a_message(opened: Open) -> None:
    page = opened(java_script_enabled=False)
    figures = page.locator("figure[id]")
    assert figures.count() > 10
    for figure in figures.all():
        assert figure.locator(".drawing svg").count() == 1
        assert figure.locator(".message").count() == 1


@pytest.mark.slow
def test_without_webgl_the_cell_stays_a_still_picture(opened: Open) -> None:
    page = opened(before=NO_WEBGL)
    figure = shown(page, "cell-1")
    figure.get_by_text("the picture does not turn").wait_for()
    assert figure.locator(".drawing svg").is_visible()
