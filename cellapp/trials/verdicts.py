"""What was found in sealed trials beside what is true: counts, targets, tables, misses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.discovery.terms import UNKNOWN
from cellapp.reporting.table import Table
from cellapp.trials.sealed import Truth

AT_FLOOR = 1.05
SLOWEST_S = 3.0
THRESHOLD = "visible rms above the rms length of the stated noise (noise per coordinate times root 3)"
NOTHING, NOT_KNOWN = "nothing missing", "unknown effect"
_VERDICTS = ("explained", "ambiguous", NOT_KNOWN, NOTHING)
_ENOUGH_CLEAN = 300


@dataclass(frozen=True)
class Found:
    """What discovery found in one arm.

    ``described`` has channel and variables of each data-driven term; held-out errors and the stated noise are rms
    lengths [um].
    """

    accepted: tuple[str, ...]
    answer_sets: tuple[tuple[str, ...], ...]
    described: tuple[tuple[str, tuple[str, ...]], ...]
    verdict: str
    before_um: float
    after_um: float
    floor_um: float
    seconds: float
    cpu_seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """The accepted effects that have a name."""
        return tuple(slug for slug in self.accepted if slug != UNKNOWN)

    @property
    def unknown(self) -> bool:
        """Whether it was said that the library lacks something."""
        return self.verdict == NOT_KNOWN or UNKNOWN in self.accepted


@dataclass(frozen=True)
class Judged:
    """The truth of a run and what was found in its arms; ``source`` is the state of the program that did it."""

    truth: Truth
    arms: Mapping[str, Found]
    source: str

    @property
    def here(self) -> Found:
        """What was found in the arm that hides something."""
        return self.arms[self.truth.arm]

    @property
    def hidden(self) -> frozenset[str]:
        """Names of what is hidden."""
        return frozenset(effect.effect for effect in self.truth.effects)

    @property
    def visible(self) -> bool:
        """Whether each hidden effect alone moves the SMR visibly more than the noise."""
        noise = self.truth.noise_um[self.truth.arm]
        return all(effect.visible_um > noise for effect in self.truth.effects)

    @property
    def answered(self) -> bool:
        """Whether all that is hidden is in some finding's answer set."""
        return self.hidden <= {slug for answers in self.here.answer_sets for slug in answers}

    @property
    def outcome(self) -> str:
        """``named``: exactly the names; ``extra``: those and more; ``part``: some of them and nothing else;

        ``unknown``: only data-driven terms; ``none``: nothing; ``wrong``: anything else.
        """
        accepted = frozenset(self.here.accepted)
        if accepted == self.hidden:
            return "named"
        if not accepted:
            return "none"
        if accepted > self.hidden:
            return "extra"
        if accepted < self.hidden:
            return "part"
        return "unknown" if accepted == {UNKNOWN} else "wrong"

    @property
    def description(self) -> str:
        """``right``: a term has the channel and the variables of the law; ``part``: the channel and some; or ``""``.

        A term of the channel in one direction only counts as that channel.
        """
        expected = self.truth.expected
        if expected is None:
            return ""
        best = ""
        for channel, variables in self.here.described:
            if channel != expected["channel"] and not channel.startswith(f"{expected['channel']} "):
                continue
            if set(variables) == set(expected["variables"]):
                return "right"
            if set(variables) & set(expected["variables"]):
                best = "part"
        return best

    def to_drawn(self, arm: str) -> float:
        """Held-out rms over that of the noise really drawn at those stops."""
        return self.arms[arm].after_um / self.truth.held_out_um[arm]

    def to_stated(self, arm: str) -> float:
        """Held-out rms over that of the stated noise."""
        return self.arms[arm].after_um / self.arms[arm].floor_um

    def as_dict(self) -> dict[str, Any]:
        """For JSON: the truth in short, and what was found in each arm."""
        truth = self.truth
        return {
            "run": truth.run,
            "kind": truth.kind,
            "look_alikes": truth.look_alikes,
            "arm": truth.arm,
            "hidden": [
                {"effect": one.effect, "plant": one.plant, "raw_um": one.raw_um, "visible_um": one.visible_um}
                for one in truth.effects
            ],
            "expected": truth.expected,
            "visible": self.visible if truth.effects else None,
            "outcome": self.outcome if truth.effects else None,
            "in_answer_set": self.answered if truth.effects else None,
            "description": self.description,
            "arms": {
                name: {
                    "accepted": list(found.accepted),
                    "answer_sets": [list(answers) for answers in found.answer_sets],
                    "described": [{"channel": c, "variables": list(v)} for c, v in found.described],
                    "verdict": found.verdict,
                    "heldout_um": {"before": found.before_um, "after": found.after_um},
                    "noise_um": {"stated": found.floor_um, "drawn": truth.held_out_um[name]},
                    "seconds": found.seconds,
                    "cpu_seconds": found.cpu_seconds,
                }
                for name, found in self.arms.items()
            },
        }


