"""Results of a test of other arms of the same types, for exchangeability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.commands.run_results import read_stage_results
from cellapp.estimation.iso9283.exchange import exchanged
from cellapp.estimation.iso9283.records import ArmIso9283, IsoCube
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile


@dataclass(frozen=True)
class OtherTest:
    """Measurements of another run, by arm."""

    folder: str
    arms: Mapping[str, ArmIso9283]

    @property
    def cubes(self) -> dict[str, IsoCube]:
        """Cubes of its arms."""
        return {name: arm.cube for name, arm in self.arms.items() if arm.cube is not None}

    def compared(self, arms: Mapping[str, ArmIso9283]) -> dict[str, ArmIso9283]:
        """Add the exchangeability of arms, if both tests measured the same poses with nominal commands."""
        return {name: self._compared(name, arm) for name, arm in arms.items()}

    def _compared(self, name: str, arm: ArmIso9283) -> ArmIso9283:
        other = self.arms.get(name)
        if other is None or "nominal" not in arm.tests or "nominal" not in other.tests:
            return arm
        found = exchanged(arm.tests["nominal"].pose, other.tests["nominal"].pose, self.folder)
        return arm.model_copy(update={"exchange": found})


def other_test(folder: Path | None, profile: Profile, arms: tuple[str, ...]) -> OtherTest | None:
    """Read the newest test in another run; None if no folder is given.

    Raises ``InputError`` if the run has none, or its arms are of other types.
    """
    if folder is None:
        return None
    with RunFile.open(folder) as run:
        result, theirs = read_stage_results(run).iso9283, run.profile
    if result is None:
        raise InputError(f"--with-run: {folder} holds no test by ISO 9283; make one there first")
    usable = {}
    for name in arms:
        arm = result.arms.get(name)
        if arm is None or "nominal" not in arm.tests or not arm.tests["nominal"].pose:
            continue
        if theirs.arms[name].type != profile.arms[name].type:
            raise InputError(
                f"--with-run: arm {name} of {folder} is of another type: only arms of one are exchangeable"
            )
        usable[name] = arm
    if not usable:
        raise InputError(
            f"--with-run: {folder} has no pose test with nominal commands of {', '.join(arms)}: nothing to compare with"
        )
    return OtherTest(str(folder), usable)
