"""Parts of ``show`` come from the verbs that store them, and each part is shown by the view of its verb."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.targets.records import ArmVerification, MeasuredTarget, VerifyResult
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.locate.request import VERB as LOCATE
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.record import Request, Stored, Verb
from cellapp.commands.registry import STORING, records
from cellapp.commands.report.result import RunResults
from cellapp.commands.run.request import VERB as RUN
from cellapp.commands.run.run import WholeRunResult
from cellapp.commands.show.request import OWN_PARTS, show_verb
from cellapp.commands.show.result import Shown
from cellapp.commands.show.view import view
from cellapp.commands.view.parts import printed
from cellapp.ground.errors import InputError
from cellapp.ground.results import ErrorSummary
from cellapp.interfaces.cli.derived import command_of
from cellapp.interfaces.tui.work import job_of
from tests.interfaces.page.cases import discovery

pytestmark = pytest.mark.fast

SMALL_MM, LARGE_MM = (ErrorSummary(mean=mm, rms=mm, std=0.0, max=mm, n=3) for mm in (0.1, 2.0))
TARGETS = (MeasuredTarget(name="t1", arm="left", nominal_mm=None, compensated_mm=None, note=""),)
WORSE = VerifyResult(arms={"left": ArmVerification(nominal_mm=SMALL_MM, compensated_mm=LARGE_MM)}, targets=TARGETS)


def test_what_a_verb_stores_is_a_part_of_show() -> None:
    toy = Verb("toy", Request, "commands", stored=(Stored("toys", "no toy is", ("check",)),))
    show = show_verb((toy,))
    assert show.asked({"folder": "here", "part": "toys"}).model_dump()["part"] == "toys"
    with pytest.raises(InputError, match="show: "):
        show.asked({"folder": "here", "part": "calibration"})


def test_every_stored_part_names_stages_that_there_are() -> None:
    stored = [one for verb in records(STORING) for one in verb.stored]
    parts = [*OWN_PARTS, *(one.part for one in stored)]
    assert len(set(parts)) == len(parts)
    assert {stage for one in stored for stage in one.stages} <= set(RunResults.model_fields)
    assert len({verb.name for verb in records()}) == len(records())


def test_a_discovery_is_shown_as_its_verb_shows_it_with_its_steps_once() -> None:
    result = discovery("left", "right")
    shown = view(Shown(part="discovery", result=result))
    told = list(printed(shown.parts))
    assert told == list(printed(DISCOVER.view(result).parts))
    words = "\n".join(part if isinstance(part, str) else part.title for part in told)
    assert words.count("after each step") == len(result.arms)


def test_a_part_says_that_it_is_out_of_date_and_its_json_is_its_own() -> None:
    stored = Shown(part="verification", result=WORSE, out_of_date="new readings", made_by="cellapp push --verify")
    assert view(stored).parts[-1] == "out of date: new readings; repeat it with 'cellapp push --verify'"
    assert not view(stored).failed
    assert stored.to_json(indent=1) == WORSE.to_json(indent=1)
    assert view(stored.model_copy(update={"complaints": ("old",)})).failed == ("old",)


def test_a_view_says_which_step_failed() -> None:
    shown = RUN.view(WholeRunResult(run="here", verify=WORSE))
    assert (shown.checks, len(shown.failed)) == ("verification", 1)


def test_only_a_push_that_measures_can_fail() -> None:
    for verify in (True, False):
        request = PUSH.asked({"folder": "here", "targets": (), "verify": verify})
        assert bool(PUSH.view(WORSE, request).failed) is verify


def test_targets_are_typed_as_a_file_or_given_by_a_program() -> None:
    parameter = command_of(COMPENSATE).__signature__.parameters["targets"]  # type: ignore[attr-defined]
    assert parameter.annotation.__origin__ is Path
    for given in (Path("targets.yaml"), (1, 2)):
        assert COMPENSATE.asked({"folder": "here", "targets": given}).model_dump()["targets"] == given


def test_a_job_is_called_as_its_request_says() -> None:
    names = [job_of(PUSH, folder="here", targets=(), verify=verify).name for verify in (True, False)]
    assert names == ["verify", "push"]
    assert job_of(DISCOVER, folder="here", propose=3).name == "propose"
    assert job_of(LOCATE, folder="here").name == "locate"
