"""Charts of a discovery: held-out error step by step, pictures of effects, probabilities of the candidates."""

from __future__ import annotations

import numpy as np

from cellapp.commands.discover.tables import gap_steps, noise_floor, noise_floor_words
from cellapp.commands.discover.words import gap_sentences, size_sentence
from cellapp.commands.view.charts import Axis, Chart, bar_chart, drawable_mm, enumerated, mm, noise_limit, series
from cellapp.commands.view.words import probability_words
from cellapp.estimation.discovery.records import ArmDiscoveryResult, Picture
from cellapp.robot.kinematics.transforms import Array

_SMOOTH = 0.02
"""Points farther off the line between their neighbours, as a share of the range, are drawn as a cloud, not a line."""
_MOST_BARS = 8
"""Most candidates that are drawn, the most probable first: the others are all near zero."""
_BAND_SIGMAS = 2.0
"""Half width of a drawn band in standard deviations."""


def gap_chart(name: str, arm: ArmDiscoveryResult) -> Chart:
    """Show the held-out error before the search and after each step, with the noise floor."""
    steps, floor = gap_steps(arm), noise_floor(arm)
    gaps = drawable_mm([gap for _, gap in steps])
    drawn = series("held-out rms", np.arange(float(len(gaps))), gaps)
    limits = noise_limit(floor, name=noise_floor_words(arm))
    axis = Axis("held-out rms", "mm", logarithmic=True)
    message = _gap_message(arm, floor)
    return Chart(f"Arm {name}: error after each step", Axis("step"), axis, (drawn,), message, limits)


def _gap_message(arm: ArmDiscoveryResult, floor_mm: float | None) -> str:
    before, after = arm.heldout_mm.before, arm.heldout_mm.after
    floor = "" if floor_mm is None else f" The {noise_floor_words(arm)} is {mm(floor_mm)}."
    if not arm.accepted:
        return f"Held-out error is {mm(after)}; the search added no effect.{floor}"
    if after >= before:
        return f"Held-out error did not fall: {mm(before)} before, {mm(after)} after.{floor}"
    share, effect = _largest_step(arm)
    cause = f"; {effect.replace('_', ' ')} explains {'most' if share > 0.5 else f'{share:.0%}'} of it" if effect else ""
    return f"Held-out error fell from {mm(before)} to {mm(after)}{cause}.{floor}"


def _largest_step(arm: ArmDiscoveryResult) -> tuple[float, str]:
    """Return the largest share of the squared error that one effect removed, and the effect; empty if none is named."""
    total = arm.heldout_mm.before**2 - arm.heldout_mm.after**2
    taken: dict[str, float] = {}
    for before, step in zip(arm.steps, arm.steps[1:], strict=False):
        if step.effect:
            taken[step.effect] = taken.get(step.effect, 0.0) + before.heldout_mm**2 - step.heldout_mm**2
    return max(((gain / total, effect) for effect, gain in taken.items()), default=(0.0, ""))


def candidates_chart(name: str, arm: ArmDiscoveryResult) -> Chart:
    """Show the probability of each tested effect, the most probable first."""
    ordered = dict(sorted(arm.candidates.items(), key=lambda entry: -entry[1])[:_MOST_BARS])
    likely = [f"{effect.replace('_', ' ')} {probability_words(p)}" for effect, p in ordered.items() if p >= 0.05]
    message = "No probabilities were computed." if not ordered else "No effect that was tested is probable."
    if likely:
        message = f"Probable effects: {enumerated(likely)}."
    bars = {effect.replace("_", " "): (100.0 * p, probability_words(p)) for effect, p in ordered.items()}
    return bar_chart(f"Arm {name}: probability of each effect", bars, Axis("probability", "%"), message)


def picture_chart(name: str, picture: Picture) -> Chart:
    """Show measured points of one effect and the model: a curve with a band of two sigma, or points."""
    shown = picture if picture.curve is None else picture.curve
    computed = picture.computed if picture.curve is None else picture.curve.value
    line = is_line(picture)
    band = _BAND_SIGMAS * np.array(shown.band) if line and shown.band else None
    drawn = (
        series("measured", picture.x, picture.measured, "points"),
        series("computed", shown.x, computed, "line" if line else "points", band=band, style=1),
    )
    x, y = _axis(picture.x_label), _axis(picture.y_label)
    message = " ".join([size_sentence(picture), *gap_sentences(picture)])
    values = np.concatenate([picture.measured, computed])
    shown_range = typical_range(values, np.array(picture.computed)) if len(values) else None
    return Chart(f"Arm {name}: {picture_title(picture)}", x, y, drawn, message, y_range=shown_range, by_stage=True)


def is_line(picture: Picture) -> bool:
    """Return whether the computed values are a function of x, drawn as a line, and not a cloud."""
    if picture.curve is not None or len(picture.x) < 3:
        return picture.curve is not None
    x, y = np.array(picture.x), np.array(picture.computed)
    share = np.diff(x)[:-1] / np.maximum(x[2:] - x[:-2], 1e-12)
    between = y[:-2] + share * (y[2:] - y[:-2])
    return float(np.median(np.abs(y[1:-1] - between))) <= _SMOOTH * float(np.ptp(y)) + 1e-12


def picture_title(picture: Picture) -> str:
    """Return the title with the variable of the x axis, unless it is named already."""
    variable = picture.x_label.partition(" [")[0]
    if picture.title.endswith(variable) or picture.curve is not None:
        return picture.title
    names = ("joint ", "time", "azimuth", "elevation", "incidence")
    return f"{picture.title}, against {variable if variable.startswith(names) else f'the {variable}'}"


def typical_range(values: Array, always: Array) -> tuple[float, float]:
    """Return limits that leave out the farthest 1 % of ``values`` on either side, but contain all of ``always``."""
    low, high = np.quantile(values, (0.01, 0.99))
    low, high = min(float(low), float(always.min())), max(float(high), float(always.max()))
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room


def with_micro_sign(label: str) -> str:
    """Return a label with the page's units: ``[µrad]`` for ``[urad]``."""
    return label.replace("[urad]", "[µrad]").replace("[um]", "[µm]")


def _axis(label: str) -> Axis:
    words, _, unit = with_micro_sign(label).partition(" [")
    return Axis(words, unit.removesuffix("]"))
