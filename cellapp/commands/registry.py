"""All verbs, in the order of the work. A new verb is a folder and a line here."""

from __future__ import annotations

from cellapp.commands.at_rest.request import VERB as AT_REST
from cellapp.commands.check_certificate.request import VERB as CHECK_CERTIFICATE
from cellapp.commands.collect.request import VERB as COLLECT
from cellapp.commands.compare.request import VERB as COMPARE
from cellapp.commands.correct.request import VERB as CORRECT
from cellapp.commands.demo.request import VERB as DEMO
from cellapp.commands.docs.request import VERB as DOCS
from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.emulate.request import VERB as EMULATE
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.fleet.request import VERB as FLEET
from cellapp.commands.import_.request import VERB as IMPORT
from cellapp.commands.init.request import VERB as INIT
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.recalibrate.request import VERB as RECALIBRATE
from cellapp.commands.record import Verb
from cellapp.commands.replay.request import VERB as REPLAY
from cellapp.commands.report.request import VERB as REPORT
from cellapp.commands.run.request import VERB as RUN
from cellapp.commands.runs.request import VERB as RUNS
from cellapp.commands.schema.request import VERB as SCHEMA
from cellapp.commands.show.request import show_verb
from cellapp.commands.sign_key.request import VERB as SIGN_KEY
from cellapp.commands.storing import STORING
from cellapp.commands.tracker_bridge.request import VERB as TRACKER_BRIDGE

VERBS: tuple[Verb, ...] = (
    RUN,
    DEMO,
    DOCTOR,
    INIT,
    PLAN,
    COLLECT,
    REPLAY,
    IMPORT,
    *STORING,
    SIGN_KEY,
    CHECK_CERTIFICATE,
    REPORT,
    show_verb(STORING),
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
