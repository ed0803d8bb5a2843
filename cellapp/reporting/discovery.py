"""The page's section on discovery: one part an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.kinematics.transforms import Array
from cellapp.reporting.drawing import Drawing
from cellapp.reporting.findings import (
    accepted_table,
    cycle_table,
    description_sentences,
    gap_steps,
    gap_table,
    invisible_table,
    noise_floor,
    not_found_table,
    own_sentence,
    parameter_table,
    picture_words,
    rest_sentences,
    told_from,
)
from cellapp.reporting.table import Table
from cellapp.reporting.words import ranges


@dataclass(frozen=True)
class ArmSection:
    """What the page shows of one arm: verdict, the gap, effects, their pictures, what is unseen, what remains."""

    name: str
    verdict: str
    sentence: str
    gap: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    remarks: tuple[str, ...]
    descriptions: tuple[tuple[str, str], ...]
    pictures: tuple[Drawing, ...]
    unseen: tuple[Table, ...]
    rest: tuple[str, ...]


def arm_sections(discover: Mapping[str, Any], held_out: Mapping[str, tuple[Array, Array]]) -> list[ArmSection]:
    """One section an arm, from the object of ``discover --json``.

    ``held_out`` has the predicted standard deviation of a coordinate and the position error (n,) [mm] of each held-out
    configuration, for the arms whose model predicts one.
    """
    sections = []
    for number, (name, arm) in enumerate(discover["arms"].items(), start=1):
        tables = (
            gap_table(name, arm),
            accepted_table(name, arm),
            parameter_table(name, arm),
            cycle_table(name, arm),
        )
        certainty = [_certainty(number, name, *held_out[name])] if name in held_out else []
        unseen = (invisible_table(name, arm), not_found_table(name, arm))
        sections.append(
            ArmSection(
                name=name,
                verdict=arm["verdict"],
                sentence=own_sentence(name, arm),
                gap=(_gap(number, name, arm),),
                tables=tuple(table for table in tables if table is not None),
                remarks=(*_rivals(arm), *_feeble(arm)),
                descriptions=tuple(description_sentences(arm)),
                pictures=(*_pictures(number, name, arm["pictures"]), *certainty),
                unseen=tuple(table for table in unseen if table is not None),
                rest=tuple(rest_sentences(arm)),
            )
        )
    return sections


def _gap(number: int, name: str, arm: Mapping[str, Any]) -> Drawing:
    from cellapp.reporting import figures

    steps, floor = gap_steps(arm), noise_floor(arm)
    legend = [("geometry", "held-out rms after each step; the table says what was done")]
    if floor is not None:
        legend.append(("floor", f"noise floor, {floor:.4f} mm"))
    return Drawing(
        figures.steps_figure(f"gap{number}", np.array([gap for _, gap in steps]), floor),
        f"Arm {name}: how the gap shrank on configurations that the search did not see",
        tuple(legend),
    )


def _rivals(arm: Mapping[str, Any]) -> list[str]:
    """What else would do in an effect's place, and what was told apart from it."""
    lines = []
    for found in arm["accepted"]:
        kept, apart = told_from(found)
        if kept:
            lines.append(
                f"In the place of {found['effect']}, {' or '.join(kept)} would do as well: these data cannot tell"
                f" {'it' if len(kept) == 1 else 'them'} apart. It is the answer set that is found, not its first name."
            )
        if apart:
            lines.append(f"Nearly as good as {found['effect']}, but told apart from it: {', '.join(apart)}.")
    return lines


def _feeble(arm: Mapping[str, Any]) -> list[str]:
    """Joints of an effect that have no picture."""
    lines = []
    for found in arm["accepted"]:
        drawn = [picture["y_label"] for picture in arm["pictures"] if picture["effect"] == found["effect"]]
        missing = [joint for joint in found["where"]["joints"] if f"offset of joint {joint} [urad]" not in drawn]
        if missing:
            which = f"joints {ranges(missing)}" if len(missing) > 1 else f"joint {missing[0]}"
            lines.append(f"There is no picture of {found['effect']} for {which}: the SMR hardly moves with it.")
    return lines


def _pictures(number: int, name: str, pictures: Sequence[Mapping[str, Any]]) -> list[Drawing]:
    from cellapp.reporting import figures

    drawings = []
    for place, picture in enumerate(pictures, start=1):
        curve = picture["curve"]
        seen = figures.Seen(
            x=np.array(picture["x"]),
            measured=np.array(picture["measured"]),
            computed=np.array(picture["computed"]),
            band=np.array(picture["band"]),
            curve=None if curve is None else (np.array(curve["x"]), np.array(curve["value"]), np.array(curve["band"])),
        )
        legend = [("measured", "measured, all else taken away")]
        if seen.is_line:
            legend.append(("computed", "computed"))
            if curve is not None or len(seen.band):
                legend.append(("band", "two standard deviations to either side"))
        else:
            legend.append(("effects", "computed"))
        against = picture["x_label"].partition(" [")[0]
        plain = picture["title"].endswith(against) or picture["curve"] is not None
        ending = "" if plain else f", against {_with_article(against)}"
        drawings.append(
            Drawing(
                figures.effect_figure(f"seen{number}-{place}", seen, picture["x_label"], picture["y_label"]),
                f"Arm {name}: {picture['title']}{ending}",
                tuple(legend),
                note=picture_words(picture),
            )
        )
    return drawings


def _with_article(words: str) -> str:
    return words if words.startswith(("joint ", "time", "azimuth", "elevation", "incidence")) else f"the {words}"


def _certainty(number: int, name: str, predicted_mm: Array, errors_mm: Array) -> Drawing:
    from cellapp.reporting import figures

    return Drawing(
        figures.certainty_figure(f"certainty{number}", predicted_mm, errors_mm),
        f"Arm {name}: position error against how unsure the model is",
        (
            ("effects", "one held-out configuration"),
            ("floor", "where the error is as large as predicted (rms of all three coordinates)"),
        ),
    )