def judged_summary(trials: Sequence[Judged]) -> dict[str, Any]:
    """Targets, counts by effect, law and pair, clean arms, speed, misses, and every trial, for JSON."""
    one = [trial for trial in trials if trial.truth.kind == "one"]
    outside = [trial for trial in trials if trial.truth.kind == "outside"]
    pairs = [trial for trial in trials if trial.truth.kind == "pair"]
    clean = {
        "nothing hidden in the run": [(t, arm) for t in trials if t.truth.kind == "none" for arm in t.arms],
        "arm beside one that hides something": [
            (t, arm) for t in trials if t.truth.arm for arm in t.arms if arm != t.truth.arm
        ],
    }
    return {
        "threshold": THRESHOLD,
        "targets": _targets(trials, one, clean["nothing hidden in the run"], outside, pairs),
        "one": {slug: _counts(group) for slug, group in _groups(one, _plant_name).items()},
        "none": {what: _clean_counts(arms) for what, arms in clean.items() if arms},
        "outside": {slug: _outside_counts(group) for slug, group in _groups(outside, _plant_name).items()},
        "pair": {
            names: {"look_alikes": group[0].truth.look_alikes, **_counts(group)}
            for names, group in _groups(pairs, _plant_name).items()
        },
        "seconds_an_arm": _spread([found.seconds for t in trials for found in t.arms.values()]),
        "cpu_seconds_an_arm": _spread([found.cpu_seconds for t in trials for found in t.arms.values()]),
        "misses": [miss for trial in trials for miss in _misses(trial)],
        "trials": [trial.as_dict() for trial in trials],
    }


def judged_tables(result: Mapping[str, Any]) -> list[Table]:
    """Tables for people, from the object of ``trials judge --json``; the last one lists the misses."""
    head: tuple[str, ...] = ("kind", "target", "wanted", "reached", "share", "met")
    rows: list[tuple[str, ...]] = [_target_row(target) for target in result["targets"]]
    tables = [Table("Sealed trials: targets", head, tuple(rows))]
    for kind, title in (("one", "One hidden effect"), ("pair", "Two hidden effects")):
        if result[kind]:
            rows = []
            for name, group in result[kind].items():
                label = f"{name} (look-alikes)" if group.get("look_alikes") else name
                for which, more in (("visible", ""), ("below", ", below")):
                    if group[which]["n"]:
                        rows.append((label + more, *_count_row(group[which])))
            head = ("effect", "visible um", "n", "named", "otherwise", "in answer set", *_END)
            tables.append(Table(title, head, tuple(rows)))
    if result["none"]:
        rows = [
            (what, str(group["n"]), str(group["false_names"]), str(group["false_unknown"]), *_end(group))
            for what, group in result["none"].items()
        ]
        tables.append(Table("Nothing hidden", ("arms", "n", "false names", "false unknown", *_END), tuple(rows)))
    if result["outside"]:
        rows = []
        for name, group in result["outside"].items():
            counts = (group[key] for key in ("n", "unknown", "right", "part", "false_names"))
            rows.append((name, _um(group["visible_um"]), *map(str, counts), *_end(group)))
        head = ("law", "visible um", "n", "called unknown", "described", "in part", "false names", *_END)
        tables.append(Table("Outside the library", head, tuple(rows)))
    if result["misses"]:
        rows = [
            (
                f"{miss['run']} {miss['arm']}",
                miss["hidden"] or "nothing",
                miss["found"] or "nothing",
                miss["said"],
                miss["verdict"],
                f"{miss['to_drawn']:.3f}",
            )
            for miss in result["misses"]
        ]
        head = ("run", "hidden (visible um)", "found", "or / described", "verdict", "held out")
        tables.append(Table("Misses", head, tuple(rows)))
    return tables


def judged_sentences(result: Mapping[str, Any]) -> list[str]:
    """How the tables came about: threshold, abbreviations, speed, date, seed, program."""
    sealed = result["sealed"]
    wall, cpu = result["seconds_an_arm"], result["cpu_seconds_an_arm"]
    said = [
        f"Visible: {result['threshold']}, each hidden effect alone; below: not so, which counts for the targets of"
        " pairs and of the held-out error only. Held out: rms over that of the noise drawn at those stops, median and"
        f" worst. Verdicts: {', '.join(f'{word[0].upper()} {word}' for word in _VERDICTS)}."
    ]
    if wall is not None:
        said.append(
            f"Discovery of one arm: median {wall['median']:.1f} s, longest {wall['max']:.1f} s (processor"
            f" {cpu['median']:.1f} and {cpu['max']:.1f} s), {result['jobs']} at a time, a thread each."
        )
    if result["judged_by_other_source"]:
        said.append(
            f"{result['judged_by_other_source']} runs were judged by another state of the program than the present"
            " one; --again judges them anew."
        )
    said += [f"Not judged: {failure}." for failure in result["failed"]]
    said.append(
        f"{result['date']}; {result['program']}, source {result['source']}; {sealed['runs']} runs of {sealed['stops']}"
        f" stops an arm, profile {sealed['profile']}, kind {sealed['kind']}, noise {sealed['noise']},"
        f" seed {sealed['seed']}, sealed {sealed['written'][:10]} by {sealed['program']}."
    )
    return said


