"""Identify one case with figaroh: ``python drive_figaroh.py CASE_FOLDER ANSWER_FILE``.

Its structural method: all six numbers of each joint's frame, less those that a QR decomposition finds redundant. Base
and tool frame are unknown, which its dictionary must say, though its configuration file cannot. The residual is the
difference of the positions, faster than the one of its examples; the frames start from its own estimate.
"""

import contextlib
import csv
import io
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yaml
from figaroh.calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.robot import Robot

folder, answer = Path(sys.argv[1]), Path(sys.argv[2])
readings = np.load(folder / "readings.npz")
configuration, measured = folder / "figaroh.yaml", folder / "figaroh.csv"
with measured.open("w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["x1", "y1", "z1", *(f"joint{i}" for i in range(1, 7))])
    table.writerows(np.hstack([readings["p_M"], readings["q"]]).tolist())
task = {
    "kinematics": {"base_frame": "universe", "tool_frame": "smr"},
    "parameters": {"calibration_level": "full_params"},
    "measurements": {"markers": [{"measurable_dof": [True] * 3 + [False] * 3}]},
    "data": {"source_file": str(measured.resolve()), "number_of_samples": len(readings["q"])},
}
configuration.write_text(
    yaml.safe_dump({"schema_version": "2.0", "robot": {"name": "ur10"}, "tasks": {"calibration": task}})
)


class PositionCalibration(BaseCalibration):
    """Residuals are the differences of the positions, weighted alike."""

    def positions(self, var, q):
        """SMR positions at ``q`` (n, 6), all x first, then all y, then all z, shape (3 n,)."""
        config = {**self.calib_config, "NbSample": len(q)}
        return calc_updated_fkm(self.model, self.data, var, q, config)

    def cost_function(self, var):
        """Computed minus measured coordinates (3 n,) [m]."""
        return self.positions(var, self.q_measured) - self.PEE_measured


with contextlib.redirect_stdout(io.StringIO()):
    calibration = PositionCalibration(Robot(str(folder / "nominal.urdf"), str(folder)), str(configuration))
    calibration.calib_config.update(known_baseframe=False, known_tipframe=False)
    calibration.initialize()
    began = time.perf_counter()
    result, excluded = calibration.solve_optimisation()
    seconds = time.perf_counter() - began
p_M = calibration.positions(result.x, readings["q_test"]).reshape(3, -1).T
said = f"{result.message} {len(excluded)} readings excluded."
answer.write_text(
    json.dumps(
        {
            "version": version("figaroh"),
            "seconds": seconds,
            "p_M": p_M.tolist(),
            "parameters": len(result.x),
            "said": said,
        }
    )
)
