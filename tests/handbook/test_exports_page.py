"""The page about exports describes every format."""

from __future__ import annotations

import re

from cellapp.cell.exports.formats import all_formats
from cellapp.commands.docs.handbook import chapter_text


def test_the_page_describes_every_format() -> None:
    described = re.findall(r"^\| `([a-z-]+)` \|", chapter_text("exports"), re.M)
    assert described == list(all_formats())
