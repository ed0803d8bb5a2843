"""The glossary: in the order of the alphabet, short, each term with a chapter that says more."""

from __future__ import annotations

import re

from cellapp.commands.docs.handbook import topic_text


def test_terms_stand_in_order_are_short_and_lead_to_a_chapter() -> None:
    entries = topic_text("glossary").strip().split("\n\n")[2:]
    terms = [re.match(r"\*\*(.+?)\*\*: ", entry) for entry in entries]
    names = [term[1].lower() for term in terms if term is not None]
    assert len(names) == len(entries) > 60
    assert names == sorted(names)
    for entry in entries:
        assert re.search(r"\]\(\w+\.md", entry), entry
        assert len(re.sub(r"\]\([^)]+\)", "]", entry)) < 260, entry