def trial_table_markdown(result: Mapping[str, Any]) -> str:
    """The tables as Markdown, from the object of ``trials judge --json``; date, seed and program stand at the end."""
    parts = []
    for table in judged_tables(result):
        lines = [f"**{table.title}**", "", _markdown_row(table.columns), "|" + " --- |" * len(table.columns)]
        parts.append("\n".join([*lines, *map(_markdown_row, table.rows)]))
    parts.append(" ".join(judged_sentences(result)))
    return "\n\n".join(parts) + "\n"


# -- counting ---------------------------------------------------------------------------------------------------------

_OUTCOMES = ("named", "extra", "part", "wrong", "unknown", "none")


def _plant_name(trial: Judged) -> str:
    return " + ".join(effect.plant for effect in trial.truth.effects)


def _groups(trials: Sequence[Judged], key: Callable[[Judged], str]) -> dict[str, list[Judged]]:
    groups: dict[str, list[Judged]] = {}
    for trial in sorted(trials, key=lambda t: (t.truth.look_alikes, key(t))):
        groups.setdefault(key(trial), []).append(trial)
    return groups


def _counts(trials: Sequence[Judged]) -> dict[str, Any]:
    """Outcomes of trials that hide the same, apart for those that are visible and those that are not."""
    return {
        "visible": _outcomes([trial for trial in trials if trial.visible]),
        "below": _outcomes([trial for trial in trials if not trial.visible]),
    }


def _outcomes(trials: Sequence[Judged]) -> dict[str, Any]:
    found = [trial.outcome for trial in trials]
    return {
        "n": len(trials),
        "visible_um": _spread([min(effect.visible_um for effect in trial.truth.effects) for trial in trials]),
        **{outcome: found.count(outcome) for outcome in _OUTCOMES},
        "in_answer_set": sum(trial.answered for trial in trials),
        **_ending([(trial, trial.truth.arm) for trial in trials]),
    }


def _clean_counts(arms: Sequence[tuple[Judged, str]]) -> dict[str, Any]:
    found = [trial.arms[arm] for trial, arm in arms]
    return {
        "n": len(arms),
        "false_names": sum(bool(one.names) for one in found),
        "false_unknown": sum(one.unknown for one in found),
        **_ending(arms),
    }


def _outside_counts(trials: Sequence[Judged]) -> dict[str, Any]:
    return {
        "n": len(trials),
        "visible_um": _spread([trial.truth.effects[0].visible_um for trial in trials]),
        "unknown": sum(trial.here.unknown for trial in trials),
        "right": sum(trial.description == "right" for trial in trials),
        "part": sum(trial.description == "part" for trial in trials),
        "false_names": sum(bool(trial.here.names) for trial in trials),
        **_ending([(trial, trial.truth.arm) for trial in trials]),
    }


def _ending(arms: Sequence[tuple[Judged, str]]) -> dict[str, Any]:
    """Held-out error against either floor, and verdicts."""
    verdicts = [trial.arms[arm].verdict for trial, arm in arms]
    return {
        "heldout_to_drawn": _spread([trial.to_drawn(arm) for trial, arm in arms]),
        "heldout_to_stated": _spread([trial.to_stated(arm) for trial, arm in arms]),
        "verdicts": {word: verdicts.count(word) for word in _VERDICTS if word in verdicts},
    }


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    return {"median": float(np.median(values)), "min": float(min(values)), "max": float(max(values))}


