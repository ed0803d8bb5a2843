"""Blind trials: runs of simulated cells with hidden effects; the ground truth is in a sealed file, opened last.

A folder of trials holds ``run-0001``, ``run-0002`` ..., each like an imported run, ``truth.json``, and ``seal.txt``
with its SHA-256 in the format of ``sha256sum -c``. A run has no section ``plant`` and not the seed of its truth, and
the runs are in random order: only ``truth.json`` states what is hidden in which arm.
"""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import JsonValue

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.run import RunFile
from cellapp.commands.trials.blind import DURATION_S, beyond_geometry, blind_readings, with_hidden
from cellapp.commands.trials.sealed_setup import EXPECTED, HARD, OUT, USUAL_SETUP, Case, Setup, cases, library_name
from cellapp.estimation.calibration.calibrate import rms_length_mm
from cellapp.estimation.readings import Readings, stated_uncertainty
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.profile import Profile, Sensors
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import Record, Result
from cellapp.ground.version import __version__
from cellapp.robot.kinematics.transforms import Array, rms_length
from drivers.no_driver import NoDriver
from drivers.plant import suggest, suggest_other_law

TRUTH_FILE = "truth.json"
SEAL_FILE = "seal.txt"

_TRIALS_A_PLAN = 25
"""Runs that share a plan: planning takes longer than measuring a simulated run."""


class HiddenLaw(Record):
    """One hidden effect: its name in the library and in the plant, its parameters, and how far it moves the SMR.

    ``raw_um`` is the rms displacement over the run's stops [µm], ``visible_um`` what remains of it after the part that
    the geometric parameters can follow.
    """

    effect: str
    plant: str
    parameters: Mapping[str, JsonValue]
    raw_um: float
    visible_um: float

    @property
    def law(self) -> str:
        """The word by which the plant selects the law; empty for the default one."""
        return str(self.parameters.get("law") or self.parameters.get("mode") or "")


class DescribedTerm(Record):
    """Channel and variables of a data-driven term, and the sentence that describes it."""

    channel: str
    variables: tuple[str, ...]
    sentence: str = ""


class GroundTruth(Record):
    """What is true of one sealed run.

    Attributes
    ----------
    arm : str
        The arm with the effects; empty where nothing is hidden.
    noise_um, held_out_um : mapping
        Arm -> rms length [µm] of the stated noise, and of the error that was really sampled at the stops of its
        validate split.
    expected : DescribedTerm or None
        For a law that the library lacks.
    readings : str
        SHA-256 of what was measured, see ``digest_of``.
    """

    run: str
    kind: str
    look_alikes: bool
    arm: str
    effects: tuple[HiddenLaw, ...]
    expected: DescribedTerm | None
    noise_um: Mapping[str, float]
    held_out_um: Mapping[str, float]
    seeds: Mapping[str, int]
    readings: str


class SealHeader(Record):
    """How and when the trials were sealed."""

    written: str
    program: str
    profile: str
    seed: int
    setup: Setup
    runs: int
    stops: int


class TruthFile(Result, schema="cellapp-trials-truth"):
    """The content of ``truth.json``."""

    sealed: SealHeader
    trials: tuple[GroundTruth, ...]


class SealResult(Result, schema="cellapp-trials-seal"):
    """``trials seal``: number of runs, their folder, and the SHA-256 of the truth."""

    runs: int
    folder: str
    sha256: str


def seal_trials(
    profile: Profile,
    folder: Path,
    n: int = 200,
    setup: Setup = USUAL_SETUP,
    *,
    seed: int | None = None,
    job: JobToken = UNATTENDED,
) -> SealResult:
    """Write ``n`` sealed runs into a new folder, under the conditions of ``setup``.

    Without ``seed`` a seed is sampled; only ``truth.json`` states it.

    Raises
    ------
    InputError
        If the profile has no simulated cell of two arms, a word is unknown, or the folder is not empty.
    Cancelled
        On request; nothing is left behind then.
    """
    setup.check()
    if profile.plant is None or len(profile.arms) != 2:
        raise InputError(f"profile {profile.name}: sealed trials need a section 'plant' and two arms")
    seed = secrets.randbits(31) if seed is None else seed
    profile = setup.cell(profile)
    build_plant(profile)  # report an error in the cell before making a folder
    made = _new_folder(folder)
    try:
        hidden = cases(tuple(profile.arms), setup.kind, n, seed)
        truths: list[GroundTruth] = []
        for first in range(0, len(hidden), _TRIALS_A_PLAN):
            job.tell("seal", first, n, f"run {first + 1}")
            plan = _Plan.of(profile, setup, seed, first, job)
            for number, case in enumerate(hidden[first : first + _TRIALS_A_PLAN], first + 1):
                job.check()
                job.tell("seal", number - 1, n, f"run {number}")
                truths.append(_write_run(profile, folder / f"run-{number:04d}", number, case, plan, seed, setup))
        job.tell("seal", n, n, "done")
        header = SealHeader(
            written=datetime.now(UTC).isoformat(timespec="seconds"),
            program=f"cellapp {__version__}",
            profile=profile.name,
            seed=seed,
            setup=setup,
            runs=n,
            stops=profile.plan.stops,
        )
        data = (TruthFile(sealed=header, trials=tuple(truths)).to_json(indent=1) + "\n").encode()
        digest = hashlib.sha256(data).hexdigest()
        (folder / TRUTH_FILE).write_bytes(data)
        (folder / SEAL_FILE).write_text(f"{digest}  {TRUTH_FILE}\n", encoding="utf-8")
    except BaseException:  # also on Ctrl-C: an incomplete set of trials has no truth
        _take_back(folder, made)
        raise
    return SealResult(runs=n, folder=str(folder), sha256=digest)


