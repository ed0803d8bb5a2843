"""Real-Time Data Exchange, protocol version 2: recipes, stream of states, registers written by clients.

An input belongs to the connection that first claimed it until that connection ends; it keeps its last value.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Literal

from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.variables import E_SERIES_OUTPUTS, INPUTS, OUTPUTS, layout, width

_HEADER = struct.Struct(">HB")
_VERSION, _CONTROLLER_VERSION, _TEXT = ord("V"), ord("v"), ord("M")
_OUTPUTS, _INPUTS, _START, _PAUSE, _DATA = ord("O"), ord("I"), ord("S"), ord("P"), ord("U")
_PROTOCOL = 2
_MAX_RECIPES = 255
_LARGEST = 65535
"""Largest package [bytes]: its length is a 16-bit number."""
_POSES = frozenset({"actual_TCP_pose", "actual_TCP_speed", "target_TCP_pose", "target_TCP_speed"})


@dataclass(frozen=True)
class _Recipe:
    number: int
    names: tuple[str, ...]
    layout: struct.Struct
    widths: tuple[int, ...] = ()


class RtdeServer:
    """State shared by the connections to one controller: the owners of inputs, and the reaction to short packets.

    Attributes
    ----------
    short_packets : str
        Reaction to a data packet of the wrong length: "swallow" it or "close" the connection.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.short_packets: Literal["swallow", "close"] = "swallow"
        self._owners: dict[str, RtdeSession] = {}
        e_series = controller.config.personality.series == "e-Series"
        self.outputs = OUTPUTS | E_SERIES_OUTPUTS if e_series else OUTPUTS

    def claim(self, names: Sequence[str], session: RtdeSession) -> list[str]:
        """Claim all inputs for a connection or none; return their types, or for a name why it cannot be claimed."""
        types = [INPUTS.get(name, "NOT_FOUND") for name in names]
        for i, name in enumerate(names):
            if types[i] != "NOT_FOUND" and self._owners.get(name, session) is not session:
                types[i] = "IN_USE"
        if not {"NOT_FOUND", "IN_USE"} & set(types):
            self._owners |= dict.fromkeys(names, session)
        return types

    def release(self, session: RtdeSession) -> None:
        """Free the inputs of a connection that has ended."""
        self._owners = {name: owner for name, owner in self._owners.items() if owner is not session}


