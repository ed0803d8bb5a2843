"""Records of judged trials: findings in an arm, score of a run, counts, targets, misses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from cellapp.commands.trials.sealed import DescribedTerm, SealHeader
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.results import Record, Result

THRESHOLD = "visible rms above the rms length of the stated noise (noise per coordinate times root 3)"
NOTHING, NOT_KNOWN = "nothing missing", "unknown effect"
VERDICTS = ("explained", "ambiguous", NOT_KNOWN, NOTHING)

Outcome = Literal["named", "extra", "part", "wrong", "unknown", "none"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
Likeness = Literal["", "part", "right"]
"""How far a description matches a law outside the library."""


class Spread(Record):
    """Median and range of some values."""

    median: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Return the median and range of the finite values; None of none."""
        known = [value for value in values if np.isfinite(value)]
        if not known:
            return None
        return cls(median=float(np.median(known)), min=float(min(known)), max=float(max(known)))


class NoiseLengths(Record):
    """Rms length of the noise that the search assumed, and of the noise really drawn at the held-out stops [µm].

    ``stated`` is None where the search had no number for it.
    """

    stated: float | None
    drawn: float


class HiddenEffect(Record):
    """One hidden effect in short, as in ``truth.json``; ``law`` is empty for the plant's default one.

    ``visible`` is whether its visible size is above the noise.
    """

    effect: str
    plant: str
    law: str = ""
    raw_um: float
    visible_um: float
    beyond_law_um: float | None = None
    visible: bool = True


