"""Base of all settings, and what every kind of device may use to define its own.

Settings modules import neither numpy nor a device library: loading a profile imports all of them.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema

if TYPE_CHECKING:
    from drivers.plant import Plant


class Section(BaseModel):
    """A section of a settings file: immutable; rejects unknown keys and numbers that are not finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")


class SettingError(ValueError):
    """A setting that a device cannot be opened with. The message starts with the key inside the device's section."""


class OneOf:
    """Annotation for a field that holds the settings of one of several device kinds, selected by their key ``kind``.

    ``driver: Annotated[TrackerSettings, OneOf(TRACKERS)]`` is a ``TrackerSettings`` for a type checker and the
    discriminated union of the registered kinds for pydantic.
    """

    def __init__(self, kinds: Sequence[type[Section]]) -> None:
        self.kinds = tuple(kinds)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return pydantic's schema of the union, whatever the annotated type is."""
        return handler.generate_schema(Annotated[reduce(or_, self.kinds), Field(discriminator="kind")])


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