class RtdeSession:
    """One connection. ``send`` and ``stream`` carry answers and states to the client, ``close`` ends the connection."""

    def __init__(
        self,
        server: RtdeServer,
        send: Callable[[bytes], None],
        stream: Callable[[bytes], None],
        close: Callable[[], None],
    ) -> None:
        self._server = server
        self._send, self._stream, self._close = send, stream, close
        self._received = bytearray()
        self._version_agreed = False
        self._streaming = False
        self._output: _Recipe | None = None
        self._inputs: dict[int, _Recipe] = {}
        self._every_s = 0.0
        self._credit = 0.0
        self._share = 1.0
        self._poses = False
        self._over = False

    def received(self, data: bytes) -> None:
        """Process bytes from the client."""
        self._received += data
        while not self._over and len(self._received) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._received)
            if size < _HEADER.size:
                self._close()
                return
            if len(self._received) < size:
                return
            payload = bytes(self._received[_HEADER.size : size])
            del self._received[:size]
            self._package(kind, payload)

    def closed(self) -> None:
        """Free the inputs of this connection."""
        self._over = True
        self._server.release(self)

    def cycle(self) -> None:
        """Send the state of this control cycle if the requested frequency requires it."""
        if not self._streaming or self._output is None:
            return
        self._credit += self._share
        if self._credit < 1.0 - 1e-9:
            return
        self._credit -= 1.0
        if self._poses:
            self._server.controller.refresh_poses()
        values = self._server.controller.values
        recipe = self._output
        packed = recipe.layout.pack(*chain.from_iterable([values[name] for name in recipe.names]))
        self._stream(_HEADER.pack(4 + len(packed), _DATA) + bytes((recipe.number,)) + packed)

    # ----------------------------------------------------------------------------------------------------------------

    def _reply(self, kind: int, payload: bytes) -> None:
        self._send(_HEADER.pack(_HEADER.size + len(payload), kind) + payload)

    def _warn(self, text: str) -> None:
        """Send a warning for the client's log."""
        message, source = text.encode()[:255], b"RTDE"
        self._reply(_TEXT, bytes((len(message),)) + message + bytes((len(source),)) + source + b"\x02")

    def _package(self, kind: int, payload: bytes) -> None:
        if kind == _DATA:
            self._data(payload)
        elif kind == _VERSION:
            self._version_agreed = payload == struct.pack(">H", _PROTOCOL)
            self._reply(_VERSION, bytes((self._version_agreed,)))
        elif kind == _CONTROLLER_VERSION:
            self._reply(_CONTROLLER_VERSION, struct.pack(">4I", *self._server.controller.config.personality.version))
        elif kind in (_OUTPUTS, _INPUTS) and not self._version_agreed:
            self._warn("only protocol version 2 is supported; request it first")
            self._close()
        elif kind == _OUTPUTS:
            self._set_outputs(payload)
        elif kind == _INPUTS:
            self._set_inputs(payload)
        elif kind == _START:
            self._streaming = self._output is not None
            self._credit = 1.0
            self._reply(_START, bytes((self._streaming,)))
        elif kind == _PAUSE:
            self._streaming = False
            self._reply(_PAUSE, b"\x01")
        elif kind != _TEXT:
            self._warn(f"unknown package type {kind}")

    def _set_outputs(self, payload: bytes) -> None:
        controller = self._server.controller
        if len(payload) < 8:
            self._warn("the frequency of the outputs is missing")
            return
        (frequency,) = struct.unpack_from(">d", payload)
        names = _split(payload[8:])
        types = [self._server.outputs.get(name, "NOT_FOUND") for name in names]
        rate_hz = controller.config.personality.rate_hz
        good = bool(names) and "NOT_FOUND" not in types and frequency > 0.0
        recipe = _Recipe(1, tuple(names), layout(types)) if good else None
        if recipe is not None and _HEADER.size + 1 + recipe.layout.size > _LARGEST:
            recipe, good = None, False
            controller.log.append(f"RTDE: outputs refused: they take more than the {_LARGEST} bytes of a package")
        self._output = recipe
        self._streaming = self._streaming and good
        self._share = min(frequency / rate_hz, 1.0) if good else 1.0
        self._poses = bool(_POSES & set(names))
        self._reply_recipe(_OUTPUTS, int(good), types)

    def _set_inputs(self, payload: bytes) -> None:
        names = _split(payload)
        full = len(self._inputs) >= _MAX_RECIPES
        types = ["IN_USE"] * len(names) if full else self._server.claim(names, self)
        number = 0
        if names and not {"NOT_FOUND", "IN_USE"} & set(types):
            number = len(self._inputs) + 1
            self._inputs[number] = _Recipe(number, tuple(names), layout(types), tuple(map(width, types)))
        self._reply_recipe(_INPUTS, number, types)

    def _reply_recipe(self, kind: int, number: int, types: Sequence[str]) -> None:
        """Answer with the recipe's number (0 if refused) and as many of the types as a package can hold."""
        text = ",".join(types).encode()
        if len(text) > _LARGEST - _HEADER.size - 1:
            text = text[: text.rfind(b",", 0, _LARGEST - _HEADER.size)]
        self._reply(kind, bytes((number,)) + text)

    def _data(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None or len(payload) - 1 != recipe.layout.size:
            controller = self._server.controller
            expected = "no such recipe" if recipe is None else f"expected {recipe.layout.size}"
            controller.log.append(f"RTDE: data of {max(len(payload) - 1, 0)} bytes ignored: {expected}")
            if self._server.short_packets == "close":
                self._close()
            return
        values = recipe.layout.unpack_from(payload, 1)
        at = 0
        for name, count in zip(recipe.names, recipe.widths, strict=True):
            self._server.controller.write_input(name, values[at : at + count])
            at += count


def _split(names: bytes) -> list[str]:
    """Split a list of names that may end in a comma."""
    return [name.strip() for name in names.decode("ascii", errors="replace").split(",") if name.strip()]
