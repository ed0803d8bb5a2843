"""Blind trials: runs of simulated cells with hidden effects, their ground truth in a sealed file that is opened last.

A folder of trials holds ``run-0001``, ``run-0002`` ..., each like an imported run, ``truth.json``, and ``seal.txt``
with the SHA-256 of it in the form that ``sha256sum -c`` takes. A run has no section ``plant`` and no seed that its
truth was drawn from, and the runs are in random order: only ``truth.json`` states what is hidden in which arm.
"""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import JsonValue

from cellapp import __version__
from cellapp.calibration.calibrate import rms_length_mm
from cellapp.calibration.identification import start_from_nominal
from cellapp.calibration.parameters import auto_set
from cellapp.collection.cell import build_plant
from cellapp.errors import CheckFailed, InputError
from cellapp.kinematics.chain import JointAngles, jacobian
from cellapp.kinematics.transforms import Array
from cellapp.model.nominal import nominal_arm
from cellapp.planning.plan import plan_stops
from cellapp.profile import Arm, Profile, Sensors
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Record, Result
from cellapp.run import Readings, RunFile, stated_uncertainty
from cellapp.trials.blind import DURATION_S, Noise, blind_readings, with_hidden
from drivers.no_driver import NoDriver
from drivers.plant import OUTSIDE, REALISTIC, suggest

TRUTH_FILE = "truth.json"
SEAL_FILE = "seal.txt"

NOISES: Mapping[str, Noise] = {
    "gaussian": Noise(),
    "heavy": Noise("heavy"),
    "repeatability": Noise("gaussian", 8e-6),
}
"""How readings scatter: as stated, with heavy tails, or with 8 urad unstated repeatability of each joint."""

PAIRS: tuple[tuple[str, str], ...] = (
    ("joint_compliance", "backlash"),
    ("joint_compliance", "base_drift"),
    ("joint_compliance", "pedestal_coupling"),
    ("encoder_eccentricity", "target_slip"),
    ("backlash", "thermal_growth"),
    ("transmission_error", "base_step"),
    ("transmission_error", "friction_windup"),
    ("joint_compliance", "transmission_error"),
    ("pedestal_coupling", "thermal_growth"),
    ("joint_axis_wobble", "unsettled_measurement"),
    ("link_bending", "backlash"),
    ("encoder_eccentricity", "joint_drift"),
)
"""Ordinary pairs: neither effect imitates the other."""
LOOK_ALIKES: tuple[tuple[str, str], ...] = (
    ("joint_compliance", "link_bending"),
    ("backlash", "unsettled_measurement"),
    ("backlash", "friction_windup"),
    ("joint_compliance", "pedestal_compliance"),
    ("joint_compliance", "encoder_eccentricity"),
    ("base_drift", "thermal_growth"),
    ("encoder_eccentricity", "transmission_error"),
)
"""Pairs of which each imitates a part of the other."""

EXPECTED: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "dress_pack": ("joint 1", ("q1", "q2")),
    "crosstalk": ("joint 4", ("q5",)),
    "base_sway": ("base shift", ("time",)),
    "tool_sag": ("tool", ("q5",)),
    "wrist_cable": ("joint 6", ("q4",)),
    "draught": ("tracker azimuth", ("time",)),
}
"""Channel and variables that a description of each law outside the library must state."""

_IN_THE_LIBRARY = {"tracker_drift": "base_drift"}
"""Laws of the plant that one arm's data cannot distinguish from an effect of the library, and that effect."""
_ONE, _NONE, _OUTSIDE, _PAIR = KINDS = ("one", "none", "outside", "pair")
MIXED = "mixed"
_MIXTURE = (_ONE, _ONE, _NONE, _ONE, _OUTSIDE, _ONE, _ONE, _PAIR, _ONE, _NONE)
_TRIALS_A_PLAN = 25
"""Runs that share a plan: planning takes longer than measuring a simulated run."""
_MASS_SHARE = 0.05
"""Standard deviation of true link masses about the nominal ones: they are never known better."""


