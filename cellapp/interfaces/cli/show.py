"""``show`` and ``schema``: print what is stored. They only read: the run is opened read-only."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.derived import show_view
from cellapp.interfaces.cli.job import Job, open_run, require_none
from cellapp.interfaces.cli.options import JsonOption, RunFolder, Strict
from cellapp.interfaces.cli.plan import state_check

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile
    from cellapp.commands.run_results import RunResults
    from cellapp.estimation.discovery.records import DiscoverResult


class Part(StrEnum):
    """What ``show`` can print of a run."""

    OVERVIEW = "overview"
    CALIBRATION = "calibration"
    PARAMETERS = "parameters"
    DISCOVERY = "discovery"
    PLAN = "plan"
    COLLECTION = "collection"
    LOCATION = "location"
    TARGETS = "targets"
    VERIFICATION = "verification"
    PATHS = "paths"
    ISO9283 = "iso9283"
    CHECK = "check"
    CERTIFICATE = "certificate"
    LOG = "log"
    PROFILE = "profile"
    HISTORY = "history"


_NOTHING = {
    Part.CALIBRATION: "no calibration is",
    Part.PARAMETERS: "no calibration is",
    Part.DISCOVERY: "no discovery is",
    Part.LOCATION: "no station of the tracker is",
    Part.TARGETS: "no compensated targets are",
    Part.VERIFICATION: "no verification is",
    Part.PATHS: "no paths are",
    Part.ISO9283: "no test by ISO 9283 is",
    Part.CHECK: "no check is",
    Part.CERTIFICATE: "no certificate is",
}
"""Subject and verb where a part is missing."""


def show(
    folder: RunFolder,
    part: Annotated[Part, typer.Argument(help="What to print.")] = Part.OVERVIEW,
    level: Annotated[
        str | None, typer.Option("--level", metavar="WORD", help="With log: only lines of this level.")
    ] = None,
    last: Annotated[int | None, typer.Option("--last", metavar="N", min=1, help="With log: the last N lines.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="With plan: run the safety gate over all stops and ways again.")
    ] = False,
    forecast: Annotated[
        bool, typer.Option("--forecast", help="With plan: time, joint ranges, expected errors, effects it can show.")
    ] = False,
    target: Annotated[
        str | None, typer.Option("--target", metavar="NAME", help="With targets: all about one of them.")
    ] = None,
    strict: Strict = False,
    json_file: JsonOption = None,
) -> None:
    """Print what a run holds; nothing is changed, and only --check and --forecast compute anything."""
    from cellapp.commands.out_of_date import complaints_of

    _check_options(part, level is not None or last is not None, check, forecast, target is not None)
    with Job(json_file) as job, open_run(folder) as run:
        match part:
            case Part.OVERVIEW:
                _show_overview(job, run)
            case Part.HISTORY:
                _show_history(job, run)
            case Part.PLAN if check:
                _check_plan(job, run)
            case Part.PLAN if forecast:
                _forecast_plan(job, run)
            case Part.PLAN:
                _show_plan(job, run)
            case Part.COLLECTION:
                _show_collection(job, run)
            case Part.TARGETS if target is not None:
                _show_target(job, run, target)
            case Part.LOG:
                _show_log(job, run, level, last)
            case Part.PROFILE:
                _show_profile(job, run)
            case _:
                _show_result(job, run, part)
        if strict:
            require_none(complaints_of(run), "show")


def _check_options(part: Part, of_log: bool, check: bool, forecast: bool, of_target: bool) -> None:
    """Raise ``InputError`` for an option that belongs to another part than the one that was asked for."""
    if part is not Part.LOG and of_log:
        raise InputError("show: --level and --last belong to 'log'")
    if (check or forecast) and (part is not Part.PLAN or (check and forecast)):
        raise InputError("show: --check and --forecast belong to 'plan'; give one of them")
    if part is not Part.TARGETS and of_target:
        raise InputError("show: --target belongs to 'targets'")


def schema(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One result, as cellapp-calibrate.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the JSON schemas of the results, by the name that their JSON carries under "schema"."""
    import json

    from cellapp.commands.schemas import json_schemas
    from cellapp.commands.trials.results import TRIAL_RESULTS

    schemas = {**json_schemas(), **json_schemas(TRIAL_RESULTS)}
    if name is not None and name not in schemas:
        raise InputError(f"schema: '{name}' is not a result; results are {', '.join(schemas)}")
    text = json.dumps(schemas if name is None else schemas[name], indent=1)
    with Job(json_file) as job:
        if json_file is None:
            job.say(text)
        job.write_json(text)


