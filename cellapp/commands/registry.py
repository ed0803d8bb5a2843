"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.at_rest.request import VERB as AT_REST
from cellapp.commands.correct.request import VERB as CORRECT
from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.record import Verb

VERBS: tuple[Verb, ...] = (
    DOCTOR,
    LOCATE,
    EXPORT,
    CORRECT,
    AT_REST,
)
