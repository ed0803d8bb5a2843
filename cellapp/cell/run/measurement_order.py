"""Order of measurement of imported readings, and each joint's last motion before a stop, which follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.records import ArmOrder
from cellapp.estimation.readings.readings import Readings

MOVED_RAD = 1e-4
"""Steps up to this are encoder noise and rounding: the joint does not move. Joints at rest were seen to read 0.04 mrad
more or less from one stop to the next."""
IN_ORDER_RESULT = "in-order"
"""Name of the document in which a run keeps what an import derived; it is part of the file format."""
_DOCUMENT = TypeAdapter(dict[str, ArmOrder])
_ORDER_WORDS = {"rows": "the rows", "sequence": "the column sequence", "time": "the column time_s"}


def order_fault(readings: Readings) -> tuple[int, str, str] | None:
    """Return row, column and text of the first contradiction about the order of measurement; None if there is none.

    Times must be given for all readings or for none; a given ``sequence`` must agree with them.
    """
    timed = np.isfinite(readings.time_s)
    if timed.any() and not timed.all():
        row = int(np.argmin(timed))
        return row, "time_s", "the value is missing; an import in order needs the times of all rows of an arm, or none"
    if readings.sequence is None or not timed.all():
        return None
    order = np.argsort(readings.sequence, kind="stable")
    earlier = np.flatnonzero(np.diff(readings.time_s[order]) < 0.0)
    if not len(earlier):
        return None
    row = int(order[earlier[0] + 1])
    return row, "sequence", "this row is earlier in time_s than the one before it in sequence; correct one of the two"


def in_measured_order(readings: Readings) -> tuple[Readings, ArmOrder]:
    """Derive the order of measurement of one arm, and approach and step from the row before.

    The order is that of ``sequence`` if given, else of time (equal times: of the rows), else of the rows. Given values
    are kept. A joint that does not move has the step 0 and keeps the sign of its previous motion. Before the first row
    nothing is known: approach 0, step NaN. The step is also NaN where a given approach contradicts the motion from
    the row before: the arm then made a detour.

    Parameters
    ----------
    readings : Readings
        In the order of the rows of the file, without an ``order_fault``.
    """
    by, order = _order(readings)
    back = np.argsort(order)
    given_sign = readings.approach[order].astype(np.float64)
    given_step = np.full_like(readings.q, np.nan) if readings.step is None else readings.step[order]
    motion = np.vstack([np.full((1, readings.joints), np.nan), np.diff(readings.q[order], axis=0)])
    motion = np.where(np.isnan(given_step), motion, given_step)
    motion[np.abs(motion) <= MOVED_RAD] = 0.0
    motion = motion[_first_of_stop(readings.configuration[order])]
    sign = np.nan_to_num(np.sign(motion))
    detour = (given_sign * sign < 0.0) & np.isnan(given_step)
    motion[detour] = np.nan
    approach = _last_known(np.where(given_sign != 0.0, given_sign, sign))
    step = np.where(np.isnan(given_step), motion, given_step)
    derived = ArmOrder(
        by=by,
        approach=int(np.count_nonzero((given_sign == 0.0) & (approach != 0.0))),
        step=int(np.count_nonzero(np.isnan(given_step) & ~np.isnan(step))),
        contradicted=int(np.count_nonzero(detour)),
    )
    ordered = replace(
        readings,
        sequence=back.astype(np.float64) if readings.sequence is None else readings.sequence,
        approach=approach[back].astype(np.int8),
        step=None if np.isnan(step).all() else step[back],
    )
    return ordered, derived


def write_in_order(run: RunFile, orders: Mapping[str, ArmOrder]) -> None:
    """Store what an import derived from the order of the rows, by arm."""
    run.write_document(IN_ORDER_RESULT, _DOCUMENT.dump_json(dict(orders)).decode())


def read_in_order(run: RunFile) -> dict[str, ArmOrder]:
    """Read what the import of this run derived from the order of the rows, by arm; empty if nothing.

    Raises
    ------
    InputError
        If the document is not one that ``write_in_order`` writes.
    """
    return run.read_checked(IN_ORDER_RESULT, _DOCUMENT, {}, "import the file again")


def order_sentences(orders: Mapping[str, ArmOrder]) -> list[str]:
    """Say what was derived from the order of the rows, in one sentence for each arm."""
    said = []
    for name, order in orders.items():
        sentence = (
            f"arm {name}: measured in the order of {_ORDER_WORDS[order.by]}; {order.approach} approach signs and"
            f" {order.step} steps of joints derived from the reading before"
        )
        if order.contradicted:
            sentence += (
                f"; {order.contradicted} given approach signs contradict the motion from there (detours, or another"
                " convention of signs): those steps stay unknown"
            )
        said.append(sentence)
    return said


def _order(readings: Readings) -> tuple[Literal["rows", "sequence", "time"], NDArray[np.intp]]:
    if readings.sequence is not None:
        return "sequence", np.argsort(readings.sequence, kind="stable")
    if len(readings) and np.isfinite(readings.time_s).all():
        return "time", np.argsort(readings.time_s, kind="stable")
    return "rows", np.arange(len(readings), dtype=np.intp)


def _last_known(signs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replace each 0 in signs (n, N), in order of measurement, by the last nonzero one before it."""
    rows = np.where(signs != 0.0, np.arange(len(signs))[:, np.newaxis], 0)
    return np.asarray(np.take_along_axis(signs, np.maximum.accumulate(rows, axis=0), axis=0))


def _first_of_stop(configuration: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the first row of each row's stop, when the arm arrived: SMRs are measured one by one at rest."""
    first = np.ones(len(configuration), dtype=np.bool_)
    first[1:] = np.diff(configuration) != 0
    return np.asarray(np.maximum.accumulate(np.where(first, np.arange(len(first)), 0)))
