"""Tables of a run as pandas data frames: readings, residuals, parameters, targets. Needs the extra ``pandas``.

Columns are named as in exported CSV files, with the unit at the end of the name. ``frame.attrs["units"]`` maps each
column with a unit to that unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cellapp.cell.targets.records import MeasuredTarget, TargetCommand
from cellapp.estimation.calibration.quantities import measured_minus_computed
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.shell import shell_word
from cellapp.interfaces.python.api import Run
from cellapp.interfaces.python.frames import parameters_frame, readings_frame, residuals_frame, targets_frame

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["parameters", "readings", "residuals", "targets"]


def readings(run: Run) -> pd.DataFrame:
    """Return the readings, one row per arm and stop, ordered by stop, with the columns of ``cellapp export --csv``.

    Joint positions [rad], SMR position in the tracker frame of the readings [m]. A quantity that was never recorded has
    no column. NaN marks values missing in single readings, or for arms with fewer joints.
    """
    return readings_frame(_measured(run))


def residuals(run: Run) -> pd.DataFrame:
    """Return measured minus computed SMR position of each reading in the tracker frame, with the model in force [mm].

    The conditions are those of the readings; ``residual_mm`` is the length of the vector.
    """
    measured = _measured(run)
    return residuals_frame(measured, measured_minus_computed(run.calibrated_model(), measured))


def parameters(run: Run) -> pd.DataFrame:
    """Return every parameter of every arm's model in force, effects included: nominal, identified, standard error.

    All three are in the ``unit`` of their row. The standard error is NaN for a parameter that was not identified.
    """
    return parameters_frame(run.calibrated_model())


def targets(run: Run) -> pd.DataFrame:
    """Return one row for each target and arm: the target, the command, and the result of measuring it.

    Targets are those of the last ``push --verify``, else of the last ``compensate``. Position [m] and rotation [rad]
    are in the target's ``frame``, ``q`` are the joint positions of the compensated command [rad].

    Raises
    ------
    InputError
        If there are neither.
    """
    results = run.results
    found: Sequence[MeasuredTarget | TargetCommand]
    if results.verify is not None:
        found = results.verify.targets
    elif results.compensate is not None:
        found = results.compensate.targets
    else:
        raise InputError(
            f"{run.folder} has no targets yet: 'cellapp compensate {shell_word(run.folder)} TARGETS' computes some"
        )
    return targets_frame(found)


def _measured(run: Run) -> Mapping[str, Readings]:
    if not run.measured:
        raise InputError(f"{run.folder} holds no readings yet")
    return run.measured
