"""The report page in a browser: quiet, alone, not wider than the window, and dark where the reader wants it so."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cellapp.calibration.calibrate import calibrate_run
from cellapp.reporting.page import page_text
from cellapp.run import RunFile
from tests.reporting.test_page import fill, pretend_discovery, profile_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    with RunFile.create(folder / "run", profile_of("left", "right")) as run:
        fill(run)
        calibrate_run(run)
        pretend_discovery(run, "left", "right")
        path = folder / "report.html"
        path.write_text(page_text(run, datetime(2026, 1, 2, 12, 0, 0, tzinfo=UTC)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}; Debian's package chromium has one")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS, timeout=60_000)
        yield opened
        opened.close()


def _listen(page: Page, said: list[str], asked: list[str]) -> None:
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))


@pytest.mark.parametrize("width", [1280, 600])
def test_page_in_a_browser(browser: Browser, report: Path, width: int) -> None:
    grounds = {}
    for scheme in ("light", "dark"):
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        said: list[str] = []
        asked: list[str] = []
        _listen(page, said, asked)
        page.goto(report.as_uri(), timeout=60_000)
        assert page.get_by_role("heading", level=1).is_visible()
        assert page.get_by_role("heading", name="Arm left: unknown effect").is_visible()
        assert page.get_by_text("Where the arm goes is now known to").first.is_visible()
        assert said == []
        assert asked == [report.as_uri()]
        assert page.evaluate("document.documentElement.scrollWidth") == width
        # what is wider than its frame scrolls in it; a drawing never is
        wider = "[...document.querySelectorAll('figure, .panel')].filter(e => e.scrollWidth > e.clientWidth).length"
        assert page.evaluate(wider) == 0
        grounds[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
        page.close()
    assert grounds["light"] != grounds["dark"]
