"""Cells, readings and targets for runs of the report tests, and ways to store results that the product did not make."""

from __future__ import annotations

import numpy as np

from cellapp.cell.run import RunFile
from cellapp.cell.targets.targets import Target, load_targets
from cellapp.commands.stages import append_stage, basis_of, read_stages
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import DiscoverySettings, Profile, Splits
from cellapp.ground.results import CALIBRATE, DISCOVER
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model.nominal import nominal_arm
from drivers.no_driver import NoDriver
from tests.arms import STATION, true_geometry
from tests.sure import sure
from tests.twin import PROFILES, altered, whole_twin

LEFT = "<script>alert('left')"
RIGHT = '右"><img src=x onerror=alert(2)> & $x_'
NAME = "<title><style><script onload=alert(1)>"
TARGET = "<b onclick=alert(3)>t</b>"
UNREACHABLE = "far <it>"
EVENT = "<iframe src='http://evil.example'></iframe> &amp; more"
SIGMA_M = 20e-6


# -- profiles and readings --------------------------------------------------------------------------------------------


def twin_of(left: str, right: str, name: str) -> Profile:
    """The simulated cell with other names and few stops."""
    twin = whole_twin()
    names = dict(zip(twin.arms, (left, right)))
    effects = {names[arm]: hidden for arm, hidden in sure(twin.plant).effects.items()}
    return altered(
        twin,
        name=name,
        arms={names[arm]: settings for arm, settings in twin.arms.items()},
        plan={"stops": 60, "method": "random"},
        splits=Splits(identify=30, train=10, validate=20, pair_identify=30, pair_validate=20),
        network={"iterations": 30},
        discovery=DiscoverySettings(null_simulations=20, folds=2, false_alarm=0.05),
        plant={"effects": effects},
    )


def without_devices(*arms: str) -> Profile:
    """Some arms of the twin under other names, without devices and without a network."""
    twin = whole_twin()
    none = NoDriver()
    settings = [arm.model_copy(update={"driver": none}) for arm in twin.arms.values()]
    return altered(
        twin,
        name=NAME,
        arms=dict(zip(arms, settings)),
        tracker={"driver": none},
        splits=Splits(identify=40, train=0, validate=20, pair_identify=40, pair_validate=20),
        network={"kind": "none"},
        discovery=DiscoverySettings(null_simulations=20, folds=2, false_alarm=0.05),
        plant=None,
        targets=None,
    )


def fill(run: RunFile, *, sigma_m: float | None = SIGMA_M) -> None:
    """60 stops of every arm with errors of lengths and angles, and with backlash in joints 1 to 3."""
    rng = np.random.default_rng(5)
    for shift, (name, arm) in enumerate(run.profile.arms.items()):
        station = STATION.copy()
        station[0, 3] += 1.5 * shift
        true = true_geometry(nominal_arm(arm).with_T_M_B(station), rng)
        q = rng.uniform(-2.5, 2.5, (60, 6))
        approach = rng.choice([-1, 1], (60, 6)).astype(np.int8)
        play = np.array([2e-4, 2e-4, 2e-4, 0.0, 0.0, 0.0])
        p_M = smr_positions(true, q - approach * play) + rng.normal(0.0, SIGMA_M, (60, 3))
        run.add_readings(
            name,
            Readings(
                configuration=np.arange(60, dtype=np.int64),
                time_s=np.arange(60.0),
                q=q,
                approach=approach,
                p_M=p_M,
                sigma_m=None if sigma_m is None else np.full(60, sigma_m),
            ),
        )


def targets_of(left: str, right: str) -> tuple[Target, ...]:
    """Two targets of each arm, one of them with a hostile name, and one out of reach."""
    twin = whole_twin()
    listed = {target.name: target for target in load_targets(PROFILES / "targets" / "twin.yaml", twin)}
    return (
        listed["left-01"].model_copy(update={"arm": left, "name": TARGET}),
        listed["left-02"].model_copy(update={"arm": left}),
        listed["left-03"].model_copy(update={"arm": left, "name": UNREACHABLE, "position": (4.0, 4.0, 4.0)}),
        listed["right-01"].model_copy(update={"arm": right}),
        listed["right-02"].model_copy(update={"arm": right}),
    )


# -- results that replace those of the product ------------------------------------------------------------------------


def store_calibration(run: RunFile, result: CalibrateResult) -> None:
    """Append a calibration with the model of the present one."""
    append_stage(run, CALIBRATE, result, basis_of(run), read_stages(run).current[CALIBRATE].model)


def store_discovery(run: RunFile, result: DiscoverResult, model: str | None = None) -> None:
    """Append a discovery that rests on the present calibration; its model is that of the calibration if not given."""
    calibrated = read_stages(run).current[CALIBRATE]
    basis = basis_of(run, {CALIBRATE: calibrated.digest})
    append_stage(run, DISCOVER, result, basis, model or calibrated.model)
