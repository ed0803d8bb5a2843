"""The run file: plan, readings, log and results of one run in one SQLite file; readings to and from CSV."""

from cellapp.cell.run.csv_export import write_readings_csv
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.sqlite_file import Event, Outcome, ReferenceRow, Session, SessionEnd

__all__ = ["Event", "Outcome", "ReferenceRow", "RunFile", "Session", "SessionEnd", "write_readings_csv"]
