"""The method ``gaussian-process``: residuals of the geometry as a Gaussian process of the joints. It names nothing.

The kernel has a length scale for the cosine and the sine of each joint; scikit-learn fits them by marginal likelihood.
"""

from __future__ import annotations

import warnings

import numpy as np

from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.robot.kinematics.transforms import Array

_MOST_ROWS = 400
"""Most readings for fitting the length scales: the cost grows with their cube."""


def on_circles(q: Array) -> Array:
    """Return cosines and sines (n, 2 N) of joint positions (n, N)."""
    return np.concatenate([np.cos(q), np.sin(q)], axis=1)


def gaussian_process(problem: Problem) -> Answer:
    """Predict by geometry and Gaussian process."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    model, residual = problem.geometry_fit.model, problem.geometry_residual
    scale = float(residual.std()) or 1.0
    table = on_circles(problem.learn.q)
    kernel = ConstantKernel(1.0) * RBF(np.full(table.shape[1], 2.0), (0.05, 100.0)) + WhiteKernel(0.5, (1e-4, 10.0))
    process = GaussianProcessRegressor(kernel, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # length scales at their bounds: joints without influence
        process.fit(table[:_MOST_ROWS], residual[:_MOST_ROWS] / scale)
    return Answer(problem.predicted(model) + scale * process.predict(on_circles(problem.held_out.q)))
