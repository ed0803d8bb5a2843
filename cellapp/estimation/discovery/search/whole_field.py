"""Judgement of terms beside a field over the workspace, with all waves of the field, also those without columns.

A term for a field has only the slow waves. If the field changes within a few decimetres, the rest of it depends on the
position, and so on the joint angles and the tracker's angles. With all waves the field is a Gaussian process, given by
a covariance of the readings instead of columns,

    y = X b + e,   e ~ N(0, s I + a^2 K_l + Z V Z^T),

where X are the columns without priors (geometry, named laws), Z those of other smooth terms with prior variances V, and
K_l the Matern-5/2 covariance of the shift along each axis. Amplitude, length scale and noise maximise the evidence with
b integrated out (restricted likelihood: Harville, J. Am. Stat. Ass. 72 (1977) 320).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.robot.effects.data_driven import FIELD, position_in_base
from cellapp.robot.effects.field import FIELD_LENGTH
from cellapp.robot.effects.law import AMPLITUDE
from cellapp.robot.effects.unknown import channel_directions
from cellapp.robot.kinematics.transforms import Array

_EVALUATIONS = 30
"""Most evaluations of the evidence: three hyperparameters from a start nearby."""
_SPREAD = 0.4
"""First step in the logarithm of each hyperparameter."""
_IMPOSSIBLE = 1e300


@dataclass(frozen=True, eq=False)
class BesideField:
    """Linear model of a fit with the field as a covariance of the readings.

    Attributes
    ----------
    fit : JointFit
    field : int
        Index of the field among the terms.
    unit : array, shape (3, 3 n)
        Whitened displacement by a unit shift along each axis.
    distance : array, shape (n, n)
        Distances between the SMR positions [m].
    """

    fit: JointFit
    field: int
    unit: Array
    distance: Array

    @classmethod
    def of(cls, data: ArmData, fit: JointFit) -> BesideField | None:
        """Build the model once for a fit and cache it; None if the fit has no field."""
        fields = [number for number, term in enumerate(fit.terms) if term.smooth is not None and term.law.form == FIELD]
        if not fields:
            return None
        if cls not in fit.derived:
            unit = [
                np.einsum("acn,nc->an", fit.white, moved).ravel()
                for moved in channel_directions(data.context, FIELD.channel)
            ]
            position = position_in_base(data.context)
            fit.derived[cls] = cls(fit, fields[0], np.stack(unit), scipy.spatial.distance.cdist(position, position))
        found = fit.derived[cls]
        assert isinstance(found, cls)
        return found

    def gain(self, rows: Array) -> float:
        """Return the gain of the BIC by new rows (m, 3 n) beside model and field, all counted as parameters."""
        return self._left.bic_gain(self._whitened(rows))

    def gain_of(self, number: int) -> float:
        """Return the gain of the score by a term other than the field: by its law, or by evidence if it is smooth."""
        fit, term = self.fit, self.fit.terms[number]
        if term.smooth is not None:
            without = self._log_evidence(self._best(self._values, number), number)
            price = term.smooth.hyperparameters * math.log(len(fit.residual))
            return 2.0 * (self._log_evidence(self._values, None) - without) - price
        rows = fit.law_rows(number)
        target = fit.target + fit.term_values(number)[: len(rows)] @ rows
        return self._behind(number, target).bic_gain(self._whitened(rows))

    @cached_property
    def _left(self) -> ProjectedResidual:
        """The residual in the complement of the whole model, cached as many columns are tried beside it."""
        return self._behind(None, self.fit.target)

    def _behind(self, without: int | None, target: Array) -> ProjectedResidual:
        rows, precision = self._parameters(without)
        return ProjectedResidual(NuisanceProjector.of(self._whitened(rows), precision), self._whitened(target))

    def _whitened(self, rows: Array) -> Array:
        """Whiten rows (..., 3 n) by the covariance of field and noise."""
        return np.asarray(scipy.linalg.solve_triangular(self._root, rows.T, lower=True, check_finite=False).T)

    @cached_property
    def _values(self) -> Array:
        constants = self.fit.terms[self.field].law.constants
        start = np.log([constants[AMPLITUDE.name], constants[FIELD_LENGTH.name], 0.7])
        return self._best(start, None)

    @cached_property
    def _root(self) -> Array:
        """Lower Cholesky factor of ``s I + a^2 K``."""
        factor = self._factor(self._values, np.zeros((0, self.unit.shape[1])), np.zeros(0))
        assert factor is not None
        return factor

    def _parameters(self, without: int | None) -> tuple[Array, Array]:
        """Return the rows and prior precisions of all parameters except those of the field and of term ``without``."""
        kept = self.fit.layout.all_but(self.field)
        if without is not None:
            kept &= self.fit.layout.all_but(without)
        return self.fit.rows[kept], self.fit.precision[kept]

    def _factor(self, values: Array, smooth: Array, variance: Array) -> Array | None:
        amplitude, length, noise = np.exp(values)
        r = math.sqrt(5.0) / length * self.distance
        kernel = amplitude**2 * (1.0 + r + r**2 / 3.0) * np.exp(-r)
        covariance = (self.unit.T @ self.unit) * np.tile(kernel, (3, 3))
        covariance += (smooth.T * variance) @ smooth
        covariance.flat[:: len(covariance) + 1] += noise
        factor, failed = scipy.linalg.lapack.dpotrf(covariance, lower=1, overwrite_a=1)
        return None if failed else np.asarray(factor)

    def _log_evidence(self, values: Array, without: int | None) -> float:
        rows, precision = self._parameters(without)
        smooth = precision > 0.0
        smooth[: self.fit.layout.geometric] = False
        factor = self._factor(values, rows[smooth], 1.0 / precision[smooth])
        if factor is None:
            return -_IMPOSSIBLE
        both = np.concatenate([rows[~smooth], self.fit.target[None]])
        white = scipy.linalg.solve_triangular(factor, both.T, lower=True, check_finite=False).T
        gram = white[:-1] @ white[:-1].T
        left = NuisanceProjector.of(white[:-1], precision[~smooth], gram).project(white[-1])
        scale = np.linalg.norm(rows[~smooth], axis=1)
        gram = (gram + np.diag(precision[~smooth])) / scale / scale[:, None]
        log_determinant = 2.0 * float(np.log(factor.diagonal()).sum()) + float(np.linalg.slogdet(gram)[1])
        return -0.5 * (log_determinant + float(white[-1] @ left))

    def _best(self, start: Array, without: int | None) -> Array:
        """Maximise the evidence near ``start``; return the logarithms of amplitude, length scale and noise."""
        simplex = np.concatenate([start[None], start + _SPREAD * np.eye(len(start))])
        found = scipy.optimize.minimize(
            lambda values: -self._log_evidence(values, without),
            start,
            method="Nelder-Mead",
            options={"maxfev": _EVALUATIONS, "initial_simplex": simplex},
        )
        return np.asarray(found.x)
