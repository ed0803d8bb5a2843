"""Pictures of a run's pages for the handbook, taken in a real browser."""

from __future__ import annotations

import io
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.ground.outputs import RENEWED, write_new_bytes
from tests.sure import sure

if TYPE_CHECKING:
    from playwright.sync_api import Page

_LONGEST_MS = 60_000
_COLOURS = 128
"""Colours of a picture: pages are flat, and a palette takes a third of the bytes."""


@dataclass(frozen=True)
class PagePicture:
    """One picture of a page.

    Attributes
    ----------
    name : str
        Of the file, without its ending.
    selector : str
        CSS selector of the part that is shown; empty for what a window shows first.
    file : str
        The page, in the run's folder.
    size : tuple of int
        Width and height of the window [px].
    dark : bool
        Whether the reader wants it dark.
    most_height : int
        A longer part is cut there [px].
    """

    name: str
    selector: str = ""
    file: str = "report.html"
    size: tuple[int, int] = (1280, 800)
    dark: bool = False
    most_height: int = 1200


PICTURES: tuple[PagePicture, ...] = (
    PagePicture("page-summary"),
    PagePicture("page-dark", size=(390, 844), dark=True),
    PagePicture("page-discovery", "details.section:has(#discovery)"),
    PagePicture("page-iso9283", "details.section:has(#iso9283)"),
    PagePicture("page-certificate", "section.certificate", "certificate.html"),
)
"""Pictures of the handbook. The run needs all that they show: a certificate, and tests by ISO 9283."""


def write_pictures(run: Path, out: Path) -> list[Path]:
    """Take the pictures of pages in a run's folder, as they were written; their paths. Needs Playwright and a Chromium,
    as Debian's package chromium."""
    from playwright.sync_api import sync_playwright

    taken = {}
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for picture in PICTURES:
            page = browser.new_page(
                viewport={"width": picture.size[0], "height": picture.size[1]},
                color_scheme="dark" if picture.dark else "light",
            )
            page.goto((run / picture.file).absolute().as_uri(), timeout=_LONGEST_MS)
            taken[out / f"{picture.name}.png"] = _small(_shot(page, picture))
            page.close()
        browser.close()
    return list(write_new_bytes(taken, RENEWED))


def _shot(page: Page, picture: PagePicture) -> bytes:
    """The PNG of the part that is shown."""
    if not picture.selector:
        return page.screenshot()
    part = page.locator(picture.selector).first
    part.evaluate("part => { if (part.tagName === 'DETAILS') part.open = true; }")
    box = sure(part.bounding_box())
    box["height"] = min(box["height"], picture.most_height)
    return page.screenshot(clip=box, full_page=True)


def _small(png: bytes) -> bytes:
    """The same picture with a palette."""
    from PIL import Image

    stream = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        palette = Image.Quantize.MAXCOVERAGE  # keeps the colours of small marks
        flat = image.convert("RGB").quantize(_COLOURS, palette, dither=Image.Dither.NONE)
        flat.save(stream, "PNG", optimize=True)
    return stream.getvalue()
