"""Declaration of an effect as Markdown for the handbook."""

from __future__ import annotations

import textwrap

from cellapp.robot.effects import Effect

WIDTH = 120
"""Line width of the Markdown files."""
_GENERAL_PLACE = {"link_bending": "the link", "unknown": "a part of the cell"}


def declared_part(effect: Effect) -> str:
    """Return an effect's declaration as Markdown, between markers: cause, usual size, checks, further stops."""
    meaning = effect.meaning.at(_GENERAL_PLACE.get(effect.slug, "the joint"))
    known = "" if meaning.size_source == "none" else f" ({meaning.size_source})"
    parts = [
        _wrapped(f"**Cause.** {meaning.cause}"),
        _wrapped(f"**Usual size**{known}. {meaning.size}."),
        _wrapped(f"**Check or mend.** {' '.join(meaning.check)}"),
        *([_wrapped(f"**What settles it.** {' '.join(meaning.settle)}")] if meaning.settle else []),
    ]
    return f"<!--declared:{effect.slug}-->\n" + "\n\n".join(parts) + "\n<!--end-->\n"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)
