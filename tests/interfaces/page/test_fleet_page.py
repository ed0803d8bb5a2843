"""The page of a fleet in a browser: quiet, alone, not wider than the window, the worst arm first and unfolded."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cellapp.estimation.monitoring.fleet.histories import fleet_result
from cellapp.estimation.monitoring.fleet.records import DatedValue, FleetResult
from cellapp.interfaces.page.fleet_page import fleet_page_text
from tests.estimation.monitoring.fleet.drawn import arm, effect, geometry, month, run

if TYPE_CHECKING:
    from playwright.sync_api import Browser

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")

NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
HOSTILE = "<script>alert('serial')</script>"
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
MOST_BYTES = 5_000_000


def worn_fleet(arms: int = 2, runs: int = 8) -> FleetResult:
    """One arm with a hostile serial number that wears, and others that do not."""
    rng = np.random.default_rng(2)
    records = []
    for number in range(runs):
        found = (effect("backlash", {"half_play1": 1e-5 * number}, size_mm=0.01 * number),) if number > 3 else ()
        verified = DatedValue(run=f"logs/{number:02}", time=month(number), value=0.03 + 0.006 * number)
        worn = arm(
            geometry(rng, {"theta2": 2e-5 * number}),
            key=HOSTILE,
            effects=found,
            smallest={"backlash": {"half_play1": 5e-6}},
            figures={"verified": (verified,)},
        )
        sound = {f"arm{k}": arm(geometry(rng), key=f"S-{k}", effects=()) for k in range(1, arms)}
        records.append(run(number, {"worn": worn, **sound}, tolerance_mm=0.1))
    return fleet_result(records, ["logs"])


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fleet") / "fleet.html"
    path.write_text(fleet_page_text(worn_fleet(), NOON), encoding="utf-8")
    return path


@pytest.mark.fast
def test_the_page_is_small_escapes_names_and_needs_nothing_else(page_file: Path) -> None:
    text = page_file.read_text("utf-8")
    assert len(text.encode()) < MOST_BYTES
    assert HOSTILE not in text
    assert "&lt;script&gt;alert(" in text
    assert 'src="' not in text
    assert text == fleet_page_text(worn_fleet(), NOON)


@pytest.mark.fast
def test_a_fleet_without_runs_has_a_page() -> None:
    assert "no runs below logs" in fleet_page_text(fleet_result([], ["logs"], notes=["no runs below logs"]), NOON)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
    )
    if not chromium:
        pytest.skip("no Chromium here; Debian's package chromium has one")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=chromium, args=FLAGS, timeout=60_000)
        yield opened
        opened.close()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")], ids=["desk", "phone"])
def test_the_page_in_a_browser(browser: Browser, page_file: Path, width: int, scheme: str) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)  # type: ignore[arg-type]
    messages: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(page_file.as_uri(), timeout=60_000)
    assert page.locator("#arms tbody tr").first.inner_text().startswith("changed")
    sections = page.locator("details.section")
    assert [sections.nth(k).get_attribute("open") for k in range(2)] == ["", None]
    assert page.get_by_text("theta2: difference from the first run").first.is_visible()
    assert page.get_by_text("Largest distance from a target over time").first.is_visible()
    page.locator("details.section > summary").nth(1).click()
    assert sections.nth(1).get_attribute("open") == ""
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert messages == []
    assert [url for url in requests if not url.startswith(("data:", "blob:"))] == [page_file.as_uri()]
    page.close()
