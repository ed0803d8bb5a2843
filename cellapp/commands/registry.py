"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.certificate.request import VERB as CERTIFICATE
from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.check_certificate.request import VERB as CHECK_CERTIFICATE
from cellapp.commands.follow.request import VERB as FOLLOW
from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.record import Verb
from cellapp.commands.sign_key.request import VERB as SIGN_KEY

VERBS: tuple[Verb, ...] = (
    LOCATE,
    CHECK,
    FOLLOW,
    ISO9283,
    CERTIFICATE,
    SIGN_KEY,
    CHECK_CERTIFICATE,
)