def _targets(
    trials: Sequence[Judged],
    one: Sequence[Judged],
    clean: Sequence[tuple[Judged, str]],
    outside: Sequence[Judged],
    pairs: Sequence[Judged],
) -> list[dict[str, Any]]:
    """What is wanted of each kind that there is, and what was reached."""
    targets: list[dict[str, Any]] = []

    def add(kind: str, what: str, wanted: float, hits: Sequence[bool], *, most: bool = False, least_n: int = 1) -> None:
        n, reached = len(hits), sum(hits)
        if n:
            held = reached <= wanted * n if most else reached >= wanted * n
            met = held if n >= least_n or not held else None
            targets.append(
                {
                    "kind": kind,
                    "target": what,
                    "wanted": wanted,
                    "at_most": most,
                    "trials_wanted": least_n,
                    "reached": reached,
                    "n": n,
                    "share": reached / n,
                    "met": met,
                }
            )

    seen = [trial for trial in one if trial.visible]
    add("one", "visible: exactly its name", 0.97, [trial.outcome == "named" for trial in seen])
    add("one", "visible: truth in the answer set", 0.99, [trial.answered for trial in seen])
    known = [*one, *pairs]
    drawn = [trial.to_drawn(trial.truth.arm) <= AT_FLOOR for trial in known]
    stated = [trial.to_stated(trial.truth.arm) <= AT_FLOOR for trial in known]
    add("one, pair", "held out within 5 % of the drawn noise", 1.0, drawn)
    add("one, pair", "the same against the stated noise, which scatters", 1.0, stated)
    found = [trial.arms[arm] for trial, arm in clean]
    names = [bool(one.names) for one in found]
    unknown = [one.unknown for one in found]
    add("none", "false names, by arm", 0.01, names, most=True, least_n=_ENOUGH_CLEAN)
    add("none", "false unknown effects, by arm", 0.01, unknown, most=True, least_n=_ENOUGH_CLEAN)
    add("outside", "called unknown", 0.95, [trial.here.unknown for trial in outside])
    right = [trial.description == "right" for trial in outside]
    add("outside", "right channel and variables", 0.80, right)
    ordinary = [trial.outcome == "named" for trial in pairs if not trial.truth.look_alikes]
    alike = [trial.outcome == "named" for trial in pairs if trial.truth.look_alikes]
    add("pair", "ordinary: exactly both names", 0.90, ordinary)
    add("pair", "look-alikes: exactly both names", 0.0, alike)
    quick = [one.seconds <= SLOWEST_S for trial in trials for one in trial.arms.values()]
    add("all", f"one arm within {SLOWEST_S:.0f} s", 1.0, quick)
    return targets


def _misses(trial: Judged) -> list[dict[str, Any]]:
    """The arms of a trial in which not exactly what is hidden was found."""
    misses = []
    for arm, found in trial.arms.items():
        here = arm == trial.truth.arm
        if not here:
            missed = bool(found.accepted) or found.unknown
        elif trial.truth.kind == "outside":
            missed = trial.description != "right" or bool(found.names)
        else:
            missed = trial.outcome != "named" and (trial.visible or bool(found.accepted))
        if missed:
            others = {slug for answers in found.answer_sets for slug in answers[1:]}
            described = [f"{channel}: {', '.join(variables)}" for channel, variables in found.described]
            effects = [f"{one.plant} ({one.visible_um:.0f})" for one in trial.truth.effects] if here else []
            misses.append(
                {
                    "run": trial.truth.run,
                    "arm": arm,
                    "hidden": " + ".join(effects),
                    "found": " + ".join(found.accepted),
                    "said": "; ".join([*(f"or {slug}" for slug in sorted(others)), *described]),
                    "verdict": found.verdict,
                    "to_drawn": trial.to_drawn(arm),
                }
            )
    return misses


# -- texts ------------------------------------------------------------------------------------------------------------

_END = ("held out", "verdicts")


def _target_row(target: Mapping[str, Any]) -> tuple[str, ...]:
    sign = "at most" if target["at_most"] else "at least"
    wanted = f"{sign} {100 * target['wanted']:.0f} %" if target["at_most"] or target["wanted"] else ""
    if target["n"] < target["trials_wanted"]:
        wanted += f" of {target['trials_wanted']}"
    met = {True: "yes", False: "no", None: "too few"}[target["met"]] if wanted else ""
    reached = f"{target['reached']} of {target['n']}"
    return target["kind"], target["target"], wanted, reached, f"{100 * target['share']:.1f} %", met


def _count_row(group: Mapping[str, Any]) -> tuple[str, ...]:
    otherwise = ", ".join(f"{word} {group[word]}" for word in _OUTCOMES[1:] if group[word])
    numbers = (_um(group["visible_um"]), str(group["n"]), str(group["named"]))
    return (*numbers, otherwise or "-", str(group["in_answer_set"]), *_end(group))


def _end(group: Mapping[str, Any]) -> tuple[str, ...]:
    ratio = group["heldout_to_drawn"]
    verdicts = " ".join(f"{word[0].upper()}{count}" for word, count in group["verdicts"].items())
    return f"{ratio['median']:.3f}, {ratio['max']:.3f}", verdicts


def _um(spread: Mapping[str, float]) -> str:
    low, high = f"{spread['min']:.0f}", f"{spread['max']:.0f}"
    return low if low == high else f"{low}-{high}"


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