def _show_overview(job: Job, run: RunFile) -> None:
    from cellapp.commands.show.overview import run_overview
    from cellapp.commands.show.tables import overview_sentences, overview_tables

    state = run_overview(run)
    job.show(overview_tables(state))
    job.say(*overview_sentences(state))
    job.result(state)


def _show_history(job: Job, run: RunFile) -> None:
    from cellapp.commands.show.overview import run_history
    from cellapp.commands.show.tables import history_lines

    history = run_history(run)
    job.say(*history_lines(history))
    job.result(history)


def _show_log(job: Job, run: RunFile, level: str | None, last: int | None) -> None:
    from cellapp.commands.show.overview import run_log
    from cellapp.commands.show.tables import log_lines

    log = run_log(run, level, last)
    job.say(*(log_lines(log) or ["no log lines to show"]))
    job.result(log)


def _show_profile(job: Job, run: RunFile) -> None:
    from cellapp.commands.show.tables import profile_text

    text = profile_text(run.profile)
    job.say(text)
    job.write_json(text)


def _show_plan(job: Job, run: RunFile) -> None:
    from cellapp.commands.plan.design_view import design_sentences, design_tables
    from cellapp.commands.plan.run import stored_plan
    from cellapp.commands.show import tables as run_tables

    stops = stored_plan(run)
    job.show(run_tables.plan_tables(stops))
    if not stops.stops:
        job.say("no stops are planned")
    if stops.design is not None:
        job.show(design_tables(stops.design))
        job.say(*design_sentences(stops.design))
    job.result(stops)


def _check_plan(job: Job, run: RunFile) -> None:
    from cellapp.cell.planning.check import check_plan_run

    state_check(job, check_plan_run(run, job.listen, job.control))


def _forecast_plan(job: Job, run: RunFile) -> None:
    from cellapp.cell.planning.forecast import forecast_run
    from cellapp.commands.plan.view import forecast_sentences, forecast_tables

    result = forecast_run(run, job.listen, job.control)
    job.show(forecast_tables(result))
    job.say(*forecast_sentences(result))
    job.result(result)


def _show_collection(job: Job, run: RunFile) -> None:
    from cellapp.commands.collect.view import collection_tables
    from cellapp.interfaces.page.collection_section import collection_state

    state = collection_state(run)
    if state is None:
        raise InputError(
            f"{run.path}: no session of collecting is recorded; an import or an older version made this run"
        )
    job.show(collection_tables(state))
    job.result(state)


def _show_target(job: Job, run: RunFile, name: str) -> None:
    """Print all that the last results say about one target; the JSON is that of ``compensate``, with it alone."""
    from cellapp.commands.compensate.details import details_tables, stored_state, target_details
    from cellapp.commands.stages import read_results

    results = read_results(run)
    state = stored_state(results, name)
    if state is None or results.compensate is None:
        raise InputError(
            f"{run.path}: no compensated target '{name}' is stored; 'cellapp show {run.folder} targets' lists them"
        )
    details = target_details(state)
    job.show(details_tables(details))
    job.say(*details.sentences)
    job.result(results.compensate.model_copy(update={"targets": state.commands}))


