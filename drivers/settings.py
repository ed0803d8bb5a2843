"""Base of all settings, and helpers for every kind of device to define its own.

Settings modules import neither numpy nor a device library: loading a profile imports all of them.
"""

from __future__ import annotations

import inspect
import ipaddress
from collections.abc import Callable, Sequence
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from drivers.plugins import Registry

if TYPE_CHECKING:
    from drivers.plant import Plant


class Section(BaseModel):
    """A section of a settings file: immutable; rejects unknown keys and numbers that are not finite."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants", defer_build=True
    )


class SettingError(ValueError):
    """A setting with which a device cannot be opened. The message starts with the key inside the device's section."""


S = TypeVar("S", bound=Section)


def device_kinds(group: str, what: str, base: type[S], built_in: Sequence[type[S]]) -> Registry[type[S]]:
    """Return the registry of the settings of device kinds by their key ``kind``; see ``drivers.plugins.Registry``."""
    return Registry(group, what, {str(one.model_fields["kind"].default): one for one in built_in}, _accept(base))


def _accept(base: type[S]) -> Callable[[str, object], type[S]]:
    def accept(name: str, found: object) -> type[S]:
        if not (isinstance(found, type) and issubclass(found, base)):
            raise ValueError(f"expected a class made from {base.__module__}.{base.__name__}, got {found!r}")
        lacking = sorted(getattr(found, "__abstractmethods__", ()))
        if inspect.isabstract(found):
            raise ValueError(f"class {found.__name__} lacks {', '.join(lacking)}")
        field = found.model_fields["kind"]
        if get_args(field.annotation) != (name,) or field.default != name:
            raise ValueError(f'class {found.__name__} needs the line \'kind: Literal["{name}"] = "{name}"\'')
        found.model_rebuild()  # report an annotation that cannot be resolved here, not with the whole profile
        return found

    return accept


class OneOf:
    """Annotation for a field that contains the settings of one of several device kinds, selected by their key ``kind``.

    ``driver: Annotated[TrackerSettings, OneOf(TRACKERS)]`` is a ``TrackerSettings`` for a type checker and the
    discriminated union of the registered kinds for pydantic. A section with such a field sets ``defer_build``: its
    schema is then built at first use, and not while modules of plug-ins may still be only partly imported.
    """

    def __init__(self, registry: Registry[type[S]]) -> None:
        self.registry: Registry[Any] = registry

    @property
    def kinds(self) -> tuple[type[Section], ...]:
        """The settings of all kinds."""
        return tuple(self.registry.values())

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return pydantic's schema of the union, whatever the annotated type is."""
        union = handler.generate_schema(Annotated[reduce(or_, self.kinds), Field(discriminator="kind")])
        return core_schema.no_info_before_validator_function(self._not_refused, union)

    def _not_refused(self, value: object) -> object:
        """Raise ``ValueError`` if a plug-in with the wanted kind is not used; else pydantic lists the known kinds."""
        kind = value.get("kind") if isinstance(value, dict) else None
        if isinstance(kind, str) and (refusal := self.registry.refusal(kind)):
            raise ValueError(f"kind: {refusal}")
        return value


def simulated_cell(plant: Plant | None) -> Plant:
    """Return the plant that a simulated device belongs to. Raises ``SettingError`` if there is none."""
    if plant is None:
        raise SettingError("driver: a simulated device needs the profile's section 'plant'")
    return plant


def loopback_ipv4(host: str) -> str | None:
    """Return the IPv4 address of ``host`` if it is a loopback address or "localhost", else None."""
    if host == "localhost":
        return "127.0.0.1"
    try:
        return host if ipaddress.IPv4Address(host).is_loopback else None
    except ValueError:
        return None