def check_seal(folder: Path) -> bytes:
    """Return the bytes of ``truth.json``, without parsing them, if they match the seal.

    Raises
    ------
    InputError
        If the folder holds no sealed trials.
    CheckFailed
        If truth and seal do not match.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: folder not found; 'cellapp trials seal PROFILE --out FOLDER' makes one")
    for name in (TRUTH_FILE, SEAL_FILE):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder} holds no sealed trials ({name} is missing); give a folder that"
                " 'cellapp trials seal PROFILE --out FOLDER' made"
            )
    try:
        data = (folder / TRUTH_FILE).read_bytes()
        seal = (folder / SEAL_FILE).read_bytes().split()
    except OSError as error:
        raise InputError(f"{folder}: {error.filename} cannot be read ({error.strerror})") from None
    found = hashlib.sha256(data).hexdigest()
    if not seal or seal[0] != found.encode():
        stated = seal[0].decode("ascii", "replace")[:64] if seal else "nothing"
        raise CheckFailed(
            f"{folder / TRUTH_FILE}: the seal is broken: its SHA-256 is {found}, {SEAL_FILE} says {stated};"
            " these trials prove nothing, seal new ones"
        )
    return data


def open_truth(folder: Path) -> TruthFile:
    """Check the seal and read the truth. Raises as ``check_seal``, and ``InputError`` for a file of another version."""
    return TruthFile.from_json(check_seal(folder).decode("utf-8", "replace"), str(folder / TRUTH_FILE))


def check_readings(folder: Path, truth: GroundTruth) -> None:
    """Raise an error if a run of a folder is not as it was sealed.

    Raises
    ------
    InputError
        If the run is missing.
    CheckFailed
        If its readings were changed.
    """
    path = folder / truth.run
    if not path.is_dir():
        raise InputError(f"{path} is missing, but was sealed; put it back, or seal new trials")
    with RunFile.open(path) as run:
        digest = digest_of(run)
    if digest != truth.readings:
        raise CheckFailed(f"{path}: its readings are not those that were sealed; seal new trials")


def digest_of(run: RunFile) -> str:
    """Return the SHA-256 of the joint positions and points of all arms, sorted by name."""
    found = hashlib.sha256()
    for name in sorted(run.arms()):
        readings = run.readings(name)
        found.update(name.encode())
        found.update(np.ascontiguousarray(readings.q).tobytes())
        found.update(np.ascontiguousarray(readings.p_M).tobytes())
    return found.hexdigest()


def without_truth(profile: Profile, number: int) -> Profile:
    """Return the profile of a sealed run: no section ``plant``, no device, the run's number as seed."""
    arms = {name: arm.model_copy(update={"driver": NoDriver()}) for name, arm in profile.arms.items()}
    return profile.model_copy(
        update={
            "name": f"sealed-{number:04d}",
            "seed": number,
            "arms": arms,
            "tracker": profile.tracker.model_copy(update={"driver": NoDriver()}),
            "sensors": Sensors(),
            "network": profile.network.model_copy(update={"kind": "none"}),
            "plant": None,
            "targets": None,
        }
    )


# -- inside -----------------------------------------------------------------------------------------------------------

_Effects = Mapping[str, Mapping[str, Any]]
"""Effect of the plant -> its parameters."""


@dataclass(frozen=True, eq=False)
class _Plan:
    """Stops shared by some runs, and their seed."""

    stops: Mapping[str, Array] | PlannedStops
    seed: int

    @classmethod
    def of(cls, profile: Profile, setup: Setup, seed: int, place: int, job: JobToken) -> _Plan:
        own = int(np.random.default_rng([seed, 0x91A2, place]).integers(2**31))
        return cls(setup.plan(profile, own, job), own)


