"""The report page in a real browser: quiet, alone, folding, dark, on a phone, on paper, tables copied and saved."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cellapp.cell.run import RunFile
from cellapp.interfaces.page.page import certificate_page, page_text
from tests.interfaces.page.cases import discovery
from tests.interfaces.page.parsed_page import NOON
from tests.interfaces.page.runs import LEFT, RIGHT, store_discovery
from tests.interfaces.page.test_page_summary import certificate
from tests.sure import sure
from tests.verbs import certificate_run

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")
pypdf = pytest.importorskip("pypdf", reason="no pypdf here; install the dev extra")

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
LONGEST_MS = 60_000


@pytest.fixture(scope="module")
def report(calibrated_folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with an unknown effect and with warnings of results that are missing."""
    folder = tmp_path_factory.mktemp("browser")
    shutil.copytree(calibrated_folders / "double", folder / "run")
    with RunFile.open(folder / "run", write=True) as run:
        store_discovery(run, discovery(LEFT, RIGHT))
        certificate_run(run, certificate_page)
        path = folder / "report.html"
        path.write_text(page_text(run, NOON), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}; Debian's package chromium has one")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS, timeout=LONGEST_MS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def wide(browser: Browser, report: Path) -> Iterator[Page]:
    """The page in a window of 1280 x 800, in the light."""
    context = browser.new_context(
        viewport={"width": 1280, "height": 800}, permissions=["clipboard-read", "clipboard-write"]
    )
    page = context.new_page()
    page.goto(report.as_uri(), timeout=LONGEST_MS)
    yield page
    context.close()


def _record(page: Page, messages: list[str], requests: list[str]) -> None:
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))


