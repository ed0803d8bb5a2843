"""Base of sections of a profile that got keys later."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import SerializerFunctionWrapHandler, model_serializer

from drivers.settings import Section


class GrownSection(Section):
    """A section that got keys later: profiles without them keep the JSON text, and so the hash, of earlier results."""

    later_keys: ClassVar[frozenset[str]] = frozenset()
    """Left out of the JSON where they have their defaults."""

    @model_serializer(mode="wrap")
    def _without_later_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = handler(self)
        fields = type(self).model_fields
        usual = {
            key for key in self.later_keys if getattr(self, key) == fields[key].get_default(call_default_factory=True)
        }
        return {key: value for key, value in content.items() if key not in usual}
