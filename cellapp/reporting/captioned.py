"""A figure of the page with its caption."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CaptionedFigure:
    """SVG text, caption and legend.

    ``legend`` pairs a swatch class of the style sheet (empty: no swatch) with a text; ``note`` is a sentence below;
    ``css_class`` is ``wide`` for a figure over the whole width.
    """

    svg: str
    caption: str
    legend: tuple[tuple[str, str], ...]
    css_class: str = ""
    note: str = ""
