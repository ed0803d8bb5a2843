"""What all results share: their JSON form, names of models and stages, error statistics, estimates, times."""

from __future__ import annotations

import inspect
from collections.abc import Container, Iterable, Mapping
from typing import Any, ClassVar, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, ValidationError, model_serializer

from cellapp.ground.errors import InputError

Point = tuple[float, float, float]
Matrix = tuple[tuple[float, ...], ...]

Stage = Literal["nominal", "geometry", "network", "effects"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""Models of one arm in the order in which they are built."""

Method = Literal["nominal", "method_1", "method_2", "proposed", "effects"]
METHODS: tuple[Method, ...] = get_args(Method)
"""Models of the pair; method 1, method 2 and proposed are those of Bai et al., ROBOT 45(3), 2023."""

BEST_METHODS: tuple[Method, ...] = ("effects", "proposed", "method_1", "nominal")
"""The first of these that was computed is the pair's best; method_2 is the counter-example of the paper."""


def best_method(computed: Container[Method]) -> Method | None:
    """Return the best of the methods that were computed for a pair; None if there is none."""
    return next((method for method in BEST_METHODS if method in computed), None)


DecisionRule = Literal["guarded", "simple"]
"""``guarded``: ISO 14253-1; an error conforms if it is inside the tolerance by its expanded uncertainty, and does not
conform if it is outside by it. ``simple``: the error alone is compared (ISO/IEC Guide 98-4, simple acceptance)."""

Verdict = Literal["explained", "nothing missing", "unknown effect", "ambiguous"]

StageName = Literal[
    "calibrate", "discover", "locate", "compensate", "push", "verify", "path", "iso9283", "check", "certificate"
]
ModelStage = Literal["calibrate", "discover"]
"""Stages that learn a model from the readings of a run."""
CALIBRATE: StageName = "calibrate"
DISCOVER: StageName = "discover"
LOCATE: StageName = "locate"
"""The tracker's station after it was moved; its model is that of an earlier stage in the new tracker frame."""
COMPENSATE: StageName = "compensate"
PUSH: StageName = "push"
"""Targets that were pushed without measuring them; it does not replace a verification."""
VERIFY: StageName = "verify"
PATH: StageName = "path"
"""Compensated paths."""
ISO9283: StageName = "iso9283"
CHECK: StageName = "check"
"""A few stops that show whether the calibration still holds; it measures the cell and changes no model."""
CERTIFICATE: StageName = "certificate"
STAGE_NAMES: tuple[StageName, ...] = get_args(StageName)
"""What verbs store in a run, in the order of the work."""


class Record(BaseModel):
    """A part of a result: immutable, rejects unknown keys. NaN and infinity become null in JSON."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        defer_build=True,  # a verb makes a few of the records that it imports
        ser_json_inf_nan="null",
        populate_by_name=True,
        alias_generator=lambda name: name.removesuffix("_"),  # schema_ and validate_ would hide names of pydantic
    )

    omitted_when_none: ClassVar[frozenset[str]] = frozenset()
    """Keys that are left out of the JSON object where their value is None."""

    @classmethod
    def like(cls, source: object, **given: Any) -> Self:
        """A record of what ``source`` has under the names of the fields; ``given`` are all other fields."""
        same = {name: getattr(source, name) for name in cls.model_fields if name not in given and hasattr(source, name)}
        return cls(**same, **given)

    @model_serializer(mode="wrap")
    def _without_omitted(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = handler(self)
        return {key: value for key, value in content.items() if value is not None or key not in self.omitted_when_none}


EARLIER_NOT_DECIDED = "cannot say"
"""What results of earlier versions hold for "not decided"."""


class Result(Record):
    """The result of one verb. Its head says what its JSON is: ``class GreetResult(Result, schema="cellapp-greet")``."""

    has_own_schema: ClassVar[bool] = True
    """Whether its JSON is its own; False where ``to_json`` writes something else that it holds."""

    schema_: str = ""
    version: int = 1

    def __init_subclass__(cls, schema: str = "", version: int = 1, **settings: Any) -> None:
        """Fix both keys of the subclass: another schema or version is refused."""
        super().__init_subclass__(**settings)
        if schema:
            keys = {"schema_": Literal[schema], "version": Literal[version]}
            cls.__annotations__ = keys | inspect.get_annotations(cls)
            cls.schema_, cls.version = schema, version

    def to_json(self, *, indent: int | None = None) -> str:
        """The JSON text; floats are written in their shortest exact form."""
        return self.model_dump_json(by_alias=True, indent=indent)

    @classmethod
    def from_json(cls, text: str, where: str) -> Self:
        """Read what ``to_json`` wrote; keys that only an earlier version had are ignored.

        Raises
        ------
        InputError
            If the text is not such a result; the message begins with ``where``.
        """
        try:
            return cls.model_validate_json(text.replace(f'"{EARLIER_NOT_DECIDED}"', '"not decided"'), extra="ignore")
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(part) for part in first["loc"])
            raise InputError(
                f"{where}: {key or 'text'}: {first['msg']}; another version of cellapp wrote it, repeat that step"
            ) from None


class ErrorResult(Result, schema="cellapp-error"):
    """Why a command failed, where ``--json -`` asks for JSON: its exit code and the sentence that a person gets."""

    exit_code: int
    message: str


class ErrorSummary(Record):
    """Statistics of n error magnitudes [mm, mrad]; ``mean_ci95`` is a bootstrap 95 % interval of the mean."""

    mean: float
    rms: float
    std: float
    max: float
    p50: float | None = None
    p95: float | None = None
    mean_ci95: tuple[float, float] | None = None
    n: int
    omitted_when_none = frozenset({"p50", "p95", "mean_ci95"})


class StageErrors(Record):
    """Held-out errors of one model of an arm: absolute, and ISO 9283 distance errors of all pairs of points.

    ``orientation_mrad`` are the angles between measured and computed orientations, of a probe that measures them.
    """

    position_mm: ErrorSummary
    orientation_mrad: ErrorSummary | None = None
    distance_mm: ErrorSummary | None = None
    omitted_when_none = frozenset({"orientation_mrad", "distance_mm"})


class Estimate(Record):
    """An estimated parameter with its standard error, both in ``unit``."""

    value: float
    standard_error: float | None
    unit: str

    @classmethod
    def by_name(
        cls, names: Iterable[str], values: Iterable[float], errors: Iterable[float], units: Iterable[str]
    ) -> dict[str, Estimate]:
        """Return estimates by their names."""
        found = zip(names, values, errors, units, strict=True)
        return {name: Estimate(value=value, standard_error=error, unit=unit) for name, value, error, unit in found}


class Provenance(Record):
    """Which program made a result, from which profile, when (ISO 8601, UTC).

    ``torch`` is in results of earlier versions, which trained networks with it.
    """

    profile: str
    seed: int
    program: str
    python: str | None = None
    numpy: str | None = None
    torch: str | None = None
    written: str
    omitted_when_none = frozenset({"python", "numpy", "torch"})


# -- Plain data -------------------------------------------------------------------------------------------------------


def plain_data(value: Any) -> Any:
    """Mappings as dict, sequences and arrays as list, numpy's numbers as those of Python; other values as they are."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(part) for part in value]
    return value.tolist() if hasattr(value, "tolist") else value


# -- Times (ISO 8601 texts, in UTC) as people read them ---------------------------------------------------------------


_DAY, _MINUTE, _SECOND = (len(example) for example in ("2026-01-02", "2026-01-02T03:04", "2026-01-02T03:04:05"))


def day_of(time: str) -> str:
    """The date alone, such as "2026-01-02"."""
    return time[:_DAY]


def minute_of(time: str) -> str:
    """Date and time to the minute, such as "2026-01-02 03:04"."""
    return time[:_MINUTE].replace("T", " ")


def second_of(time: str) -> str:
    """Date and time to the second, such as "2026-01-02 03:04:05"."""
    return time[:_SECOND].replace("T", " ")
