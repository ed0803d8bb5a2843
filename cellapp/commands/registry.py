"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.record import Verb

VERBS: tuple[Verb, ...] = (
    LOCATE,
    CHECK,
    ISO9283,
)
