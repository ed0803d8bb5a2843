"""Stages of a run: what each verb stored, what it rests on, and whether that still holds.

A verb appends a stage and never edits an earlier one. Every stage records its basis: hashes of the profile, of the
readings and of the earlier stages that it used. A stage whose basis has changed since is out of date: it stays
readable, is shown with the reason, and its model is not sent to the arms unless the operator insists.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ValidationError

from cellapp.cell.run.file import RunFile, former_arrays, noted_profile
from cellapp.cell.run.measured_again import replaced_counts
from cellapp.cell.run.recordings import recordings_digest
from cellapp.cell.run.sqlite_file import StageRow
from cellapp.estimation.monitoring.records import CHANGES_OF_ARMS, TRACKER_MOVED
from cellapp.estimation.readings.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.results import (
    CALIBRATE,
    CHECK,
    DISCOVER,
    EARLIER_NOT_DECIDED,
    ISO9283,
    LOCATE,
    STAGE_NAMES,
    VERIFY,
    Record,
    Result,
    StageName,
)
from cellapp.ground.shell import shell_word


class ReadingsBasis(Record):
    """Number of readings of one arm, and the hash of their measured arrays and splits; empty if only counted.

    ``again`` counts the readings that later ones had replaced.
    """

    n: int
    sha256: str
    again: int = 0

    def is_same(self, other: ReadingsBasis) -> bool:
        """Return whether both are of the same readings, as far as both know them."""
        hashes = {self.sha256, other.sha256} - {""}
        return (self.n, self.again) == (other.n, other.again) and len(hashes) < 2


class PriorBasis(Record):
    """The earlier run whose calibration of one arm was taken as prior, and ``earlier_digest`` of it then."""

    run: str
    sha256: str


class Basis(Record):
    """SHA-256 hashes of what a stage rests on; ``stages`` maps each earlier stage that it used to its digest,
    ``priors`` each arm to the earlier run that was its prior, ``recordings`` those of motion, if any (``n`` points)."""

    profile: str
    readings: Mapping[str, ReadingsBasis]
    stages: Mapping[StageName, str] = {}
    targets: str | None = None
    priors: Mapping[str, PriorBasis] = {}
    recordings: Mapping[str, ReadingsBasis] = {}


def basis_of(run: RunFile, stages: Mapping[StageName, str] | None = None) -> Basis:
    """Return the basis of a stage that is stored now; ``stages`` maps each earlier stage that it uses to its digest."""
    measured = run.rows if run.removed_kinds() else run.readings
    readings, again = {name: measured(name) for name in run.arms()}, replaced_counts(run)
    return Basis(
        profile=sha256_of(run.profile_text),
        readings={
            name: ReadingsBasis(n=len(arm), sha256=readings_digest(arm), again=again.get(name, 0))
            for name, arm in readings.items()
        },
        stages=stages or {},
        recordings=recordings_basis(run),
    )


def recordings_basis(run: RunFile) -> dict[str, ReadingsBasis]:
    """Return the count and hash of each arm's recordings of motion; empty if there are none."""
    found = {name: recordings_digest(run, name) for name in run.profile.arms}
    return {name: ReadingsBasis(n=n, sha256=digest) for name, (n, digest) in found.items() if digest}


def counted_basis(run: RunFile) -> Basis:
    """Return the basis as ``basis_of`` does, but only count the readings, which is quick.

    No verb changes readings in place, so counts suffice. ``collect`` adds readings, stops measured again are counted,
    and splits are drawn only for readings without one, before a calibration uses them.
    """
    again = replaced_counts(run)
    counts = {name: sum(splits.values()) for name, splits in run.split_counts().items()}
    return Basis(
        profile=sha256_of(run.profile_text),
        readings={name: ReadingsBasis(n=n, sha256="", again=again.get(name, 0)) for name, n in counts.items()},
        recordings=recordings_basis(run),
    )


