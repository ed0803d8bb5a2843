"""Run files as older programs wrote them."""

import sqlite3

from cellapp.estimation.readings.columns import COLUMNS


def older_reading_table(connection: sqlite3.Connection, version: int) -> None:
    """Make the table of readings one of this schema, before 8: without later columns, and with one reading of an arm a
    stop, which no later one replaces."""
    connection.execute("DROP TABLE earlier_reading")
    connection.execute("ALTER TABLE session DROP COLUMN again")
    connection.execute("DROP INDEX reading_key")
    for column in COLUMNS:
        if column.since > version:
            connection.execute(f"ALTER TABLE reading DROP COLUMN {column.sql_name}")
    connection.execute("CREATE UNIQUE INDEX once ON reading (arm, configuration)")
