"""What discovery found as plain data and words, from the object of ``discover --json``: CLI, TUI and page draw it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from cellapp.reporting.table import Table
from cellapp.reporting.words import interval_95, law_words, place_words, short_reason

WIDTH = 80
"""Columns of a terminal."""
_TURN = 360.0
_SAME = 0.005
"""A gap this near another one, relatively, is not told twice."""


def is_current(result: Mapping[str, Any]) -> bool:
    """Whether a stored result has what this version of the program shows of one."""
    return all("steps" in arm for arm in result["arms"].values())


def gap_steps(arm: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What was done and the held-out rms [mm] after it, in order; the last is the model that is kept."""
    steps = [(step["what"], float(step["heldout_mm"])) for step in arm["steps"]]
    after = float(arm["heldout_mm"]["after"])
    if not steps or abs(steps[-1][1] - after) > _SAME * after:
        steps.append(("the model that is kept", after))
    return steps


def noise_floor(arm: Mapping[str, Any]) -> float | None:
    """[mm]; None where the readings state no uncertainty."""
    floor = arm["noise_floor_mm"]
    return None if floor is None or not math.isfinite(floor) else float(floor)


def own_sentence(name: str, arm: Mapping[str, Any]) -> str:
    """The verdict's sentence without the name of the arm."""
    return str(arm["sentence"]).removeprefix(f"arm {name}: ")