class HiddenLaw(Record):
    """One hidden effect: its name in the library and in the plant, its parameters, and how far it moves the SMR.

    ``raw_um`` is the rms displacement over the run's stops [um], ``visible_um`` what remains of it after the part that
    the geometric parameters can follow.
    """

    effect: str
    plant: str
    parameters: Mapping[str, JsonValue]
    raw_um: float
    visible_um: float


class ExpectedTerm(Record):
    """Channel and variables that a description of a law outside the library must state."""

    channel: str
    variables: tuple[str, ...]


class GroundTruth(Record):
    """What is true of one sealed run.

    Attributes
    ----------
    arm : str
        The arm with the effects; empty where nothing is hidden.
    noise_um, held_out_um : mapping
        Arm -> rms length [um] of the stated noise, and of the error that was really drawn at the stops of its validate
        split.
    expected : ExpectedTerm or None
        For a law that the library lacks.
    readings : str
        SHA-256 of what was measured.
    """

    run: str
    kind: str
    look_alikes: bool
    arm: str
    effects: tuple[HiddenLaw, ...]
    expected: ExpectedTerm | None
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
    kind: str
    noise: str
    runs: int
    stops: int


class TruthFile(Result):
    """The content of ``truth.json``."""

    schema_: Literal["cellapp-trials-truth"] = "cellapp-trials-truth"
    version: Literal[1] = 1
    sealed: SealHeader
    trials: tuple[GroundTruth, ...]


class SealResult(Result):
    """``trials seal``: number of runs, their folder, and the SHA-256 of the truth."""

    schema_: Literal["cellapp-trials-seal"] = "cellapp-trials-seal"
    version: Literal[1] = 1
    runs: int
    folder: str
    sha256: str


@dataclass(frozen=True)
class _Design:
    """What one run shall hide."""

    kind: str
    slugs: tuple[str, ...] = ()
    look_alikes: bool = False
    arm: str = ""


