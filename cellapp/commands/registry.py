"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.at_rest.request import VERB as AT_REST
from cellapp.commands.certificate.request import VERB as CERTIFICATE
from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.check_certificate.request import VERB as CHECK_CERTIFICATE
from cellapp.commands.compare.request import VERB as COMPARE
from cellapp.commands.correct.request import VERB as CORRECT
from cellapp.commands.docs.request import VERB as DOCS
from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.emulate.request import VERB as EMULATE
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.fleet.request import VERB as FLEET
from cellapp.commands.follow.request import VERB as FOLLOW
from cellapp.commands.init.request import VERB as INIT
from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.recalibrate.request import VERB as RECALIBRATE
from cellapp.commands.record import Verb
from cellapp.commands.runs.request import VERB as RUNS
from cellapp.commands.schema.request import VERB as SCHEMA
from cellapp.commands.sign_key.request import VERB as SIGN_KEY
from cellapp.commands.tracker_bridge.request import VERB as TRACKER_BRIDGE

VERBS: tuple[Verb, ...] = (
    DOCTOR,
    LOCATE,
    CHECK,
    FOLLOW,
    ISO9283,
    CERTIFICATE,
    SIGN_KEY,
    CHECK_CERTIFICATE,
    INIT,
    EXPORT,
    CORRECT,
    AT_REST,
    RUNS,
    COMPARE,
    FLEET,
    RECALIBRATE,
    SCHEMA,
    DOCS,
    EMULATE,
    TRACKER_BRIDGE,
)