@pytest.mark.parametrize("width", [1280, 390])
def test_page_in_a_browser(browser: Browser, report: Path, width: int) -> None:
    grounds = {}
    for scheme in ("light", "dark"):
        page = browser.new_page(viewport={"width": width, "height": 844}, color_scheme=scheme)
        messages, requests = list[str](), list[str]()
        _record(page, messages, requests)
        page.goto(report.as_uri(), timeout=LONGEST_MS)
        page.locator("#fold").click()  # what is folded must fit, too
        assert page.get_by_role("heading", level=1).is_visible()
        assert page.get_by_role("heading", name=f"Arm {LEFT}: unknown effect").is_visible()
        assert messages == []
        assert requests == [report.as_uri()]
        assert page.evaluate("document.documentElement.scrollWidth") == width
        # what is wider than its frame scrolls in it; a drawing never is
        wider = "[...document.querySelectorAll('figure, .panel')].filter(e => e.scrollWidth > e.clientWidth).length"
        assert page.evaluate(wider) == 0
        grounds[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
        page.close()
    assert grounds["light"] != grounds["dark"]


def test_contents_lead_to_every_section_and_unfold_it(wide: Page) -> None:
    anchors = wide.eval_on_selector_all("nav.contents a", "links => links.map(link => link.hash.slice(1))")
    assert anchors[0] == "certificate"
    assert anchors[1:] == wide.eval_on_selector_all("details.section > .body", "bodies => bodies.map(body => body.id)")
    assert not wide.locator("#provenance").is_visible()
    wide.locator("nav.contents a[href='#provenance']").click()
    wide.locator("#provenance").wait_for(state="visible", timeout=LONGEST_MS)
    heads = "all => all.every(head => head.innerText.split('\\n').filter(line => line.trim()).length > 1)"
    assert wide.eval_on_selector_all("details.section > summary", heads), "each section has a message"


def test_folding_and_contents_need_no_script(browser: Browser, report: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri(), timeout=LONGEST_MS)
    section = page.locator("details.section").last
    assert section.get_attribute("open") is None
    section.locator("summary").first.click()
    assert section.get_attribute("open") is not None
    page.locator("nav.contents a[href='#parameters']").click()
    page.locator("#parameters").wait_for(state="visible", timeout=LONGEST_MS)
    assert not page.locator("#theme").is_visible(), "what needs the script is not offered"
    assert not page.locator(".tools").count()
    context.close()


def test_a_table_that_is_wider_than_a_phone_says_that_it_scrolls(browser: Browser, report: Path) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(report.as_uri(), timeout=LONGEST_MS)
    page.locator("#fold").click()
    page.wait_for_function("document.querySelector('#accuracy .table.scrolls') !== null", timeout=LONGEST_MS)
    wide, said = "e => e.scrollWidth > e.clientWidth + 1", "e => e.classList.contains('scrolls')"
    frames = page.locator("details.section .table:visible").all()
    assert [frame.evaluate(said) for frame in frames] == [frame.evaluate(wide) for frame in frames]
    hint = "getComputedStyle(document.querySelector('#accuracy .scrolls'), '::before').content"
    assert "scroll" in page.evaluate(hint)
    page.close()


def test_the_reader_chooses_light_or_dark(wide: Page) -> None:
    ground = "getComputedStyle(document.body).backgroundColor"
    before = wide.evaluate(ground)
    wide.locator("#theme").click()
    assert wide.locator("#theme").inner_text() == "Light"
    assert wide.evaluate(ground) != before
    wide.locator("#theme").click()
    assert wide.evaluate(ground) == before


def test_tables_are_copied_and_saved_with_exact_numbers(wide: Page, tmp_path: Path) -> None:
    frame = wide.locator("#accuracy .table").first
    shown = frame.locator("tbody tr").first.locator("td").first
    exact = sure(shown.get_attribute("data-value"))
    assert float(exact) == pytest.approx(float(shown.inner_text()), abs=1e-4)
    frame.get_by_role("button", name="Copy").click()
    frame.get_by_role("button", name="Copy").get_by_text("Done").wait_for(timeout=LONGEST_MS)
    lines = wide.evaluate("navigator.clipboard.readText()").split("\n")
    assert lines[0].split("\t")[:2] == ["stage, measure", "mean"]
    assert lines[1].split("\t")[1] == exact
    with wide.expect_download(timeout=LONGEST_MS) as waiting:
        frame.get_by_role("button", name="CSV").click()
    waiting.value.save_as(tmp_path / "table.csv")
    assert waiting.value.suggested_filename.endswith(".csv")
    saved = (tmp_path / "table.csv").read_text("utf-8-sig").splitlines()
    assert saved[0].startswith('"stage, measure",mean')
    assert exact in saved[1].split(",")


def test_paper_has_summary_and_certificate_on_two_pages_then_the_appendix(
    browser: Browser, report: Path, tmp_path: Path
) -> None:
    page = browser.new_page()
    page.goto(report.as_uri(), timeout=LONGEST_MS)
    heads = page.eval_on_selector_all("h2, h3, h4", "all => all.map(head => head.innerText)")
    page.pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True)
    page.close()
    pages = [page.extract_text() for page in pypdf.PdfReader(tmp_path / "report.pdf").pages]
    assert "What to do next" in pages[0]
    assert "Before and after" in pages[0]
    assert "Calibration certificate" in pages[0] + pages[1]
    assert "Date, name, signature" in pages[0] + pages[1], "the end of the certificate"
    assert "Appendix" not in pages[0] + pages[1]
    assert "Appendix" in pages[2].splitlines()[:2], "only the number of the page may stand before it"
    text = "\n".join(pages)
    assert "SHA-256 of calibration.json" in text, "a section that is folded on the screen is open on paper"
    assert "With 20 simulations without effects" not in text, "details stay folded"
    assert len(pages) <= 8
    assert not {text.splitlines()[-1] for text in pages} & {*heads}, "no heading alone at a page's end"
    assert "Unfold all" not in text
    assert "Contents" not in text


def test_a_certificate_prints_on_two_sheets_and_fits_a_telephone(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "certificate.html"
    path.write_text(certificate_page(certificate("left", "right")), "utf-8")
    page = browser.new_page(viewport={"width": 390, "height": 800}, java_script_enabled=False)
    page.goto(path.as_uri())
    assert page.locator(".certificate h2").inner_text() == "Calibration certificate"
    box = sure(page.locator(".certificate").bounding_box())
    assert box["x"] + box["width"] <= 390
    page.pdf(path=tmp_path / "certificate.pdf", prefer_css_page_size=True)
    page.close()
    sheets = pypdf.PdfReader(tmp_path / "certificate.pdf").pages
    assert len(sheets) <= 2
    assert [round(float(side) / 72.0 * 25.4) for side in sheets[0].mediabox[2:]] == [210, 297]
    printed = " ".join(sheet.extract_text() for sheet in sheets)
    assert "QA 17" in printed
    assert "of 2" in printed
