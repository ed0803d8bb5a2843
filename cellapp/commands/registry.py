"""All verbs, in the order of the work."""

from __future__ import annotations

from cellapp.commands.calibrate.request import VERB as CALIBRATE
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.import_.request import VERB as IMPORT
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Verb
from cellapp.commands.report.request import VERB as REPORT

VERBS: tuple[Verb, ...] = (IMPORT, CALIBRATE, DISCOVER, LOCATE, COMPENSATE, PUSH, REPORT)
