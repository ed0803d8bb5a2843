"""Identify one case with robotkinecal: ``python drive_robotkinecal.py CASE_FOLDER ANSWER_FILE``.

It knows no base in a tracker frame: points are given in the base frame of the start, and the first joint's axis takes
up what that frame lacks. It has 4 parameters for each joint and 3 of the SMR.
"""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import roboticstoolbox as rtb
from robotkinecal import SerialRobotKineCal

folder, answer = Path(sys.argv[1]), Path(sys.argv[2])
nominal, readings = json.loads((folder / "nominal.json").read_text()), np.load(folder / "readings.npz")
R, p = np.array(nominal["T_M_B"])[:3, :3], np.array(nominal["T_M_B"])[:3, 3]
np.random.seed(0)  # noqa: NPY002 - it draws its basis of twists from numpy's global generator
robot = rtb.Robot.URDF(str((folder / "nominal.urdf").resolve()))
calibration = SerialRobotKineCal(robot, ee_name="smr")
calibration.set_observations(list(readings["q"]), list((readings["p_M"] - p) @ R))
began = time.perf_counter()
result = calibration.solve()
seconds = time.perf_counter() - began
p_B = np.array([calibration.forward_kinematics(calibration.N_JOINTS + 1, q).t for q in readings["q_test"]])
said = f"{result.nb_iterations_executed} iterations, converged {result.has_converged}"
answer.write_text(
    json.dumps(
        {
            "version": version("robotkinecal"),
            "seconds": seconds,
            "p_M": (p_B @ R.T + p).tolist(),
            "parameters": calibration.N_PARAMS,
            "said": said,
        }
    )
)
