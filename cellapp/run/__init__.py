"""The run file: plan, readings, log and results of one run in one SQLite file; readings to and from CSV."""

from cellapp.run.collection_rows import Outcome, ReferenceRow, Session, SessionEnd
from cellapp.run.columns import SPLITS
from cellapp.run.csv_export import write_readings_csv
from cellapp.run.csv_import import import_csv, read_readings_csv
from cellapp.run.file import RunFile
from cellapp.run.readings import Reading, Readings, joined, stated_uncertainty
from cellapp.run.rows import Event

__all__ = [
    "SPLITS",
    "Event",
    "Outcome",
    "Reading",
    "Readings",
    "ReferenceRow",
    "RunFile",
    "Session",
    "SessionEnd",
    "import_csv",
    "joined",
    "read_readings_csv",
    "stated_uncertainty",
    "write_readings_csv",
]
