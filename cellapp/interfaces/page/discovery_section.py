"""The page's section on discovery: one part for each arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from cellapp.commands.calibrate.charts_accuracy import certainty_chart
from cellapp.commands.discover.charts import gap_chart, picture_chart
from cellapp.commands.discover.tables import (
    accepted_table,
    candidates_table,
    cycle_table,
    invisible_table,
    not_found_table,
    numbered_steps_table,
    parameter_table,
    structure_table,
)
from cellapp.commands.discover.words import (
    contradiction_sentences,
    description_sentences,
    misfit_sentences,
    picture_words,
    remainder_sentences,
    rival_sentences,
    size_words,
    undrawn_sentences,
    verdict_sentence,
)
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import place_words
from cellapp.estimation.discovery.records import ArmDiscoveryResult, DiscoverResult, Picture
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_figure import chart_figure
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class MeaningPart:
    """What an accepted effect means: a heading, cause, usual size, what to check, what would settle it."""

    heading: str
    cause: str
    size: str
    check: tuple[str, ...]
    settle: tuple[str, ...]


@dataclass(frozen=True)
class ArmSection:
    """Verdict, steps, accepted effects with figures, undetectable effects and the remainder of one arm."""

    name: str
    verdict: str
    sentence: str
    steps_figure: CaptionedFigure
    steps_table: Table
    tables: tuple[Table, ...]
    remarks: tuple[str, ...]
    meanings: tuple[MeaningPart, ...]
    descriptions: tuple[tuple[str, str], ...]
    pictures: tuple[CaptionedFigure, ...]
    joint_curves: tuple[CaptionedFigure, ...]
    undetected: tuple[Table, ...]
    remainder: tuple[str, ...]


def arm_sections(
    discover: DiscoverResult,
    predicted: Mapping[str, tuple[Array, Array, float]],
    joint_curves: Mapping[str, tuple[CaptionedFigure, ...]],
) -> list[ArmSection]:
    """One section for each arm.

    ``predicted`` has the predicted standard deviation of a coordinate, the position error (n,) and noise [mm] of each
    held-out configuration, for arms whose model predicts one; ``joint_curves`` what its effects turn each joint by.
    """
    sections = []
    for number, (name, arm) in enumerate(discover.arms.items(), start=1):
        tables = (accepted_table(name, arm), parameter_table(name, arm), cycle_table(name, arm))
        certainty = [certainty_chart(name, *predicted[name])] if name in predicted else []
        undetected = (
            invisible_table(name, arm),
            not_found_table(name, arm),
            candidates_table(name, arm),
            structure_table(name, arm),
        )
        sections.append(
            ArmSection(
                name=name,
                verdict=arm.verdict,
                sentence=verdict_sentence(name, arm),
                steps_figure=_steps_figure(number, name, arm),
                steps_table=numbered_steps_table(name, arm),
                tables=tuple(table for table in tables if table is not None),
                remarks=(
                    *contradiction_sentences(arm),
                    *rival_sentences(arm),
                    *misfit_sentences(arm),
                    *undrawn_sentences(arm),
                ),
                meanings=_meanings(arm),
                descriptions=tuple(description_sentences(arm)),
                pictures=(
                    *_effect_figures(number, name, arm.pictures),
                    *(chart_figure(f"certainty{number}", chart) for chart in certainty),
                ),
                joint_curves=joint_curves[name],
                undetected=tuple(table for table in undetected if table is not None),
                remainder=tuple(remainder_sentences(arm)),
            )
        )
    return sections


def _meanings(arm: ArmDiscoveryResult) -> tuple[MeaningPart, ...]:
    return tuple(
        MeaningPart(
            heading=f"{found.title}, {place_words(found.where)}",
            cause=found.meaning.cause,
            size=size_words(found.meaning),
            check=found.meaning.check,
            settle=found.meaning.settle,
        )
        for found in arm.accepted
        if found.meaning is not None
    )


def _steps_figure(number: int, name: str, arm: ArmDiscoveryResult) -> CaptionedFigure:
    return chart_figure(f"gap{number}", gap_chart(name, arm))


def _effect_figures(number: int, name: str, pictures: Sequence[Picture]) -> list[CaptionedFigure]:
    return [
        replace(chart_figure(f"effect{number}-{place}", picture_chart(name, picture)), note=picture_words(picture))
        for place, picture in enumerate(pictures, start=1)
    ]
