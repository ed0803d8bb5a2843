"""Request of the verb ``iso9283``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from cellapp.commands.record import Asked, OutOfDate, Request, Stored, Variant, Verb
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS, NORM_CYCLES, NORM_DRIFT_MIN, IsoCommands, IsoTest

_HELP: Mapping[IsoTest, str] = {
    "pose": "Pose accuracy AP and repeatability RP at five poses of the norm's cube.",
    "multidirectional": "Variation of pose accuracy vAP from three directions of approach.",
    "distance": "Distance accuracy AD and repeatability RD.",
    "drift": "Drift of pose accuracy dAP and repeatability dRP while the arm warms up.",
    "path": "Path accuracy AT and repeatability RT, velocity AV, RV, FV, along a line and circles.",
    "cooperative": "Accuracy and repeatability between the SMRs of two arms.",
}


def _kinds(given: Any) -> Any:
    """Return the kinds of commands that one word names; refuse none."""
    if given == ():
        raise ValueError("at least one is needed; none is marked")
    return ISO_COMMANDS if given == "both" else (given,) if isinstance(given, str) else given


def _percents(values: tuple[float, ...]) -> tuple[float, ...]:
    for value in values:
        if not 0.0 < value <= 100.0:
            raise ValueError(f"expected shares above 0 % and up to 100 %, got {value:g} %")
    return values


class Iso9283Request(Request):
    """Test pose accuracy and more by ISO 9283: 'cellapp iso9283 PROFILE' makes all tests."""

    profile: Annotated[Path | None, Asked("The cell, as YAML; --run knows its own.", "PROFILE", argument=True)] = None
    """None: that of the run in ``folder``."""
    folder: Annotated[
        Path | None, Asked("The run whose calibration is tested; with --nominal also a new one.", "DIR", option="--run")
    ] = None
    nominal: Annotated[
        bool,
        Asked(
            "Command by the published geometry alone, also where there is no calibration; makes the run if need be.",
            label="nominal alone",
            hint="without calibration",
        ),
    ] = False
    tests: Annotated[
        tuple[IsoTest, ...],
        Field(min_length=1),
        Asked(
            "Tests that are made.",
            label="tests",
            words={
                "pose": "pose: AP, RP",
                "multidirectional": "directions: vAP",
                "distance": "distance: AD, RD",
                "drift": "drift: dAP, dRP",
                "path": "path: AT, RT",
                "cooperative": "both arms together",
            },
        ),
    ] = ISO_TESTS
    cycles: Annotated[
        int,
        Field(ge=2, le=1000),
        Asked(
            f"Cycles of each test; the norm's number is {NORM_CYCLES['pose']}.",
            "N",
            label="cycles",
            hint=f"{NORM_CYCLES['pose']} by the norm",
        ),
    ] = NORM_CYCLES["pose"]
    speed: Annotated[
        float,
        Field(gt=0.0, le=100.0, allow_inf_nan=False),
        Asked(
            "Of the speed that the profile allows.",
            "PERCENT",
            label="speed",
            unit="%",
            hint="of the speed that the profile allows",
        ),
    ] = 100.0
    also_speeds: Annotated[
        tuple[float, ...],
        AfterValidator(_percents),
        Asked(
            "Repeat pose and path tests at this speed, in percent; may be repeated. The norm also has 50 and 10.",
            "PERCENT",
            option="--also-speed",
            label="again at",
            unit="%",
            hint="50, 10",
        ),
    ] = ()
    arms: Annotated[
        tuple[str, ...], Asked("Only this arm; may be repeated.", "NAME", option="--arm", label="only arm")
    ] = ()
    commands: Annotated[
        tuple[IsoCommands, ...] | None,
        BeforeValidator(_kinds),
        Asked(
            "Nominal commands (as found), calibrated ones (as left); both if calibrated.",
            option="--with",
            typed=Literal["nominal", "calibrated", "both"] | None,
            label="commanded by the model",
            words={"nominal": "nominal, as found", "calibrated": "calibrated, as left"},
        ),
    ] = None
    drift_minutes: Annotated[
        float,
        Field(gt=0.0, le=2.0 * NORM_DRIFT_MIN, allow_inf_nan=False),
        Asked(
            f"How long drift is observed; the norm's time is {NORM_DRIFT_MIN:g}.",
            "MIN",
            label="drift for",
            unit="min",
            hint=f"{NORM_DRIFT_MIN:g} by the norm",
        ),
    ] = 60.0
    """Of the norm's 480 minutes: most of a warm-up shows in the first hour."""
    out_of_date: OutOfDate = False

    @model_validator(mode="after")
    def _a_cell(self) -> Iso9283Request:
        if self.profile is None and self.folder is None:
            raise ValueError("a profile is needed, or the folder of a run")
        return self


VERB = Verb(
    "iso9283",
    Iso9283Request,
    chapter="iso9283",
    moves_arms=True,
    question="Measure by ISO 9283?",
    variants={"all": Variant("All tests; this word may be left out.", {"tests": ISO_TESTS})}
    | {test: Variant(_HELP[test], {"tests": (test,)}) for test in ISO_TESTS},
    stored=(Stored("iso9283", "no test by ISO 9283 is", ("iso9283",)),),
)
