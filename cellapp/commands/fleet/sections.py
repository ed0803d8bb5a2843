"""Each arm of a fleet, and each pair's bases, as sections: sentences, charts, tables."""

from __future__ import annotations

from cellapp.commands.fleet.charts import condition_charts, effect_chart, pair_chart, parameter_charts, trend_charts
from cellapp.commands.fleet.view import arm_sentences, arm_tables, pair_sentence, pair_table
from cellapp.commands.view.parts import Part, Section, sentence
from cellapp.estimation.monitoring.fleet.records import ArmHistory, PairHistory


def arm_section(key: str, name: str, arm: ArmHistory) -> Section:
    """Show one arm over its runs; unfolded if something is wrong with it."""
    effects = effect_chart(arm)
    sentences = [line.removeprefix(f"{name}: ") for line in arm_sentences(name, arm)]
    charts = [
        *trend_charts(arm),
        *([] if effects is None else [effects]),
        *parameter_charts(arm),
        *condition_charts(arm),
    ]
    return Section(
        f"{name}: {arm.condition}",
        [*sentences, *charts, *arm_tables(name, arm)],
        arm.reasons[0] if arm.reasons else sentences[0],
        folded=arm.condition not in ("beyond tolerance", "changed", "drifting"),
        key=key,
    )


def pair_section(key: str, pair: PairHistory) -> Section:
    """Show the bases of two arms over their runs."""
    chart, table = pair_chart(pair), pair_table(pair)
    parts: list[Part] = [*([] if chart is None else [chart]), *([table] if table.rows else [])]
    return Section("Bases", parts, sentence(pair_sentence(pair)), key=key)
