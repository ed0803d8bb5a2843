"""The same seed chooses the same stops on any processor: OpenBLAS has kernels for each, which round differently."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNELS = ("Haswell", "Sandybridge", "Nehalem")
"""Any x86 processor of the last ten years runs these; they are compared with its own. Without OpenBLAS, or on another
architecture, the setting has no effect, and all are its own."""

CHOICE = """
import numpy as np
from cellapp.estimation.design.block_design import Candidates, choose_blocks, most_informative_first
from cellapp.estimation.design.block_design import Criterion, reference_errors
rng = np.random.default_rng(0)
rows = np.repeat(rng.normal(size=(150, 3, 20)), 2, axis=0)
rows *= 1.0 + 1e-7 * rng.normal(size=(300, 1, 1))  # each candidate has a rival that tells as much, nearly
candidates = Candidates(rows, np.eye(20))
reference = reference_errors(candidates.mean_information, 40, candidates.prior, 15)
criterion = Criterion(reference, rng.normal(size=(50, 3, 20)))
chosen = choose_blocks(candidates, 40, criterion, rng)
print(most_informative_first(candidates, chosen, criterion).tolist())
"""

PLAN = """
import hashlib
import numpy as np
from cellapp.cell.planning.designed import design_stops
from tests.twin import small_twin
planned = design_stops(small_twin(12), 12).stops
print({name: hashlib.sha256(np.round(q, 9).tobytes()).hexdigest() for name, q in planned.q.items()})
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "kernels"),
    [
        pytest.param(CHOICE, KERNELS, marks=pytest.mark.fast, id="choice"),
        pytest.param(PLAN, ("Sandybridge",), id="plan"),
        pytest.param(PLAN, KERNELS, marks=pytest.mark.long, id="plan, each kernel"),
    ],
)
def test_all_kernels_give_the_same(what: str, kernels: tuple[str, ...]) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    given = {}
    for kernel in ("", *kernels):
        own = {name: value for name, value in environment.items() if name != "OPENBLAS_CORETYPE"}
        of_kernel = {**own, "OPENBLAS_CORETYPE": kernel} if kernel else own
        ended = subprocess.run(
            [sys.executable, "-c", what], env=of_kernel, capture_output=True, text=True, timeout=120.0, check=True
        )
        given[kernel or "its own"] = ended.stdout
    assert all(given.values())
    assert len(set(given.values())) == 1, given