def readings_digest(readings: Readings) -> str:
    """Hash the names and little-endian values of all measured arrays of one arm, and its splits (SHA-256)."""
    digest = hashlib.sha256()
    arrays = {entry.name: getattr(readings, entry.name) for entry in fields(readings)}
    for name, values in (arrays | former_arrays(readings)).items():
        if isinstance(values, np.ndarray):
            digest.update(f"{name} {values.shape}\n".encode())
            digest.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes())
    digest.update(json.dumps(readings.split).encode())
    return digest.hexdigest()


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


NextVerb = Literal[
    "plan",
    "collect",
    "calibrate",
    "discover",
    "check --tracker-moved",
    "compensate",
    "push",
    "iso9283",
    "check",
    "report",
    "certificate",
    "",
]
"""The verb that comes next in a run. ``push`` stands for verifying compensated targets, ``compensate`` takes its place
if nothing can be driven, ``plan`` stands for a new run of a cell that has changed; empty if nothing is left."""

CALIBRATION_FILE = "calibration.json"
"""File of the exported model in force, for other programs; cellapp itself reads the stored stages."""


@dataclass(frozen=True)
class StoredStage:
    """A result that one verb stored.

    Attributes
    ----------
    number : int
        Number of its row.
    name : str
    written, program : str
        Time of writing (ISO 8601, UTC), and version of the program.
    basis : Basis
        What it rests on.
    text : str
        The result as JSON.
    model : str or None
        The model that the verb made, as JSON; None if it made none.
    sole : bool
        Whether the run has no other stage of this name.
    """

    number: int
    name: StageName
    written: str
    program: str
    basis: Basis
    text: str
    model: str | None
    sole: bool = False

    def has_outcome(self, name: StageName, digest: str) -> bool:
        """Return whether a later stage with basis ``name`` and ``digest`` used this stage or one of its outcome."""
        return (self.sole and self.name == name) or self.digest == digest

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the model without its provenance; of the result if the stage made no model.

        The same outcome at another time has the same digest. Raises ``InputError`` if the model is not JSON.
        """
        if self.model is None:
            return sha256_of(self.text)
        content = json_object(self.model)
        if content is None:
            raise InputError(f"the stored model of '{self.name}' is damaged; run 'cellapp {self.name} DIR' again")
        content.pop("provenance", None)
        return sha256_of(json.dumps(content, sort_keys=True))


@dataclass(frozen=True)
class RunStages:
    """The newest stage of each name, and the stages that no longer hold.

    Attributes
    ----------
    current : mapping
        Name -> newest stage.
    out_of_date : mapping
        Name -> reason, a phrase such as "20 readings were added since".
    in_force : StoredStage or None
        The stage whose model is used: the discovery if it rests on the current calibration, else the calibration. If
        the tracker was located on that model later, the location: that model in the tracker frame of the new station.
    """

    current: Mapping[StageName, StoredStage]
    out_of_date: Mapping[StageName, str]
    in_force: StoredStage | None

    def stale_model(self) -> str:
        """Say why the model in force should not be used, for its arms or the tracker's station; empty if it may be."""
        return "; ".join(filter(None, (self.stale_arms(), self.stale_station())))

    def stale_arms(self) -> str:
        """Say why the arms of the model in force should not be used, wherever the tracker stands; empty if they may."""
        found = self._found_change()
        changed = change_words(found) if found in CHANGES_OF_ARMS else ""
        return "; ".join(filter(None, (self.outdated_arms(), changed)))

    def outdated_arms(self) -> str:
        """Say why the arms of the model in force are out of date with the data of the run; empty if they are not."""
        reasons = [
            f"'{name}' is out of date ({self.out_of_date[name]})"
            for name in (CALIBRATE, DISCOVER)
            if name in self.out_of_date
        ]
        return "; ".join(reasons)

    def stale_station(self) -> str:
        """Say why the tracker is not where the model in force has it; empty if nothing says so."""
        found = self._found_change()
        moved = change_words(found) if found == TRACKER_MOVED else ""
        return "; ".join(filter(None, (self.outdated_station(), moved)))

    def outdated_station(self) -> str:
        """Say why the last location of the tracker does not hold; empty if it holds, or none was needed."""
        located = self.current.get(LOCATE)
        if located is not None and located.model is None:
            return "no motion of the tracker explains the points of the last location"
        if tracker_moved(located) and LOCATE in self.out_of_date:
            return f"the tracker was moved, and '{LOCATE}' is out of date ({self.out_of_date[LOCATE]})"
        return ""

    def _found_change(self) -> str:
        """Return the verdict of the last check if it found a change and still holds; else empty."""
        checked = self.current.get(CHECK)
        return "" if checked is None or CHECK in self.out_of_date else found_change(checked.text)

    def next_verb(self) -> NextVerb:
        """Return the verb of the first step that is missing or out of date; empty if there is none."""
        if CALIBRATE not in self.current or CALIBRATE in self.out_of_date:
            return "calibrate"
        if DISCOVER not in self.current or DISCOVER in self.out_of_date:
            return "discover"
        if self.stale_arms():
            return "plan"
        if self.stale_station():
            return "check --tracker-moved"
        return "push" if VERIFY not in self.current or VERIFY in self.out_of_date else ""

    def next_step(self, folder: Path) -> str:
        """Return the command of ``next_verb``; empty if there is none."""
        return next_command(self.next_verb(), folder)


