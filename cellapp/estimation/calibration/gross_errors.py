"""Detection of gross errors: a broken beam, a wrong SMR, a disturbed arm, swapped rows. They are left out and reported.

A reading has a gross error if its residual is longer than ``_MOST`` times a typical length. This is taken from the
median length, which a few gross errors do not move. Noise with heavy tails, or a local error of an arm, stays below.
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
from cellapp.ground.counting import counted
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, turned_rows
from cellapp.robot.model import ArmModel

_MOST = 10.0
"""Length of a gross error, in standard deviations of a coordinate. Of Student's t with 4 degrees of freedom one reading
in several thousand is beyond; of a normal distribution none."""
_LEAST_M = 5e-5
"""Length below which a residual is no gross error [m], however small the typical one."""
_LEAST_READINGS = 40
"""Number of readings from which they are judged: with fewer, some 30 parameters of geometry leave most residuals far
below the noise, and an effect that the model lacks looks like a gross error."""
_LARGEST_SHARE = 0.08
"""Share of readings above which long residuals are no gross errors but an effect that acts on some stops only. With 5 %
of gross errors, parts of the readings may hold some more by chance; these must still be found."""
_PLAINLY_NONE = 4.0
"""Ratio of the longest residual to the median one up to which a least-squares fit of enough readings hides no gross
error: of a normal distribution one in a million is longer. Measured series of clean readings reach 3.7."""
_ENOUGH_FITTED = 100
"""Number of fitted readings from which none has the leverage to hide its own error: it would have to determine nine
tenths of its own residual."""
ROUNDS = 3
"""Maximum number of searches: gross errors that the first ones hid show in the next."""
_MOST_LISTED = 8
"""Number of configurations with gross errors that a sentence lists; more are counted."""


def gross_errors(left_M: Array, turned: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Return a mask (n,) of the residuals (n, 3) [m] that are gross errors; all False if there are few readings.

    Orientations, masked by ``turned`` (n,), are judged separately [rad].
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
    """Return a mask (n,) of the readings that are gross errors by a robust fit, which gives them no weight.

    Parameters
    ----------
    start : Geometry
        Start of the identification; ``nominal`` is used if that fits most readings better.
    nominal : Geometry
        Mean of the priors.
    q : array, shape (n, N) [rad]
    p_M : array, shape (n, 3) [m]
    fitted : int
        Number of readings that ``start`` was fitted to by least squares. If there are enough, clean readings need no
        further fit. 0 if ``start`` may hide gross errors.
    R_M_S : array, shape (n, 3, 3), optional
        Measured orientations, NaN at positions.
    """
    none = np.zeros(len(q), dtype=np.bool_)
    if len(q) < _LEAST_READINGS:
        return none
    turned = turned_rows(R_M_S)

    def lengths(geometry: Geometry) -> list[Array]:
        """Compute the lengths of the residuals of positions, and of orientations."""
        found = np.linalg.norm(p_M - smr_positions(geometry, q, R_M_S), axis=1)
        return [found] if turned is None else [found[~turned], found[turned]]

    if fitted >= _ENOUGH_FITTED:
        clean = (one.max() <= _PLAINLY_NONE * float(np.median(one)) for one in lengths(start))
        if all(clean):
            return none
    # A few readings that are wrong by a metre can pull a least-squares fit further off than the published geometry is.
    begin = min((start, nominal), key=lambda one: float(np.median(lengths(one)[0])))
    found = identify(begin, q, p_M, R_M_S=R_M_S, prior_mean=nominal, robust="tukey", tolerance=1e-6)
    found = found.settled("robust fit that finds gross errors")
    return gross_errors(p_M - smr_positions(found.geometry, q, R_M_S), turned)


def gross_errors_of_model(model: ArmModel, readings: Readings, conditions: MeasurementConditions) -> NDArray[np.bool_]:
    """Return a mask (n,) of the readings whose position or orientation is a gross error by a model."""
    its = measured_quantities(readings, conditions)
    computed = model.predict(its.readings.q, conditions=its.conditions)
    return its.readings_with(gross_errors(its.readings.p_M - computed, its.turned))


def without(readings: Readings, configurations: Sequence[int]) -> Readings:
    """Return the readings of one arm without those at some configurations."""
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