class ArmFindings(Record):
    """What discovery found in one arm.

    ``posteriors`` are the stated probabilities of the effects (slug -> probability), empty where none were stated;
    ``invisible`` the effects that this plan cannot show; ``sentence`` the verdict in words. ``seconds`` are of wall
    clock, ``cpu_seconds`` of processor time.
    """

    accepted: tuple[str, ...]
    answer_sets: tuple[tuple[str, ...], ...]
    described: tuple[DescribedTerm, ...]
    posteriors: Mapping[str, float] = {}
    invisible: tuple[str, ...] = ()
    verdict: str
    sentence: str = ""
    heldout_um: BeforeAfter
    noise_um: NoiseLengths
    seconds: float
    cpu_seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Accepted effects of the library."""
        return tuple(slug for slug in self.accepted if slug != UNKNOWN)

    @property
    def unknown(self) -> bool:
        """Whether discovery reported that the library lacks something."""
        return self.verdict == NOT_KNOWN or UNKNOWN in self.accepted

    @property
    def to_drawn(self) -> float:
        """Held-out rms over that of the noise really drawn at those stops."""
        return self.heldout_um.after / self.noise_um.drawn

    @property
    def to_stated(self) -> float | None:
        """Held-out rms over that of the assumed noise; None where the search had none."""
        return self.heldout_um.after / self.noise_um.stated if self.noise_um.stated else None


class SecondName(Record):
    """Something accepted beyond as many effects as were hidden.

    ``same_cause`` says whether it depends on a quantity that a hidden effect depends on too: it then stands in for what
    that effect's law left. Otherwise it is a false alarm beside a hidden effect.
    """

    name: str
    same_cause: bool


class ScoredRun(Record):
    """One run: what was hidden in which arm, what was found, and how that scores.

    ``visible``, ``outcome`` and ``in_answer_set`` are None where nothing is hidden. ``outcome`` is ``named`` (exactly
    the names), ``extra`` (those and more), ``part`` (some of them and nothing else), ``unknown`` (data-driven terms
    only), ``none`` or ``wrong``. ``description`` is ``right`` where a term has the channel and the variables of a law
    outside the library, ``part`` with the channel and some of them, else empty. ``says_convention`` is whether the
    words say that a sign is opposite; None unless approach signs were flipped.
    """

    run: str
    kind: str
    look_alikes: bool
    arm: str
    hidden: tuple[HiddenEffect, ...]
    expected: DescribedTerm | None
    visible: bool | None
    outcome: Outcome | None
    in_answer_set: bool | None
    description: Likeness
    second_names: tuple[SecondName, ...] = ()
    says_convention: bool | None = None
    arms: Mapping[str, ArmFindings]

    @property
    def findings(self) -> ArmFindings:
        """What was found in the arm with the hidden effects."""
        return self.arms[self.arm]

    @property
    def hidden_names(self) -> str:
        """The hidden effects as the plant names them; a single one with its law, and whether signs were flipped."""
        names = " + ".join(effect.plant for effect in self.hidden)
        law = self.hidden[0].law if len(self.hidden) == 1 else ""
        return names + (f"/{law}" if law else "") + (", signs flipped" if self.says_convention is not None else "")


class EndState(Record):
    """Held-out error against drawn and assumed noise, and number of each verdict."""

    heldout_to_drawn: Spread | None
    verdicts: Mapping[str, int]


class OutcomeCounts(EndState):
    """Number of each outcome in runs that hide the same."""

    n: int
    visible_um: Spread | None
    beyond_law_um: Spread | None
    named: int
    extra: int
    part: int
    wrong: int
    unknown: int
    none: int
    in_answer_set: int

    def count(self, outcome: Outcome) -> int:
        """Return the number of one outcome."""
        found: int = getattr(self, outcome)
        return found


class EffectCounts(Record):
    """Runs that hide the same, apart for visible and for smaller effects; ``look_alikes`` for pairs only."""

    visible: OutcomeCounts
    below: OutcomeCounts
    look_alikes: bool | None = None
    omitted_when_none = frozenset({"look_alikes"})


class CleanCounts(EndState):
    """False alarms in arms without hidden effects."""

    n: int
    false_names: int
    false_unknown: int


class OutsideCounts(EndState):
    """Runs with a law that the library lacks."""

    n: int
    visible_um: Spread | None
    unknown: int
    right: int
    part: int
    false_names: int


class TargetScore(Record):
    """One target: the share that is wanted and that was reached.

    ``met`` is None where there were too few trials. ``bar`` is whether a miss with enough trials is an error of the
    whole command. ``reached`` is None where ``share`` is a score, not a share of ``n``.
    """

    kind: str
    target: str
    wanted: float
    at_most: bool
    trials_wanted: int
    reached: int | None
    n: int
    share: float
    met: bool | None
    bar: bool = False

    @property
    def missed(self) -> bool:
        """Whether a bar was missed in enough trials to say so."""
        return self.bar and self.met is False and self.n >= self.trials_wanted


class ReliabilityBin(Record):
    """Statements with a probability from ``low`` to ``high``: number, mean stated probability, share that is true."""

    low: float
    high: float
    n: int
    stated: float | None
    true: float | None


class PosteriorScore(Record):
    """Stated probabilities against the truth: mean squared difference (Brier 1950), and a reliability table."""

    about: str
    n: int
    brier: float
    bins: tuple[ReliabilityBin, ...]


class Miss(Record):
    """An arm in which not exactly the hidden effects were found."""

    run: str
    arm: str
    hidden: str
    found: str
    said: str
    verdict: str
    to_drawn: float


class Scores(Record):
    """Targets, counts by effect, law and pair, arms without effects, posteriors, speed, misses, and every run."""

    threshold: str = THRESHOLD
    targets: tuple[TargetScore, ...]
    one: Mapping[str, EffectCounts]
    none: Mapping[str, CleanCounts]
    outside: Mapping[str, OutsideCounts]
    pair: Mapping[str, EffectCounts]
    posteriors: tuple[PosteriorScore, ...] = ()
    seconds_an_arm: Spread | None
    cpu_seconds_an_arm: Spread | None
    misses: tuple[Miss, ...]
    trials: tuple[ScoredRun, ...]

    @property
    def missed(self) -> tuple[TargetScore, ...]:
        """Bars that were missed in enough trials to say so."""
        return tuple(target for target in self.targets if target.missed)


class JudgeResult(Scores, Result, schema="cellapp-trials-judge"):
    """``trials judge``: scores, how the trials were sealed, and runs that could not be scored with the reason."""

    date: str
    program: str
    source: str
    judged_by_other_source: int
    sealed: SealHeader
    failed: tuple[str, ...]
