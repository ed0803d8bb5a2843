"""The verbs ``fleet`` and ``compare`` for many runs. They read runs and change none."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from cellapp.commands.fleet.index import indexed_records
from cellapp.commands.fleet.reading import read_record
from cellapp.commands.fleet.request import FleetRequest
from cellapp.commands.record import Work
from cellapp.commands.runs.history import check_folder
from cellapp.estimation.monitoring.fleet.histories import fleet_result
from cellapp.estimation.monitoring.fleet.record import RunRecord
from cellapp.estimation.monitoring.fleet.records import FleetResult
from cellapp.ground.errors import InputError


def run(request: FleetRequest, work: Work) -> FleetResult:
    """Read the runs; write the page on request."""
    result = fleet(request.folders)
    if request.page is not None:
        work.result_page(result, request.page)
    return result


def fleet(folders: Sequence[Path]) -> FleetResult:
    """Return the history of every arm in the runs of some folders and below, each run once, ordered by begin.

    A run that cannot be read is listed with its problem.

    Raises
    ------
    InputError
        If no folder is given, or one is missing or cannot be read.
    """
    if not folders:
        raise InputError("fleet: give at least one folder that holds runs, such as logs")
    for folder in folders:
        check_folder(folder)
    records: dict[Path, RunRecord] = {}
    for folder in folders:
        for record in indexed_records(folder).records:
            records.setdefault(Path(record.run).resolve(), record)
    by_time, notes = _each_once(sorted(records.values(), key=lambda record: (record.began, record.run)))
    if not by_time:
        notes.append(f"no runs below {', '.join(map(str, folders))}; 'cellapp run PROFILE' makes one")
    return fleet_result(by_time, [str(folder) for folder in folders], notes=notes)


def _each_once(records: Sequence[RunRecord]) -> tuple[list[RunRecord], list[str]]:
    """Return the runs without copies of others, and a note on each run that has copies.

    A copy began at the same instant and has the same data of every arm: ten copies of a run are one measurement.
    """
    alike: dict[str, list[RunRecord]] = {}
    for record in records:
        path = json.dumps(record.run, ensure_ascii=False)
        content = record.model_copy(update={"notes": ()}).model_dump_json().replace(path, "")
        alike.setdefault(content if record.began and record.arms else record.run, []).append(record)
    notes = [
        f"{first.run} counts once; copies of it: {', '.join(one.run for one in copies)}"
        for first, *copies in alike.values()
        if copies
    ]
    return [first for first, *_ in alike.values()], notes


def compare_many(folders: Sequence[Path]) -> FleetResult:
    """Compare runs with the first one, in the given order.

    Raises
    ------
    InputError
        If there are fewer than two, one cannot be read, or one is given twice.
    """
    if len(folders) < 2:
        raise InputError("compare: give the folders of at least two runs")
    resolved = [folder.resolve() for folder in folders]
    for place, folder in enumerate(folders):
        if resolved.index(resolved[place]) < place:
            raise InputError(f"compare: {folder} is given twice; give different runs")
    records = [read_record(folder) for folder in folders]
    for record in records:
        if record.problem:
            raise InputError(record.problem)
    result = fleet_result(records, [str(folder) for folder in folders])
    return result.model_copy(update={"notes": (*result.notes, *_not_in_first(result))})


def _not_in_first(result: FleetResult) -> Iterator[str]:
    """Yield notes on arms that the first run lacks: they are compared with another run, or with none."""
    first = result.runs[0].run
    for name, arm in result.arms.items():
        if first not in arm.runs:
            other = f"it is compared with {arm.runs[0]}" if len(arm.runs) > 1 else "it is compared with nothing"
            yield f"arm '{name}' is not in {first}: {other}"
