"""Parts of the page that a run may lack: each is read once, and its section and its message are made from it."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.cell.driving.records import CollectionResult
from cellapp.cell.run import RunFile
from cellapp.cell.targets.path_records import PathResult
from cellapp.commands.check.charts import check_charts
from cellapp.commands.check.view import check_sentences, check_tables
from cellapp.commands.collect.state import collection_state
from cellapp.commands.follow.view import stored_paths
from cellapp.commands.iso9283.charts import iso9283_charts
from cellapp.commands.iso9283.view import iso9283_sentences, iso9283_tables
from cellapp.commands.locate.result import LocateResult
from cellapp.commands.report.data import ReportData
from cellapp.ground.results import LOCATE
from cellapp.interfaces.page.plan_section import PlanSection, plan_section
from cellapp.interfaces.page.result_section import ResultSection, result_section
from cellapp.interfaces.page.targets_section import TargetsSection, targets_section


@dataclass(frozen=True)
class PageParts:
    """Each None where the run has no such result, or one that does not hold and is left out for that."""

    targets: TargetsSection | None
    plan: PlanSection | None
    collection: CollectionResult | None
    paths: PathResult | None
    located: LocateResult | None
    iso9283: ResultSection | None
    check: ResultSection | None


def page_parts(run: RunFile, data: ReportData) -> PageParts:
    """Read and draw what the run has."""
    located = data.results.locate
    holds = located is not None and located.moved and LOCATE not in data.out_of_date
    return PageParts(
        targets=targets_section(data),
        plan=plan_section(run),
        collection=collection_state(run),
        paths=stored_paths(data.results),
        located=located if holds else None,
        iso9283=_iso9283(data),
        check=_check(data),
    )


def _iso9283(data: ReportData) -> ResultSection | None:
    """Also of tests that do not hold any more, which the section then says."""
    result = data.results.iso9283
    if result is None:
        return None
    return result_section("iso", iso9283_sentences(result), iso9283_charts(result), iso9283_tables(result))


def _check(data: ReportData) -> ResultSection | None:
    """Only of a check that holds: one of another model says nothing."""
    result = data.results.held_check
    if result is None:
        return None
    return result_section("check", check_sentences(result), check_charts(result), check_tables(result))
