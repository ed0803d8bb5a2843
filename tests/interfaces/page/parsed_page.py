"""A report page taken apart."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from html.parser import HTMLParser

from cellapp.cell.run import RunFile
from cellapp.interfaces.page.page import page_text

NOON = datetime(2026, 1, 2, 12, 0, 0, tzinfo=UTC)


class Page(HTMLParser):
    """A parsed page; ``faults`` are elements that are not closed in the order in which they were opened."""

    _VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.faults: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        self.faults += self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in self._VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open.pop() != tag:
            self.faults.append(f"/{tag} at {self.getpos()}")

    def handle_data(self, data: str) -> None:
        if not self._open or self._open[-1] not in ("style", "script"):
            self.texts.append(data.strip())

    @property
    def text(self) -> str:
        return "\n".join(text for text in self.texts if text)

    @property
    def words(self) -> str:
        """The text in one line."""
        return re.sub(r"\s+", " ", self.text)

    def values(self, attribute: str) -> list[str]:
        return [value or "" for _, attributes in self.elements if (value := attributes.get(attribute, "")) != ""]


def page_of(run: RunFile) -> Page:
    return Page(page_text(run, NOON))
