"""Readings with gross errors: a broken beam, a wrong SMR, a disturbed arm, swapped rows. They are left out and said.

A reading is taken as grossly wrong where what a model leaves of it is longer than ``_MOST`` times a typical length; the
median of the lengths is not moved by a few of them. Noise with heavy tails, or a local error of an arm, stays below.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import identify
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.calibration.weights import MEDIAN_NORM
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import FIRST_SAMPLE
from cellapp.estimation.sockets import measured_positions
from cellapp.ground.counting import counted
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, turned_rows
from cellapp.robot.model import ArmModel

_MOST = 10.0
"""Length over that of one standard deviation of a coordinate. Of Student's t with 4 degrees of freedom one reading in
several thousand is beyond; of a normal distribution none."""
_LEAST_M = 5e-5
"""Lengths below this are no gross errors [m], however small the typical one."""
_LEAST_READINGS = 40
"""Readings from which they are judged: with fewer, some 30 parameters of geometry leave residuals of most readings far
below the noise, and an effect that the model lacks looks like a gross error."""
_LARGEST_SHARE = 0.08
"""Share of readings beyond which long residuals are no gross errors but an effect that acts on some stops only. Five in
a hundred are found in any part of the readings that holds some more of them by chance."""
_PLAINLY_NONE = 4.0
"""Longest residual over the median one up to which a least-squares fit hides no gross error, if it has enough readings:
of a normal distribution one in a million is longer. Measured series of clean readings reach 3.7."""
_ENOUGH_FITTED = 100
"""Readings of that fit from which none of them has the leverage to hide its own error: it would have to determine nine
tenths of its own residual."""
ROUNDS = 3
"""Searches at most: gross errors that a first one hid show in the next."""
_MOST_LISTED = 8
"""Configurations with gross errors that a sentence lists; more are counted."""


def gross_errors(left_M: Array, turned: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Which of the residuals (n, 3) [m] are gross errors; none where there are few.

    Orientations, at the readings ``turned`` (n,), are judged by themselves [rad].
    """
    if turned is not None:
        wrong = np.zeros(len(left_M), dtype=np.bool_)
        for rows in (turned, ~turned):
            wrong[rows] = gross_errors(left_M[rows])
        return wrong
    lengths = np.linalg.norm(left_M, axis=1)
    if len(lengths) < _LEAST_READINGS:
        return np.zeros(len(lengths), dtype=np.bool_)
    wrong = np.asarray(lengths > max(_MOST * float(np.median(lengths)) / MEDIAN_NORM, _LEAST_M))
    return wrong if wrong.mean() <= _LARGEST_SHARE else np.zeros_like(wrong)


def gross_errors_of_geometry(
    start: Geometry, nominal: Geometry, q: Array, p_M: Array, fitted: int = 0, R_M_S: Array | None = None
) -> NDArray[np.bool_]:
    """Which readings (n,) are gross errors for a geometry that gives such readings no weight.

    Parameters
    ----------
    start : Geometry
        Where the identification begins; at ``nominal`` if that fits most readings better.
    nominal : Geometry
        Mean of the priors.
    q : array, shape (n, N) [rad]
    p_M : array, shape (n, 3) [m]
    fitted : int
        Number of readings that ``start`` was fitted to by least squares; 0 if it may not be trusted to show gross
        errors. Clean readings then need no further fit.
    R_M_S : array, shape (n, 3, 3), optional
        Measured orientations, NaN where a position was measured.
    """
    none = np.zeros(len(q), dtype=np.bool_)
    if len(q) < _LEAST_READINGS:
        return none
    turned = turned_rows(R_M_S)

    def lengths(geometry: Geometry) -> list[Array]:
        """Lengths of the residuals of positions, and of orientations."""
        found = np.linalg.norm(p_M - smr_positions(geometry, q, R_M_S), axis=1)
        return [found] if turned is None else [found[~turned], found[turned]]

    if fitted >= _ENOUGH_FITTED:
        clean = (one.max() <= _PLAINLY_NONE * float(np.median(one)) for one in lengths(start))
        if all(clean):
            return none
    # A few wrong readings of a metre can pull a least-squares fit further off than the published geometry is.
    begin = min((start, nominal), key=lambda one: float(np.median(lengths(one)[0])))
    found = identify(begin, q, p_M, R_M_S=R_M_S, prior_mean=nominal, robust="tukey", tolerance=1e-6)
    return gross_errors(p_M - smr_positions(found.geometry, q, R_M_S), turned)


def gross_errors_of_model(model: ArmModel, readings: Readings, conditions: MeasurementConditions) -> NDArray[np.bool_]:
    """Which readings (n,) have a position or an orientation that is a gross error for a model."""
    its = measured_quantities(readings, conditions)
    computed = model.predict(its.readings.q, conditions=its.conditions)
    return its.readings_with(gross_errors(measured_positions(its.readings, computed) - computed, its.turned))


def without(readings: Readings, configurations: Sequence[int]) -> Readings:
    """The readings of one arm without those that were left out at some configurations."""
    if not configurations:
        return readings
    return readings.take(~np.isin(readings.configuration, configurations))


def left_out_words(configurations: Sequence[int]) -> str:
    """Say how many readings were left out, and which: samples of recordings have no number that a person knows."""
    count = len(configurations)
    stops = [one for one in configurations if one < FIRST_SAMPLE]
    named = ", ".join(map(str, stops[:_MOST_LISTED])) + (", ..." if len(stops) > _MOST_LISTED else "")
    places = [f"configuration{'s' if len(stops) > 1 else ''} {named}"] if stops else []
    places += [f"{counted(count - len(stops), 'sample')} of recordings"] if count > len(stops) else []
    what = "1 reading with a gross error was" if count == 1 else f"{count} readings with gross errors were"
    return f"{what} left out ({', '.join(places)})"
