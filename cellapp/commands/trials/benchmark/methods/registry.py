"""The list of methods: a new one is one file and one line here, or a plug-in.

A method is imported only when it answers, so that ``doctor`` can list plug-ins without loading the search for effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, cast

from drivers.plugins import Registry

if TYPE_CHECKING:
    from cellapp.commands.trials.benchmark.problem import Answer, Method, Problem


def _method(name: str, found: object) -> Method:
    """Check the method of a plug-in. Raises ``ValueError`` if it cannot be called."""
    if not callable(found):
        raise ValueError(f"expected a function of a Problem that returns an Answer, got {found!r}")
    return cast("Method", found)


def _built_in(file: str, function: str) -> Method:
    """Return the method from a file beside this one, imported on its first call."""

    def method(problem: Problem) -> Answer:
        found: Method = getattr(import_module(f"{__package__}.{file}"), function)
        return found(problem)

    return method


_BUILT_IN: Mapping[str, tuple[str, str, str]] = {
    "cellapp": ("search_of_effects", "search_of_effects", ""),
    "geometry": ("geometry", "geometry", ""),
    "forward-bic": ("forward_selection", "forward_bic", ""),
    "ard": ("relevance", "ard", ""),
    "sparse-regression": ("sparse_regression", "sparse_regression", "pysindy"),
    "symbolic-regression": ("symbolic_regression", "symbolic_regression", "gplearn"),
    "gaussian-process": ("gaussian_process", "gaussian_process", "sklearn"),
    "neural-network": ("neural_network", "neural_network", "torch"),
}
"""File and function of each method, and the package that it needs beyond those of cellapp, if any."""
NEEDED: Mapping[str, str] = {name: package for name, (_, _, package) in _BUILT_IN.items() if package}
"""Built-in method -> the package that it needs; ``cellapp[benchmark]`` installs them all."""
METHODS: Registry[Method] = Registry(
    "cellapp.trials.methods",
    "method of the benchmark",
    {name: _built_in(file, function) for name, (file, function, _) in _BUILT_IN.items()},
    _method,
)
