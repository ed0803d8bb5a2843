"""A run from Python, as plain objects that do not change. Nothing here moves an arm or writes a file.

    from cellapp.interfaces.python.api import open_run

    run = open_run("logs/my-run")
    p_M = run.predict("left", q)

``dataframes`` beside this has the run's tables as pandas data frames; ``cellapp docs python`` is about both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cellapp.cell.run import RunFile
from cellapp.commands.report.result import RunResults, read_results
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of
from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, apply
from cellapp.robot.model import CellModel
from cellapp.robot.model.arguments import of_arm

__all__ = ["Run", "open_run"]


@dataclass(frozen=True, eq=False)
class Run:
    """What a run held when it was opened.

    Attributes
    ----------
    folder : Path
    profile : Profile
        The cell, as it was when the run began.
    measured : mapping
        Arm -> Readings, of the arms that have some.
    results : RunResults
        What each verb found, None where it has not run; ``results.out_of_date`` says which no longer hold, and why.
    model : CellModel or None
        The model that compensation uses; None before the calibration. Its tracker frame M is that of the tracker where
        it stands now: where it stood during the readings, or where ``cellapp locate`` found it since.
    """

    folder: Path
    profile: Profile
    measured: Mapping[str, Readings]
    results: RunResults
    model: CellModel | None

    def readings(self, arm: str) -> Readings:
        """The readings of one arm. Raises ``InputError`` if no such arm has any."""
        return of_arm(self.measured, arm, "this run")

    def calibrated_model(self) -> CellModel:
        """The model. Raises ``InputError`` if the run is not calibrated."""
        if self.model is None:
            raise InputError(f"{self.folder}: not calibrated yet; run 'cellapp calibrate {self.folder}' first")
        return self.model

    def predict(self, arm: str, q: ArrayLike) -> Array:
        """SMR positions (n, 3) in frame M [m] where the controller of an arm with N joints reads ``q`` (n, N) [rad].

        ``calibrated_model().predict`` also takes approach directions, payloads and other conditions.

        Raises
        ------
        InputError
            If there is no such arm, ``q`` has another shape or seems to be in degrees, or the run is not calibrated.
        """
        return self.calibrated_model().predict(arm, q)

    def residuals(self, arm: str) -> Array:
        """Measured minus computed SMR positions (n, 3) in frame M [m] of all readings of an arm, in their order.

        Each is computed for the conditions of its reading: approach, step, payload, temperatures, the other arm.

        Raises
        ------
        InputError
            If no such arm has readings, or the run is not calibrated.
        """
        readings, model = self.readings(arm), self.calibrated_model()
        conditions = conditions_of_arms(model.arms, self.measured)[arm]
        p_M = readings.p_M if model.T_M_M0 is None else apply(model.T_M_M0, readings.p_M)
        return np.asarray(p_M - model.arms[arm].predict(readings.q, conditions=conditions))


def open_run(folder: Path | str) -> Run:
    """Read a run.

    Raises
    ------
    InputError
        If there is none in ``folder``, or it is damaged.
    """
    with RunFile.open(Path(folder)) as run:
        stages = read_stages(run)
        return Run(
            folder=run.folder,
            profile=run.profile,
            measured={arm: run.readings(arm) for arm in run.arms()},
            results=read_results(run, stages),
            model=None if stages.in_force is None else model_of(run, stages.in_force),
        )
