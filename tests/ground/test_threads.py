"""Linear algebra keeps to one thread, whichever library does it and whenever it is loaded."""

from __future__ import annotations

import json
import subprocess
import sys

PROGRAM = """
import json, sys
import numpy as np, scipy, threadpoolctl
from cellapp.ground.threads import one_blas_thread
with one_blas_thread():
    scipy.linalg.lapack.dpotrf(np.eye(3))
    print(json.dumps([one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"]))
"""


def test_a_library_that_is_loaded_later_has_one_thread_too() -> None:
    """numpy and scipy bring a BLAS each, and scipy loads its own at the first use."""
    said = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    assert set(json.loads(said.stdout)) == {1}