@dataclass(frozen=True, eq=False)
class _HiddenCell:
    """The simulated cell of one run, with effects in one arm; ``plan`` and ``noise_seed`` are as in ``blind_readings``.

    ``plant_seed`` samples the true geometry, ``split_seed`` the splits.
    """

    profile: Profile
    arm: str
    plan: Mapping[str, Array] | PlannedStops
    plant_seed: int
    noise_seed: int
    split_seed: int

    def measured(self, effects: _Effects) -> dict[str, Readings]:
        """Simulate readings with noise."""
        return blind_readings(self.cell(effects, noise=True), self.plan, self.noise_seed)

    def exact(self, effects: _Effects) -> dict[str, Readings]:
        """Simulate readings at the same stops without noise."""
        return blind_readings(self.cell(effects, noise=False), self.plan, self.noise_seed)

    def cell(self, effects: _Effects, *, noise: bool) -> Profile:
        """Return the simulated cell with these effects."""
        hidden = with_hidden(self.profile, {self.arm: effects} if effects else {}, self.plant_seed)
        assert hidden.plant is not None
        settings = hidden.plant.model_copy(update={"noise": noise})
        return hidden.model_copy(update={"plant": settings, "seed": self.split_seed})


def _write_run(
    profile: Profile, folder: Path, number: int, case: Case, plan: _Plan, seed: int, setup: Setup
) -> GroundTruth:
    """Write one run; return its ground truth."""
    rng = np.random.default_rng([seed, 0x5EA1, number])
    plant_seed, noise_seed = (int(value) for value in rng.integers(2**31, size=2))
    parameters = _sampled_parameters(profile, case, setup, rng)
    public = without_truth(profile, number)
    cell = _HiddenCell(profile, case.arm, plan.stops, plant_seed, noise_seed, public.seed)
    readings, with_all = cell.measured(parameters), cell.exact(parameters)

    def fill(run: RunFile) -> None:
        for name, arm in readings.items():
            run.add_readings(name, setup.reported(arm))

    with RunFile.create(folder, public, fill) as run:
        measured = digest_of(run)
    held_out = {name: arm.in_split("validate") for name, arm in readings.items()}
    expected = EXPECTED.get(case.slugs[0]) if case.kind == OUT else None
    return GroundTruth(
        run=folder.name,
        kind=case.kind,
        look_alikes=case.confounded,
        arm=case.arm,
        effects=_hidden_laws(cell, parameters, with_all),
        expected=None if expected is None else DescribedTerm(channel=expected[0], variables=expected[1]),
        noise_um={name: _stated_um(arm) for name, arm in readings.items()},
        held_out_um={name: _rms_um((arm.p_M - with_all[name].p_M)[held_out[name]]) for name, arm in readings.items()},
        seeds={"plan": plan.seed, "plant": plant_seed, "noise": noise_seed},
        readings=measured,
    )


def _sampled_parameters(
    profile: Profile, case: Case, setup: Setup, rng: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """Sample the parameters of every effect of a case for its arm."""
    if not case.slugs:
        return {}
    config = next(arm for arm in build_plant(profile).config.arms if arm.name == case.arm)
    sample = suggest_other_law if (setup.laws == "other" and case.kind != OUT) or case.kind == HARD else suggest
    return {slug: sample(slug, rng, config, DURATION_S) for slug in case.slugs}


def _hidden_laws(cell: _HiddenCell, parameters: _Effects, with_all: Mapping[str, Readings]) -> tuple[HiddenLaw, ...]:
    """Return every hidden effect with its size, from exact readings without it and ``with_all`` effects."""
    found = []
    for slug, law in parameters.items():
        own = cell.exact({other: values for other, values in parameters.items() if other != slug})[cell.arm]
        moved = with_all[cell.arm].p_M - own.p_M
        one = HiddenLaw(
            effect=library_name(slug),
            plant=slug,
            parameters=json.loads(json.dumps(law)),
            raw_um=_rms_um(moved),
            visible_um=_rms_um(beyond_geometry(cell.profile.arms[cell.arm], own.q, own.p_M, moved)),
        )
        found.append(one)
    return tuple(found)


def _rms_um(vectors: Array) -> float:
    """Return the root mean square length [µm] of vectors (n, 3) [m]; NaN if there are none."""
    return rms_length(vectors) * 1e6 if len(vectors) else math.nan


def _stated_um(readings: Readings) -> float:
    stated = stated_uncertainty(readings)
    assert stated is not None, "a plant states the covariance of every reading"
    return rms_length_mm(stated) * 1e3


def _new_folder(folder: Path) -> bool:
    """Make the folder if needed; return whether it was missing. Raises ``InputError`` if it cannot be used."""
    try:
        if folder.is_dir():
            if any(folder.iterdir()):
                raise InputError(f"{folder} is not empty; give a new folder for the trials")
            return False
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}; give another folder for the trials") from None
    return True


def _take_back(folder: Path, made: bool) -> None:
    """Remove what an interrupted sealing has written."""
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    if made:
        folder.rmdir()
