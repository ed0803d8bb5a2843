"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.calibrate.request import VERB as CALIBRATE
from cellapp.commands.collect.request import VERB as COLLECT
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.demo.request import VERB as DEMO
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.import_.request import VERB as IMPORT
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Verb
from cellapp.commands.replay.request import VERB as REPLAY
from cellapp.commands.report.request import VERB as REPORT
from cellapp.commands.run.request import VERB as RUN
from cellapp.commands.show.later import LATER
from cellapp.commands.show.request import show_verb

_VERBS: tuple[Verb, ...] = (
    RUN,
    DEMO,
    PLAN,
    COLLECT,
    REPLAY,
    IMPORT,
    CALIBRATE,
    DISCOVER,
    LOCATE,
    COMPENSATE,
    PUSH,
    REPORT,
)
STORING: tuple[Verb, ...] = (*_VERBS, *LATER)
"""What ``show`` shows the results of."""
VERBS: tuple[Verb, ...] = (*_VERBS, show_verb(STORING))
