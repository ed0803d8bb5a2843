"""The run file: plan, readings, events and results of one run in one SQLite file, and its door to CSV."""

from cellapp.run.csv_io import import_csv, read_readings_csv, write_readings_csv
from cellapp.run.file import Event, RunFile
from cellapp.run.readings import SPLITS, Reading, Readings

__all__ = [
    "SPLITS",
    "Event",
    "Reading",
    "Readings",
    "RunFile",
    "import_csv",
    "read_readings_csv",
    "write_readings_csv",
]
