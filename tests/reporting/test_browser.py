"""The report page in a browser: quiet, alone, not wider than the window, and dark where the reader wants it so."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cellapp.reporting.page import page_text
from cellapp.run import RunFile
from tests.reporting.cases import discovery
from tests.reporting.parsed_page import NOON
from tests.reporting.runs import LEFT, RIGHT, store_discovery

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]


@pytest.fixture(scope="module")
def report(calibrated_folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with an unknown effect and with warnings of results that are missing."""
    folder = tmp_path_factory.mktemp("browser")
    shutil.copytree(calibrated_folders / "double", folder / "run")
    with RunFile.open(folder / "run", write=True) as run:
        store_discovery(run, discovery(LEFT, RIGHT))
        path = folder / "report.html"
        path.write_text(page_text(run, NOON), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}; Debian's package chromium has one")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS, timeout=60_000)
        yield opened
        opened.close()


def _record(page: Page, messages: list[str], requests: list[str]) -> None:
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))


@pytest.mark.parametrize("width", [1280, 600])
def test_page_in_a_browser(browser: Browser, report: Path, width: int) -> None:
    grounds = {}
    for scheme in ("light", "dark"):
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        messages: list[str] = []
        requests: list[str] = []
        _record(page, messages, requests)
        page.goto(report.as_uri(), timeout=60_000)
        assert page.get_by_role("heading", level=1).is_visible()
        assert page.get_by_role("heading", name=f"Arm {LEFT}: unknown effect").is_visible()
        assert page.get_by_text("The mean error of the predicted SMR position").first.is_visible()
        assert messages == []
        assert requests == [report.as_uri()]
        assert page.evaluate("document.documentElement.scrollWidth") == width
        # what is wider than its frame scrolls in it; a drawing never is
        wider = "[...document.querySelectorAll('figure, .panel')].filter(e => e.scrollWidth > e.clientWidth).length"
        assert page.evaluate(wider) == 0
        grounds[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
        page.close()
    assert grounds["light"] != grounds["dark"]