def _show_result(job: Job, run: RunFile, part: Part) -> None:
    """Print the stored result of one verb, and whether it still holds."""
    from cellapp.commands.stages import read_results

    results = read_results(run)
    name, make, print_result = {
        Part.CALIBRATION: ("calibrate", "cellapp calibrate", _show_calibration),
        Part.PARAMETERS: ("calibrate", "cellapp calibrate", _show_parameters),
        Part.DISCOVERY: ("discover", "cellapp discover", _show_discovery),
        Part.LOCATION: ("locate", "cellapp locate", _show_location),
        Part.TARGETS: ("compensate", "cellapp compensate", _show_targets),
        Part.VERIFICATION: ("verify", "cellapp push --verify", _show_verification),
        Part.PATHS: ("path" if results.follow is None else "follow", "cellapp follow", _show_paths),
        Part.ISO9283: ("iso9283", "cellapp iso9283", _show_iso9283),
        Part.CHECK: ("check", "cellapp check", _show_check),
        Part.CERTIFICATE: ("certificate", "cellapp certificate", _show_certificate),
    }[part]
    reason = {str(key): text for key, text in results.out_of_date.items()}.get(name)
    stored = getattr(results, name)
    if stored is None:
        why = f"{name} is stored, but {reason}" if reason else f"{_NOTHING[part]} stored"
        raise InputError(f"{run.path}: {why}; run '{make}' first")
    print_result(job, results)
    if reason is not None:
        job.say(f"out of date: {reason}; repeat it with '{make}'")
    job.result(stored)


def _show_calibration(job: Job, results: RunResults) -> None:
    from cellapp.commands.calibrate.view import view

    assert results.calibrate is not None
    show_view(job, view(results.calibrate))


def _show_parameters(job: Job, results: RunResults) -> None:
    from cellapp.commands.calibrate.view import parameters_view

    assert results.calibrate is not None
    show_view(job, parameters_view(results.calibrate))


def show_discovery(job: Job, result: DiscoverResult) -> None:
    """Print a discovery."""
    from cellapp.commands.discover.view import view

    show_view(job, view(result))


def _show_discovery(job: Job, results: RunResults) -> None:
    assert results.discover is not None
    show_discovery(job, results.discover)


def _show_location(job: Job, results: RunResults) -> None:
    from cellapp.commands.locate.view import location_sentences, location_tables

    assert results.locate is not None
    job.show(location_tables(results.locate))
    job.say(*location_sentences(results.locate))


def _show_iso9283(job: Job, results: RunResults) -> None:
    from cellapp.commands.iso9283.view import iso9283_sentences, iso9283_tables

    assert results.iso9283 is not None
    job.show(iso9283_tables(results.iso9283))
    job.say(*iso9283_sentences(results.iso9283))


def _show_certificate(job: Job, results: RunResults) -> None:
    from cellapp.commands.certificate.view import certificate_sentences, certificate_tables

    assert results.certificate is not None
    job.show(certificate_tables(results.certificate))
    job.say(*certificate_sentences(results.certificate))


def _show_check(job: Job, results: RunResults) -> None:
    from cellapp.commands.check.view import check_sentences, check_tables

    assert results.check is not None
    job.show(check_tables(results.check))
    job.say(*check_sentences(results.check))


def _show_paths(job: Job, results: RunResults) -> None:
    from cellapp.commands.follow.view import path_sentences, path_tables

    stored = results.path if results.follow is None else results.follow
    assert stored is not None
    job.show(path_tables(stored))
    job.say(*path_sentences(stored))


def _show_targets(job: Job, results: RunResults) -> None:
    from cellapp.commands.compensate.view import view

    assert results.compensate is not None
    show_view(job, view(results.compensate))


def _show_verification(job: Job, results: RunResults) -> None:
    from cellapp.commands.push.view import view

    assert results.verify is not None
    show_view(job, view(results.verify))