HERE = Path()
"""A run's folder for commands in that folder, as its page gives them: the page is the same wherever it lies."""


def next_command(verb: NextVerb, folder: Path) -> str:
    """Return the command of the verb that comes next, of the chapter about it if a file that it needs is not known.

    Empty if there is no verb.
    """
    run = shell_word(folder)
    if not verb:
        return ""
    if verb in ("push", "compensate"):
        return at_targets(verb, folder, " --verify" if verb == "push" else "")
    if verb == "plan":
        if (profile := known_files(folder)[0]) is None:
            return "cellapp docs planning"
        new = next(one for k in count(2) if not (one := folder.with_name(f"{folder.resolve().name}-{k}")).exists())
        return f"cellapp plan {shell_word(profile)} --run {shell_word(new)}"
    name, *options = verb.split()
    return " ".join(["cellapp", name, run, *options])


def at_targets(verb: str, folder: Path, options: str = "") -> str:
    """Return the command of a verb that takes targets, with those of the profile; the chapter if it names none."""
    targets = known_files(folder)[1]
    known = f"cellapp {verb} {shell_word(folder)} {shell_word(targets or '')}{options}"
    return "cellapp docs targets" if targets is None else known


def known_files(folder: Path) -> tuple[Path | None, Path | None]:
    """Return the files of the profile and of the targets that it names, None for one that is not there."""
    if folder == HERE:
        return None, None
    try:
        with RunFile.peek(folder) as run:
            profile, named = noted_profile(run), run.profile.targets
    except InputError:
        return None, None
    if profile is None or not profile.is_file():
        return None, None
    here = Path.cwd()
    profile = profile.relative_to(here) if profile.is_relative_to(here) else profile
    targets = profile.parent / named if named else profile
    return profile, targets if named and targets.is_file() else None


def tracker_moved(located: StoredStage | None) -> bool:
    """Return whether ``check --tracker-moved`` found that the tracker was moved since the readings were taken."""
    return located is not None and (json_object(located.text) or {}).get("moved") is True


def append_stage(run: RunFile, name: StageName, result: Result, basis: Basis, model: str | None = None) -> StoredStage:
    """Append the result of a verb and the model (JSON) that it made; earlier rows stay as they are."""
    run.append_stage(name, basis.model_dump_json(), result.to_json(), model)
    return read_history(run)[-1]


def read_history(run: RunFile) -> list[StoredStage]:
    """Read every stage ever stored, oldest first, but for those of which nobody knows what they rest on."""
    stages = [_stage(run, row, row.basis) for row in run.stage_rows() if row.basis is not None]
    times = Counter(stage.name for stage in stages)
    return [replace(stage, sole=times[stage.name] == 1) for stage in stages]


