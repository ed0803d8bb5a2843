"""The verbs that store results in a run, in the order in which ``show`` names them."""

from __future__ import annotations

from cellapp.commands.calibrate.request import VERB as CALIBRATE
from cellapp.commands.certificate.request import VERB as CERTIFICATE
from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.follow.request import VERB as FOLLOW
from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Verb

STORING: tuple[Verb, ...] = (
    CALIBRATE,
    DISCOVER,
    LOCATE,
    COMPENSATE,
    PUSH,
    FOLLOW,
    ISO9283,
    CHECK,
    CERTIFICATE,
)
