"""The list of methods: a new one is one file and one line here, or a plug-in."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import cast

from cellapp.commands.trials.benchmark.methods.forward_selection import forward_bic
from cellapp.commands.trials.benchmark.methods.gaussian_process import gaussian_process
from cellapp.commands.trials.benchmark.methods.geometry import geometry
from cellapp.commands.trials.benchmark.methods.neural_network import neural_network
from cellapp.commands.trials.benchmark.methods.relevance import ard
from cellapp.commands.trials.benchmark.methods.search_of_effects import search_of_effects
from cellapp.commands.trials.benchmark.methods.sparse_regression import sparse_regression
from cellapp.commands.trials.benchmark.methods.symbolic_regression import symbolic_regression
from cellapp.commands.trials.benchmark.problem import Answer, Method, NotTaken, Problem
from cellapp.ground.errors import InputError
from cellapp.ground.threads import one_blas_thread
from drivers.plugins import Registry


def _method(name: str, found: object) -> Method:
    """The method of a plug-in. Raises ``ValueError`` if it cannot be called."""
    if not callable(found):
        raise ValueError(f"expected a function of a Problem that returns an Answer, got {found!r}")
    return cast(Method, found)


_BUILT_IN: Mapping[str, tuple[Method, str]] = {
    "cellapp": (search_of_effects, ""),
    "geometry": (geometry, ""),
    "forward-bic": (forward_bic, ""),
    "ard": (ard, ""),
    "sparse-regression": (sparse_regression, "pysindy"),
    "symbolic-regression": (symbolic_regression, "gplearn"),
    "gaussian-process": (gaussian_process, "sklearn"),
    "neural-network": (neural_network, "torch"),
}
"""Each with the package that it needs beyond those of cellapp, if any."""
NEEDED: Mapping[str, str] = {name: package for name, (_, package) in _BUILT_IN.items() if package}
"""Built-in method -> that package; ``cellapp[benchmark]`` has them all."""
METHODS: Registry[Method] = Registry(
    "cellapp.trials.methods",
    "method of the benchmark",
    {name: method for name, (method, _) in _BUILT_IN.items()},
    _method,
)


def answer_of(method: str, problem: Problem) -> tuple[Answer | None, float]:
    """What a method answers, None if it does not take the problem, and its processor time [s].

    Raises
    ------
    InputError
        If it does not predict a point for each held-out stop.
    """
    of_problem, answer = METHODS[method], None
    began_s = time.process_time()
    try:
        with one_blas_thread():
            answer = of_problem(problem)
    except NotTaken:
        pass
    seconds, expected = time.process_time() - began_s, problem.held_out.p_M.shape
    if answer is not None and answer.p_M.shape != expected:
        raise InputError(f"method {method}: {problem.name}: predicted shape {answer.p_M.shape}, expected {expected}")
    return answer, seconds
