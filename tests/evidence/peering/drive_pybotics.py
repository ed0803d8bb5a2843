"""Identify one case with pybotics: ``python drive_pybotics.py norm|xyz CASE_FOLDER ANSWER_FILE``.

``norm`` is its own residual, the distance of each point; ``xyz`` are the three coordinates, which a user writes with
its robot model. Both use scipy's trust region, millimetres as in its tables of robots, and its 33 parameters: 24 of the
rows, the SMR, the base.
"""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

MM = 1e3
residual, folder, answer = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
nominal, readings = json.loads((folder / "nominal.json").read_text()), np.load(folder / "readings.npz")
base, tool = np.array(nominal["T_M_B"]), np.eye(4)
base[:3, 3] *= MM
tool[:3, 3] = np.array(nominal["tool"]) * MM
robot = Robot.from_parameters(np.array(nominal["rows"]) * [1.0, MM, 1.0, MM])  # alpha, a, theta, d
robot.tool, robot.world_frame = Tool(tool), base
handler = OptimizationHandler(
    robot=robot, kinematic_chain_mask=True, tool_mask=[True] * 3 + [False] * 3, world_mask=True
)
q, p_M = readings["q"], readings["p_M"] * MM


def coordinates(vector):
    """Measured minus computed coordinates (3 n,) [mm]."""
    handler.apply_optimization_vector(vector)
    return (p_M - np.array([handler.robot.fk(one)[:3, 3] for one in q])).ravel()


x0 = handler.generate_optimization_vector()
began = time.perf_counter()
if residual == "norm":
    found = least_squares(optimize_accuracy, x0, args=(handler, q, p_M))
else:
    found = least_squares(coordinates, x0)
seconds = time.perf_counter() - began
handler.apply_optimization_vector(found.x)
p_test_M = np.array([handler.robot.fk(one)[:3, 3] for one in readings["q_test"]]) / MM
answer.write_text(
    json.dumps(
        {
            "version": version("pybotics"),
            "seconds": seconds,
            "p_M": p_test_M.tolist(),
            "parameters": len(x0),
            "said": found.message,
        }
    )
)
