"""One simulated run, calibrated and with its effects found, for all tests of this room."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from cellapp.calibration.calibrate import CALIBRATION_FILE, calibrate_run
from cellapp.collection.collect import collect_run
from cellapp.discovery.discover import discover_run
from cellapp.model import CellModel
from cellapp.planning.plan import plan_run
from cellapp.run import RunFile
from tests.twin import small_twin

EFFECTS = {
    "left": {"joint_compliance": {"stiffness": [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]}},
    "right": {"backlash": {"play": [2.0e-4, 2.0e-4, 1.0e-4, 0.0, 0.0, 0.0]}},
}


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunFile]:
    profile = small_twin(120, plant={"effects": EFFECTS})
    splits = profile.splits.model_copy(
        update={"identify": 80, "train": 1, "validate_": 39, "pair_identify": 50, "pair_validate": 30}
    )
    profile = profile.model_copy(update={"splits": splits})
    with RunFile.create(tmp_path_factory.mktemp("compensation") / "run", profile) as made:
        plan_run(made)
        collect_run(made)
        calibrate_run(made)
        discover_run(made)
        yield made


@pytest.fixture(scope="session")
def model(run: RunFile) -> CellModel:
    return CellModel.load(run.folder / CALIBRATION_FILE)