def read_stages(run: RunFile, basis_now: Callable[[RunFile], Basis] | None = None) -> RunStages:
    """Read the newest stage of each name, and find out which of them no longer hold.

    ``basis_now`` computes the basis of a stage that is stored now; ``basis_of`` if not given.
    """
    newest = _newest(read_history(run))
    current = {name: newest[name] for name in STAGE_NAMES if name in newest}
    if not current:
        return RunStages({}, {}, None)
    unmoved = _in_force_before_moving(current)
    in_force = _in_force(current, unmoved)
    now = (basis_now or basis_of)(run)
    used = {CALIBRATE: None, DISCOVER: current.get(CALIBRATE), LOCATE: unmoved}
    if CHECK in current and found_change(current[CHECK].text) in CHANGES_OF_ARMS:
        used[CHECK] = unmoved
    reasons = {name: _why_outdated(stage, now, used.get(name, in_force), current) for name, stage in current.items()}
    if run.removed_kinds():
        reasons = dict.fromkeys(current, "an earlier version made it, from readings of a kind that was removed")
    return RunStages(current, {name: reason for name, reason in reasons.items() if reason}, in_force)


def basis_on_model(run: RunFile, model: StoredStage, targets: Sequence[BaseModel] = ()) -> Basis:
    """Return the basis of a stage that uses a model for targets or paths: the readings are those of the model's
    basis."""
    return Basis(
        profile=sha256_of(run.profile_text),
        readings=model.basis.readings,
        recordings=model.basis.recordings,
        stages={model.name: model.digest},
        targets=sha256_of("\n".join(one.model_dump_json(exclude_none=True, exclude_defaults=True) for one in targets)),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


_DONE: Mapping[StageName, str] = {
    CALIBRATE: "the run was calibrated",
    DISCOVER: "the run was searched for missing effects",
    LOCATE: "the tracker was located",
}
"""Phrases for what a verb that makes a model did since."""
_MEASURED: Mapping[StageName, str] = {VERIFY: "targets were verified", ISO9283: "the cell was tested by ISO 9283"}
"""Phrases for what a verb that measures with a model did since; a certificate rests on these."""
STORED_OTHERWISE: Mapping[StageName, str] = {
    VERIFY: "the stored verification was changed",
    ISO9283: "the stored test by ISO 9283 was changed",
}
"""Reason why a certificate is out of date if this stage is not the one that was certified."""


def _stage(run: RunFile, row: StageRow, recorded: str) -> StoredStage:
    try:
        basis = Basis.model_validate_json(recorded)
    except ValidationError:
        raise InputError(f"{run.path} is damaged (basis of stage {row.number}); restore it from a copy") from None
    return StoredStage(**{**vars(row), "basis": basis})


def _newest(history: Sequence[StoredStage]) -> dict[StageName, StoredStage]:
    """Return the newest stage of each name; a check without a verdict does not replace one that found a change."""
    newest: dict[StageName, StoredStage] = {}
    for stage in history:
        before = newest.get(CHECK)
        if stage.name == CHECK and before is not None and undecided(stage.text) and found_change(before.text):
            continue
        newest[stage.name] = stage
    return newest


def _in_force(current: Mapping[StageName, StoredStage], unmoved: StoredStage | None) -> StoredStage | None:
    """Return the stage in force: ``locate`` if it rests on ``unmoved``, the model in force before the tracker moved."""
    located = current.get(LOCATE)
    if unmoved is None or located is None or located.model is None:
        return unmoved
    rests = (unmoved.has_outcome(name, digest) for name, digest in located.basis.stages.items())
    return located if all(rests) else unmoved


def _in_force_before_moving(current: Mapping[StageName, StoredStage]) -> StoredStage | None:
    calibrate, discover = current.get(CALIBRATE), current.get(DISCOVER)
    if calibrate is None or discover is None:
        return calibrate
    used = discover.basis.stages.get(CALIBRATE)
    return discover if used is not None and calibrate.has_outcome(CALIBRATE, used) else calibrate


def _why_outdated(
    stage: StoredStage, now: Basis, used: StoredStage | None, current: Mapping[StageName, StoredStage]
) -> str:
    """Say why a stage no longer holds; empty if it does. ``used`` is the stage whose model it would use now.

    Of stages without a model it would use the newest of their name. A digest is empty if there was no such stage.
    """
    reasons = []
    if stage.basis.profile != now.profile:
        reasons.append("the profile was changed since")
    reasons += _changed_readings(stage.basis.readings, now.readings)
    if dict(stage.basis.recordings) != dict(now.recordings):
        reasons.append("the recordings of motion were changed since")
    reasons += _changed_priors(stage.basis.priors)
    for name, digest in stage.basis.stages.items():
        if name in _MEASURED:
            newest = current.get(name)
            if newest is not None and newest.digest != digest:
                later = newest.number > stage.number
                reasons.append(f"{_MEASURED[name]} since" if later else STORED_OTHERWISE[name])
        elif used is not None and not used.has_outcome(name, digest):
            verb = _DONE[used.name]
            again = "again since, with another outcome" if used.name == name else "since, and another model is in force"
            reasons.append(f"{verb} {again}")
    return ", ".join(reasons)


def not_calibrated(path: Path, folder: Path) -> InputError:
    """Return the error that the run in a folder must be calibrated first."""
    return InputError(f"{path}: not calibrated yet; run 'cellapp calibrate {shell_word(folder)}' first")


def earlier_digest(run: RunFile, arm: str) -> str:
    """Return the SHA-256 of a run's model in force and of one arm's readings: the basis of a later run's prior.

    Raises ``InputError`` if the run is not calibrated.
    """
    in_force = _in_force_before_moving({stage.name: stage for stage in read_history(run)})
    if in_force is None:
        raise not_calibrated(run.path, run.folder)
    return sha256_of(f"{in_force.digest} {readings_digest(run.readings(arm))}")


def _changed_priors(priors: Mapping[str, PriorBasis]) -> list[str]:
    """Say which priors have changed since; a prior whose run no longer exists counts as unchanged."""
    reasons = []
    for arm, prior in priors.items():
        try:
            with RunFile.open(Path(prior.run)) as earlier:
                same = earlier_digest(earlier, arm) == prior.sha256
        except InputError:
            continue
        if not same:
            reasons.append(f"the earlier calibration {prior.run} has changed since")
    return list(dict.fromkeys(reasons))


def _changed_readings(then: Mapping[str, ReadingsBasis], now: Mapping[str, ReadingsBasis]) -> list[str]:
    before, after = (
        (sum(arm.n for arm in arms.values()), sum(arm.again for arm in arms.values())) for arms in (then, now)
    )
    changes = zip(("added", "measured again"), before, after, strict=True)
    more = [
        f"{counted(new - old, 'reading was', 'readings were')} {what} since" for what, old, new in changes if new > old
    ]
    if more:
        return more
    same = then.keys() == now.keys() and all(now[name].is_same(arm) for name, arm in then.items())
    return [] if same else ["the readings or their splits were changed since"]


# -- what the stored text of a stage says, as far as it decides which stages hold; the whole result is not read --------


def json_object(text: str) -> dict[str, object] | None:
    """Parse a text as a JSON object; None if it is none."""
    try:
        content = json.loads(text)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def found_change(text: str) -> str:
    """Return the verdict of this result of ``check`` if it found a change; empty if not, or if it could not say."""
    verdict = _verdict(text)
    return verdict if verdict in (TRACKER_MOVED, *CHANGES_OF_ARMS) else ""


def undecided(text: str) -> bool:
    """Return whether this result of ``check`` has no verdict, also one of an earlier version."""
    return _verdict(text) in ("not decided", EARLIER_NOT_DECIDED)


def change_words(verdict: str) -> str:
    """Say that a check found a change, as a reason not to use the model."""
    return f"the last '{CHECK}' found: {verdict}"


def _verdict(text: str) -> str:
    content = json_object(text)
    verdict = None if content is None else content.get("verdict")
    return verdict if isinstance(verdict, str) else ""


CERTIFICATE_FILE = "certificate.json"
"""Name of the certificate in the run's folder; ``--out`` writes it elsewhere."""