def told_from(found: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The rivals of a finding: those that these data cannot tell from it, and those that they can."""
    kept = [slug for slug in found["answer_set"] if slug != found["effect"]]
    return kept, [rival["effect"] for rival in found["runners_up"] if rival["told_apart"]]


# -- tables for every place -------------------------------------------------------------------------------------------


def discovery_tables(result: Mapping[str, Any]) -> list[Table]:
    """How the gap shrank, and what was accepted; one or two tables an arm."""
    if not is_current(result):
        return []
    tables = []
    for name, arm in result["arms"].items():
        tables.append(steps_table(name, arm))
        rows = [
            (
                found["effect"],
                place_words(found["where"]),
                f"{found['evidence']['corrected_p']:.2g}",
                _mm(found["evidence"]["heldout_mm"]["before"]),
                _mm(found["evidence"]["heldout_mm"]["after"]),
            )
            for found in arm["accepted"]
        ]
        if rows:
            columns = ("accepted", "where", "corrected p", "without", "with")
            tables.append(Table(f"Arm {name}: accepted effects, held-out rms [mm]", columns, tuple(rows)))
    return tables


def steps_table(name: str, arm: Mapping[str, Any]) -> Table:
    """The held-out gap after each step, and the noise floor."""
    rows = [(what, _mm(gap)) for what, gap in gap_steps(arm)]
    floor = noise_floor(arm)
    if floor is not None:
        rows.append(("noise floor", _mm(floor)))
    return Table(f"Arm {name}: {arm['verdict']}", ("step", "held-out rms [mm]"), tuple(rows))


def gap_table(name: str, arm: Mapping[str, Any]) -> Table:
    """As ``steps_table`` with the numbers of the steps, for where they are drawn too."""
    rows = [(str(number), what, _mm(gap)) for number, (what, gap) in enumerate(gap_steps(arm))]
    floor = noise_floor(arm)
    if floor is not None:
        rows.append(("", "noise floor", _mm(floor)))
    return Table(f"Arm {name}: the gap after each step", ("step", "what was done", "held-out rms [mm]"), tuple(rows))


# -- lines for a terminal ---------------------------------------------------------------------------------------------


def discovery_lines(result: Mapping[str, Any], width: int = WIDTH) -> list[str]:
    """Everything that a terminal shows of each arm: the gap, what was accepted, what is not told apart or not seen."""
    lines: list[str] = []
    for name, arm in result["arms"].items() if is_current(result) else ():
        lines += [f"Arm {name}", "  held-out rms [mm] after each step"]
        for what, gap in [*gap_steps(arm), ("noise floor", noise_floor(arm))]:
            if gap is not None:
                lines += _hanging(f"  {gap:9.4f}  ", what, width)
        lines += _accepted_lines(arm["accepted"], width)
        for found in arm["accepted"]:
            kept, _ = told_from(found)
            if kept:
                words = f"{' or '.join(kept)}: these data do not tell {'it' if len(kept) == 1 else 'them'} apart"
                lines += _hanging("  or instead   ", f"of {found['effect']}: {words}", width)
        for place, entry in enumerate(arm["invisible"]):
            line = f"{entry['effect']}: {short_reason(entry['reason'])}"
            lines.append(_cut(f"  {'' if place else 'not visible':11}  {line}", width))
        lines += _hanging("  verdict      ", f"{arm['verdict']}: {own_sentence(name, arm)}", width)
        lines.append("")
    return lines


def _accepted_lines(accepted: Sequence[Mapping[str, Any]], width: int) -> list[str]:
    """A small table, and below each periodic error its cycles."""
    if not accepted:
        return []
    lines = [f"  {'accepted':23} {'where':20} {'corrected p':>11}  without -> with [mm]"]
    for found in accepted:
        gap = found["evidence"]["heldout_mm"]
        place, p = place_words(found["where"]), f"{found['evidence']['corrected_p']:.2g}"
        lines.append(
            _cut(f"  {found['effect']:23} {place:20} {p:>11}  {gap['before']:7.4f} -> {gap['after']:.4f}", width)
        )
        cycles = cycle_words(found)
        if cycles:
            lines += _hanging("    cycles a turn  ", cycles, width)
        if "description" in found:
            lines += _hanging("    ", found["description"]["sentence"], width)
    return lines


def cycle_words(found: Mapping[str, Any]) -> str:
    """The dominating cycles a turn of a free curve, joint by joint; empty for anything else."""
    if found["law"]["name"] != "curve":
        return ""
    return ", ".join(
        f"joint {joint}: {_band(entry)} ({entry['rms_urad']:.0f} urad rms)"
        for joint, entry in found.get("cycles", {}).items()
    )


def _band(entry: Mapping[str, Any]) -> str:
    return str(entry["from"]) if entry["from"] == entry["to"] else f"{entry['from']}-{entry['to']}"


def _hanging(first: str, text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * len(first)) or [first.rstrip()]


def _cut(line: str, width: int) -> str:
    return line if len(line) <= width else line[: width - 3].rstrip() + "..."


# -- tables for the page ----------------------------------------------------------------------------------------------


def accepted_table(name: str, arm: Mapping[str, Any]) -> Table | None:
    """All that was measured of each accepted effect; None where there is none."""
    rows = []
    for found in arm["accepted"]:
        evidence, correlated = found["evidence"], found["correlated_with"]
        rows.append(
            (
                found.get("title", found["effect"]),
                law_words(found["effect"], found["law"], found["where"]["joints"]),
                place_words(found["where"]),
                f"{evidence['statistic']:.1f}",
                f"{evidence['corrected_p']:.2g}",
                _mm(evidence["heldout_mm"]["before"]),
                _mm(evidence["heldout_mm"]["after"]),
                " or ".join(found["answer_set"]),
                "" if correlated is None else f"{correlated['parameter']} ({correlated['correlation']:+.2f})",
            )
        )
    if not rows:
        return None
    columns = (
        "effect",
        "law",
        "where",
        "score",
        "corrected p",
        "without it [mm]",
        "with it [mm]",
        "answer set",
        "most correlated with",
    )
    return Table(f"Arm {name}: accepted effects, with the held-out rms without and with each", columns, tuple(rows))


def parameter_table(name: str, arm: Mapping[str, Any]) -> Table | None:
    """Values with 95 % intervals; curves and terms without a name are left to their pictures. None if none is left."""
    rows = [
        (found["effect"], parameter, *interval_95(entry))
        for found in arm["accepted"]
        if found["law"]["name"] != "curve" and "description" not in found
        for parameter, entry in found["parameters"].items()
    ]
    if not rows:
        return None
    columns = ("effect", "parameter", "value", "95 % interval", "unit")
    return Table(f"Arm {name}: size of the effects", columns, tuple(rows))


def cycle_table(name: str, arm: Mapping[str, Any]) -> Table | None:
    """Which cycles a turn dominate the periodic error of each joint; None where there is none."""
    rows = [
        (
            joint,
            f"{entry['from']} to {entry['to']}" if entry["from"] != entry["to"] else str(entry["from"]),
            str(entry["peak"]),
            f"{entry['rms_urad']:.0f}",
        )
        for found in arm["accepted"]
        for joint, entry in found.get("cycles", {}).items()
    ]
    if not rows:
        return None
    columns = ("joint", "cycles a turn, middle 80 % of the power", "strongest", "rms over a whole turn [µrad]")
    return Table(f"Arm {name}: the periodic error by its cycles a turn", columns, tuple(rows))


def invisible_table(name: str, arm: Mapping[str, Any]) -> Table | None:
    """What these data cannot show, and why; None where there is nothing."""
    rows = [
        (entry["effect"], short_reason(entry["reason"]), _mm(entry.get("smallest_seen_rms_mm")))
        for entry in arm["invisible"]
    ]
    if not rows:
        return None
    columns = ("effect", "why it cannot be seen", "would show from [mm rms]")
    return Table(f"Arm {name}: what these data cannot show", columns, tuple(rows))


def not_found_table(name: str, arm: Mapping[str, Any]) -> Table | None:
    """What was looked for and not found, with the smallest size that would have been; None where there is nothing."""
    rows = [
        (entry["effect"], _mm(entry["smallest_seen_rms_mm"]), f"{100.0 * entry['visible_share']:.0f}")
        for entry in arm["not_found"]
    ]
    if not rows:
        return None
    columns = ("effect", "would have been seen from [mm rms]", "visible beside the geometry [%]")
    return Table(f"Arm {name}: looked for and not found", columns, tuple(rows))


# -- sentences for the page -------------------------------------------------------------------------------------------


def rest_sentences(arm: Mapping[str, Any]) -> list[str]:
    """What remains, what a network makes of it, and how sure the model is."""
    sentences = []
    scatter, chance = arm["scatter"], arm["omnibus_p"]
    if scatter is not None and chance is not None:
        odds = "below 0.001" if chance < 0.001 else f"{chance:.2g}"
        sentences.append(
            f"What remains scatters {scatter:.2f} times as the readings state; if nothing were missing, the chance of"
            f" as much structure in it is {odds}."
        )
    found = arm["network_mm"]
    if found is not None:
        before, after = found["before"], found["after"]
        words = "finds nothing" if after == 0.0 else f"finds {after:.4f} mm rms"
        if before == after == 0.0:
            sentences.append("A residual network finds nothing that it could correct, before the effects or after.")
        elif not arm["accepted"]:
            sentences.append(f"A residual network corrects {before:.4f} mm rms of what the geometry leaves.")
        else:
            sentences.append(
                f"A residual network trained on what the geometry leaves corrects {before:.4f} mm rms; trained on what"
                f" the effects leave, it {words}."
            )
    sure = arm["uncertainty_mm"]
    if sure is not None:
        sentences.append(
            "The model knows how sure it is: at held-out configurations the standard deviation that it predicts for a"
            f" coordinate is {sure['median']:.4f} mm in the middle and {sure['largest']:.4f} mm at most. It grows where"
            " a joint range was never trained."
        )
    return sentences


def description_sentences(arm: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Heading and words of every term that has no name."""
    lines = []
    for found in arm["accepted"]:
        description = found.get("description")
        if description is None:
            continue
        variables = " and ".join(description["variables"])
        words = (
            f"It shows in the channel '{description['channel']}', depends on {variables}, and moves the SMR by"
            f" {description['size_um']:.0f} µm rms where the geometry cannot follow."
        )
        gain = description["gain_over_curve"]
        if description["formula"]:
            words += f" A short formula does as well as the curve: {description['formula']}"
            words += "." if gain is None else f" (score {gain:+.1f} against the curve's)."
        else:
            words += " No short formula does as well as the fitted curve."
        lines.append((f"No name for this: {description['channel']}, {variables}", words))
    return lines


def picture_words(picture: Mapping[str, Any]) -> str:
    """What a person sees in a picture of an effect, in figures."""
    unit = "µrad" if picture["y_label"].endswith("[urad]") else "µm"
    shown = _rms(picture["computed"])
    left = _rms([m - c for m, c in zip(picture["measured"], picture["computed"], strict=True)])
    words = f"The effect makes {shown:.0f} {unit} rms at these readings, which scatter {left:.0f} {unit} rms about it."
    curve = picture.get("curve")
    if curve is not None and curve["x"][-1] - curve["x"][0] == _TURN:
        worst = max(range(len(curve["band"])), key=curve["band"].__getitem__)
        best = min(range(len(curve["band"])), key=curve["band"].__getitem__)
        if curve["band"][worst] >= 2.0 * curve["band"][best]:
            words += (
                f" The curve is surest at {curve['x'][best]:.0f}° (standard deviation"
                f" {curve['band'][best]:.0f} {unit}) and least sure at {curve['x'][worst]:.0f}°"
                f" ({curve['band'][worst]:.0f} {unit})."
            )
        gap = _largest_gap(picture["x"])
        if gap[1] - gap[0] >= 10.0:
            end = (gap[1] + 180.0) % 360.0 - 180.0
            words += f" No reading was taken from {gap[0]:.0f}° to {end:.0f}°."
    return words


def _largest_gap(angles: Sequence[float]) -> tuple[float, float]:
    """Ends [deg] of the widest range of a turn without a value; the second may be beyond 180."""
    around = [*angles, angles[0] + 360.0]
    return max(pairwise(around), key=lambda pair: pair[1] - pair[0])


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / max(len(values), 1))


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"