def seal_trials(
    profile: Profile,
    folder: Path,
    n: int = 200,
    *,
    seed: int | None = None,
    kind: str = _ONE,
    noise: str = "gaussian",
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> SealResult:
    """Write ``n`` sealed runs into a new folder. Without ``seed`` one is drawn that only ``truth.json`` states.

    ``kind`` is ``one`` (each realistic effect in turn), ``none``, ``outside`` (laws that the library lacks), ``pair``
    or ``mixed``; ``noise`` is one of ``NOISES``.

    Raises
    ------
    InputError
        If the profile has no simulated cell of two arms, a word is unknown, or the folder is not empty.
    Cancelled
        On request; nothing is left behind then.
    """
    cancel = cancel or CancelToken()
    _check_words(kind, noise)
    if profile.plant is None or len(profile.arms) != 2:
        raise InputError(f"profile {profile.name}: sealed trials need a section 'plant' and two arms")
    seed = secrets.randbits(31) if seed is None else seed
    hidden_masses = profile.plant.geometry.model_copy(update={"mass": _MASS_SHARE})
    plant = profile.plant.model_copy(update={"geometry": hidden_masses, "effects": {}})
    profile = profile.model_copy(update={"plant": plant})
    build_plant(profile)  # an error in the cell is reported before a folder is made
    made = _new_folder(folder)
    try:
        truths = _write_runs(profile, folder, _cases(tuple(profile.arms), kind, n, seed), seed, noise, listener, cancel)
        header = SealHeader(
            written=datetime.now(UTC).isoformat(timespec="seconds"),
            program=f"cellapp {__version__}",
            profile=profile.name,
            seed=seed,
            kind=kind,
            noise=noise,
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
    """The bytes of ``truth.json``, unread, if they are those that were sealed.

    Raises
    ------
    InputError
        If the folder holds no sealed trials.
    CheckFailed
        If truth and seal do not belong together.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: folder not found; 'cellapp trials seal' makes one")
    for name in (TRUTH_FILE, SEAL_FILE):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder} holds no sealed trials ({name} is missing); give a folder that 'cellapp trials seal' made"
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
    """Check the seal and open the truth. Raises as ``check_seal``, and ``InputError`` for another version's file."""
    return TruthFile.from_json(check_seal(folder).decode("utf-8", "replace"), str(folder / TRUTH_FILE))


def digest_of(readings: Mapping[str, Readings]) -> str:
    """SHA-256 of the joint positions and points of all arms, in the arms' order by name."""
    found = hashlib.sha256()
    for name in sorted(readings):
        found.update(name.encode())
        found.update(np.ascontiguousarray(readings[name].q).tobytes())
        found.update(np.ascontiguousarray(readings[name].p_M).tobytes())
    return found.hexdigest()


def without_truth(profile: Profile, number: int) -> Profile:
    """The profile of a sealed run: no section ``plant``, no device, the run's number as its seed."""
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


def _check_words(kind: str, noise: str) -> None:
    for name, word, known in (("kind", kind, (*KINDS, MIXED)), ("noise", noise, tuple(NOISES))):
        if word not in known:
            raise InputError(f"--{name}: '{word}' is not known; {name}s are {', '.join(known)}")


def _cases(arms: Sequence[str], kind: str, n: int, seed: int) -> list[_Design]:
    """What each run hides: every law of a kind in turn, in alternating arms; the runs in random order."""
    menus: dict[str, list[tuple[tuple[str, ...], bool]]] = {
        _ONE: [((slug,), False) for slug in REALISTIC],
        _NONE: [((), False)],
        _OUTSIDE: [((slug,), False) for slug in OUTSIDE],
        _PAIR: [*((pair, False) for pair in PAIRS), *((pair, True) for pair in LOOK_ALIKES)],
    }
    counts = dict.fromkeys(KINDS, 0)
    cases = []
    for place in range(n):
        here = _MIXTURE[place % len(_MIXTURE)] if kind == MIXED else kind
        menu, turn = menus[here], counts[here]
        counts[here] += 1
        slugs, look_alikes = menu[turn % len(menu)]
        # with an even number of laws, each would always be hidden in the same arm
        shifted = turn + (turn // len(menu) if len(menu) % 2 == 0 else 0)
        cases.append(_Design(here, slugs, look_alikes, arms[shifted % len(arms)] if slugs else ""))
    order = np.random.default_rng([seed, 0x0DE2]).permutation(n)
    return [cases[place] for place in order]


def _write_runs(
    profile: Profile,
    folder: Path,
    cases: Sequence[_Design],
    seed: int,
    noise: str,
    listener: Listener,
    cancel: CancelToken,
) -> list[GroundTruth]:
    """Write the runs and return their truth."""
    truths: list[GroundTruth] = []
    plan: Mapping[str, Array] = {}
    plan_seed = 0
    for place, case in enumerate(cases):
        cancel.check()
        number = place + 1
        listener(Progress("seal", place, len(cases), f"run {number}"))
        if place % _TRIALS_A_PLAN == 0:
            plan_seed = int(np.random.default_rng([seed, 0x91A2, place]).integers(2**31))
            plan = plan_stops(profile.model_copy(update={"seed": plan_seed}), cancel=cancel)
        truths.append(_write_run(profile, folder / f"run-{number:04d}", number, case, plan, plan_seed, seed, noise))
    listener(Progress("seal", len(cases), len(cases), "done"))
    return truths


def _write_run(
    profile: Profile,
    folder: Path,
    number: int,
    case: _Design,
    plan: Mapping[str, Array],
    plan_seed: int,
    seed: int,
    noise: str,
) -> GroundTruth:
    """Write one run and return its ground truth."""
    rng = np.random.default_rng([seed, 0x5EA1, number])
    plant_seed, noise_seed = (int(value) for value in rng.integers(2**31, size=2))
    parameters: dict[str, dict[str, Any]] = {}
    if case.slugs:
        config = next(arm for arm in build_plant(profile).config.arms if arm.name == case.arm)
        parameters = {slug: suggest(slug, rng, config, DURATION_S) for slug in case.slugs}
    public = without_truth(profile, number)

    def cell(effects: Mapping[str, Mapping[str, Any]], noise_on: bool) -> Profile:
        hidden = with_hidden(profile, {case.arm: effects} if effects else {}, plant_seed)
        assert hidden.plant is not None
        settings = hidden.plant.model_copy(update={"noise": noise_on})
        return hidden.model_copy(update={"plant": settings, "seed": public.seed})  # which draws the splits

    def exact(effects: Mapping[str, Mapping[str, Any]]) -> dict[str, Readings]:
        return blind_readings(cell(effects, False), plan, noise_seed)

    readings = blind_readings(cell(parameters, True), plan, noise_seed, NOISES[noise])
    with_all = exact(parameters)
    effects = []
    for slug in case.slugs:
        without = exact({other: values for other, values in parameters.items() if other != slug})[case.arm]
        moved = with_all[case.arm].p_M - without.p_M
        effects.append(_hidden_law(profile.arms[case.arm], slug, parameters[slug], without, moved))

    def fill(run: RunFile) -> None:
        for name, arm in readings.items():
            run.add_readings(name, arm)

    RunFile.create(folder, public, fill).close()
    held_out = {name: arm.in_split("validate") for name, arm in readings.items()}
    expected = EXPECTED.get(case.slugs[0]) if case.kind == _OUTSIDE else None
    return GroundTruth(
        run=folder.name,
        kind=case.kind,
        look_alikes=case.look_alikes,
        arm=case.arm,
        effects=tuple(effects),
        expected=None if expected is None else ExpectedTerm(channel=expected[0], variables=expected[1]),
        noise_um={name: _stated_um(arm) for name, arm in readings.items()},
        held_out_um={name: _rms_um((arm.p_M - with_all[name].p_M)[held_out[name]]) for name, arm in readings.items()},
        seeds={"plan": plan_seed, "plant": plant_seed, "noise": noise_seed},
        readings=digest_of(readings),
    )


def _hidden_law(arm: Arm, slug: str, parameters: Mapping[str, Any], without: Readings, moved: Array) -> HiddenLaw:
    """One hidden effect; ``without`` are exact readings without it, ``moved`` (n, 3) [m] the displacement by it."""
    return HiddenLaw(
        effect=_IN_THE_LIBRARY.get(slug, slug),
        plant=slug,
        parameters=_plain(parameters),
        raw_um=_rms_um(moved),
        visible_um=_rms_um(beyond_geometry(arm, without.q, without.p_M, moved)),
    )


def beyond_geometry(arm: Arm, q: Array, p_M: Array, moved: Array) -> Array:
    """The part of displacements ``moved`` (n, 3) [m] that the identifiable geometry cannot follow.

    ``q`` (n, N) [rad] are the stops, ``p_M`` (n, 3) [m] the SMR positions without the effect. Linear, about the nominal
    arm registered to the tracker: the part of the displacement orthogonal to the columns of its Jacobian.
    """
    nominal = start_from_nominal(nominal_arm(arm), q, p_M, tool_unknown=arm.smr.offset == "unknown")
    columns = auto_set(nominal, q).columns
    _, J = jacobian(nominal, JointAngles.of(q), columns)
    basis, _ = np.linalg.qr(J.transpose(0, 2, 1).reshape(-1, len(columns)))
    y = moved.T.ravel()
    return np.asarray((y - basis @ (basis.T @ y)).reshape(3, -1).T)


def _plain(parameters: Mapping[str, Any]) -> dict[str, JsonValue]:
    """Parameters of a hidden law as plain JSON values."""
    plain: dict[str, JsonValue] = json.loads(json.dumps(parameters))
    return plain


def _rms_um(vectors: Array) -> float:
    """Root mean square length [um] of vectors (n, 3) [m]; NaN of none."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) * 1e6 if len(vectors) else math.nan


def _stated_um(readings: Readings) -> float:
    stated = stated_uncertainty(readings)
    assert stated is not None, "a plant states the covariance of every reading"
    return rms_length_mm(stated) * 1e3


def _new_folder(folder: Path) -> bool:
    """Make the folder and return whether it was missing. Raises ``InputError`` if it cannot be used."""
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
