"""Coverage of ISO 9283:1998: whether each characteristic was done, done in part, or not done, and why.

Clauses and titles are those of the standard's table of contents, which is public; its text was not at hand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cellapp.estimation.iso9283.norm import ISO_COMMANDS, NORM_CYCLES, NORM_DRIFT_MIN, NORM_SPEEDS, IsoTest
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, IsoConditions, IsoLine, IsoStatus
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped

NOT_ASKED = "not asked for"
NOT_MEASURED = "asked for, and no two cycles were measured"
ONE_SMR = "one SMR on the flange shows its position, not its orientation; a 6-D probe (smr.probe) does"
POSES_ONLY = "orientation is evaluated in the pose test only"
NOT_OFFERED = "this program does not test it"


@dataclass(frozen=True)
class _Asked:
    """Characteristic of the standard that ``test`` measures; ``never`` says why if this program does not measure it.

    ``part`` of the results of the test has its number of cycles; ``without`` says why a test that was made does not
    show it.
    """

    clause: str
    words: str
    test: IsoTest | None = None
    part: str = "accuracy"
    never: str = NOT_OFFERED
    without: str = ""

    def cycles(self, made: CommandedTests) -> list[int]:
        """Return the numbers of cycles of what was measured."""
        results = [] if self.test is None else getattr(made, self.test)
        parts = [getattr(one, self.part) for one in (results if isinstance(results, tuple) else [results]) if one]
        return [one.n for one in parts if one is not None]


_ASKED: tuple[_Asked, ...] = (
    _Asked("7.2", "pose accuracy AP, repeatability RP", "pose"),
    _Asked("7.2", "AP, RP of the orientation", "pose", "orientation", without=ONE_SMR),
    _Asked("7.2.3", "multi-directional variation vAP", "multidirectional", "variation"),
    _Asked("7.3", "distance accuracy AD, repeatability RD", "distance"),
    _Asked("7.3", "AD, RD of the orientation", never=POSES_ONLY),
    _Asked("7.4", "position stabilisation time"),
    _Asked("7.5", "position overshoot OV"),
    _Asked("7.6", "drift dAP, dRP", "drift"),
    _Asked("7.7", "exchangeability E"),
    _Asked("8.2, 8.3", "path accuracy AT, repeatability RT", "path"),
    _Asked("8.2, 8.3", "AT, RT of the orientation", never=POSES_ONLY),
    _Asked("8.4", "path accuracy on reorientation"),
    _Asked("8.5", "cornering deviations CR, CO"),
    _Asked("8.6", "path velocity AV, RV, FV", "path", "velocity"),
    _Asked("9", "minimum posing time"),
    _Asked("10", "static compliance"),
    _Asked("11", "weaving deviations WS, WF"),
)


def coverage(
    tests: Sequence[IsoTest], arms: Mapping[str, ArmIso9283], conditions: IsoConditions | None, stopped: str = ""
) -> tuple[IsoLine, ...]:
    """Return one line for each characteristic, more if arms differ; the last two lines are the conditions.

    ``tests`` were requested; ``stopped`` says why the job ended early.
    """
    lines: list[IsoLine] = []
    for asked in _ASKED:
        by_words = grouped((_of_arm(asked, tests, arm, stopped), name) for name, arm in arms.items())
        lines += [
            IsoLine(clause=asked.clause, characteristic=asked.words, arms=tuple(names), status=status, words=words)
            for (status, words), names in by_words.items()
        ]
    return (*lines, *_conditions(arms, conditions))


def not_done(lines: Sequence[IsoLine]) -> dict[str, tuple[str, ...]]:
    """Map each reason to the characteristics that were not done for it, in the standard's order."""
    found = grouped((line.words, line.characteristic) for line in lines if line.status == "not done")
    return {reason: tuple(dict.fromkeys(names)) for reason, names in found.items()}


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_arm(asked: _Asked, tests: Sequence[IsoTest], arm: ArmIso9283, stopped: str) -> tuple[IsoStatus, str]:
    if asked.test is None:
        return "not done", asked.never
    found = {kind: values for kind in ISO_COMMANDS if kind in arm.tests and (values := asked.cycles(arm.tests[kind]))}
    refused = arm.refused.get(asked.test, "")
    if not found:
        if asked.test not in tests:
            return "not done", NOT_ASKED
        return "not done", refused or stopped or asked.without or NOT_MEASURED
    norm = NORM_CYCLES[asked.test]
    n = min(min(cycles) for cycles in found.values())
    words = f"{n} of {counted(norm, 'cycle')}" if n < norm else counted(n, "cycle")
    short = n < norm
    if asked.test == "drift":
        minutes = max(made.drift.minutes for made in arm.tests.values() if made.drift is not None)
        words += f" a group, over {minutes:.0f} of {NORM_DRIFT_MIN:.0f} min"
        short = short or minutes < NORM_DRIFT_MIN
    words = f"{words}, {' and '.join(found)} commands"
    if refused:
        return "in part", f"{words}; {refused}"
    return ("in part" if short else "done"), words


def _conditions(arms: Mapping[str, ArmIso9283], made: IsoConditions | None) -> Iterator[IsoLine]:
    """Yield the lines for speeds and loads of the standard's tests (6.6, 6.7)."""
    if made is None or not any(arm.tests for arm in arms.values()):
        return
    done = {one.speed_share for arm in arms.values() for own in arm.tests.values() for one in own.series}
    speeds = {round(share, 9) for share in (made.speed_share, *done)}
    missing = [f"{share:.0%}" for share in NORM_SPEEDS if round(share, 9) not in speeds]
    why = NOT_MEASURED if any(share in made.also_speeds for share in NORM_SPEEDS if share not in speeds) else NOT_ASKED
    words = f"{', '.join(f'{share:.0%}' for share in sorted(speeds, reverse=True))} of the profile's speed"
    yield IsoLine(
        clause="6.7",
        characteristic="speeds 100, 50, 10 % of the rated one",
        arms=tuple(arms),
        status="in part" if missing else "done",
        words=f"{words}; {', '.join(missing)}: {why}" if missing else words,
    )
    for load, names in grouped((f"{arm.payload_kg:g} kg", name) for name, arm in arms.items()).items():
        yield IsoLine(
            clause="6.6",
            characteristic="rated load, and 10 % of it",
            arms=tuple(names),
            status="in part",
            words=f"{load}; profiles state no rated load",
        )
