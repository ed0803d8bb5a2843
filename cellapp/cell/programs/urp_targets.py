"""Read the targets of a PolyScope program (``.urp``): the joint positions of its waypoints.

A ``.urp`` is gzipped XML. A fixed ``Waypoint`` has ``position/JointAngles`` and the ``Kinematics`` of the arm on which
it was taught; PolyScope computes its pose from both ("URP Syntax", a description of the format by funh of Universal
Robots, 2025). Its TCP moves with the flange, so that correcting the joint positions corrects the pose.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from cellapp.cell.programs.script_targets import six
from cellapp.cell.programs.targets import LeftMotion, Place, ProgramTarget, ReadProgram
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.plain_dh import same_chain
from cellapp.robot.kinematics.transforms import Array

_LARGEST = 32 * 1024 * 1024
"""Maximum size of the unpacked XML [bytes]: a program of a thousand waypoints has about one MB."""
_GZIP = 31
_MOVES = re.compile(r"\b(?:move[jlpc]|servo[jcl])\s*\(")
_NUMBER = re.compile(r"[^,\s]+")


def read_urp(data: bytes, where: str, table: Array, published: Array) -> ReadProgram:
    """Read the waypoints of a ``.urp`` file.

    Parameters
    ----------
    data : bytes
    where : str
        Name of the file for messages.
    table : array, shape (6, 4)
        theta, d, a, alpha of the controller's computations; a waypoint taught on another chain is refused.
    published : array, shape (6, 4)
        Published rows; they differ from ``table`` if the controller has its own calibration.

    Raises
    ------
    InputError
        If it is not a ``.urp``, too large, or contains a document type or an entity.
    """
    xml = _unpacked(data, where)
    reader = _Reader(xml, table, published)
    parser = expat.ParserCreate("UTF-8")
    parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)

    def refuse(*_: object) -> NoReturn:
        raise InputError(f"{where}:{parser.CurrentLineNumber}: a document type or entity; no program needs one")

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse
    parser.StartElementHandler = lambda tag, values: reader.start(
        tag, values, parser.CurrentByteIndex, parser.CurrentLineNumber
    )
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = reader.characters
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as error:
        raise InputError(f"{where}:{error.lineno}: not XML ({expat.ErrorString(error.code)})") from None
    if reader.root != "URProgram":
        raise InputError(f"{where}: no PolyScope program: its XML is '{reader.root}' instead of 'URProgram'")
    return ReadProgram(
        text=xml.decode("latin-1"),  # one character per byte: places count bytes
        targets=tuple(reader.targets),
        left=tuple(reader.left),
        payload_kg=None,
        encode=lambda changed: gzip.compress(changed.encode("latin-1"), mtime=0),
        notes=("PolyScope compares a checksum (crcValue) when it loads the program; save it there once",),
    )


def _unpacked(data: bytes, where: str) -> bytes:
    unpacker = zlib.decompressobj(_GZIP)
    try:
        xml = unpacker.decompress(data, _LARGEST)
    except zlib.error:
        raise InputError(f"{where}: no PolyScope program: it is not packed by gzip") from None
    if unpacker.unconsumed_tail:
        raise InputError(f"{where}: unpacked it has more than {_LARGEST // 2**20} MB; no program has")
    if not unpacker.eof:
        raise InputError(f"{where}: the file ends too early; copy it again")
    return xml


@dataclass
class _Waypoint:
    """Waypoint while it is being read."""

    name: str
    kind: str
    line: int
    angles: str = ""
    span: tuple[int, int] = (0, 0)
    own_pose: bool = False
    chain: dict[str, str] = field(default_factory=dict)
    status: str = ""


class _Reader:
    """Collects waypoints and scripts during XML parsing."""

    def __init__(self, xml: bytes, table: Array, published: Array) -> None:
        self._xml, self._table, self._published = xml, table, published
        self.root, self.targets, self.left = "", list[ProgramTarget](), list[LeftMotion]()
        self._waypoint: _Waypoint | None = None
        self._move: list[str] = []
        self._script: list[str] | None = None
        self._script_line = 0

    def start(self, tag: str, values: Mapping[str, str], index: int, line: int) -> None:
        """Handle the start of an element at byte ``index``."""
        self.root = self.root or tag
        waypoint = self._waypoint
        if tag == "Move":
            self._move.append(values.get("motionType", "Move"))
        elif tag == "Waypoint":
            self._waypoint = _Waypoint(values.get("name", "?"), values.get("type", ""), line)
        elif tag in ("cachedContents", "script"):
            self._script, self._script_line = [], line
        elif waypoint is None:
            return
        elif tag == "JointAngles" and "angles" in values:
            waypoint.angles, waypoint.span = values["angles"], self._attribute(index, "angles")
        elif tag == "position" and "joints" in values:
            waypoint.angles, waypoint.span = values["joints"], self._attribute(index, "joints")
            waypoint.own_pose = "pose" in values
        elif tag == "Kinematics":
            waypoint.status = values.get("status", "")
        elif tag in ("deltaTheta", "a", "d", "alpha"):
            waypoint.chain[tag] = values.get("value", "")

    def end(self, tag: str) -> None:
        """Handle the end of an element."""
        if tag == "Move" and self._move:
            self._move.pop()
        elif tag == "Waypoint" and self._waypoint is not None:
            self._add(self._waypoint)
            self._waypoint = None
        elif tag in ("cachedContents", "script") and self._script is not None:
            if found := _MOVES.search("".join(self._script)):
                what = found.group().rstrip("( \t\n")
                reason = "script text within the .urp is not read; correct the .script file"
                self.left.append(LeftMotion(self._script_line, what, reason))
            self._script = None

    def characters(self, text: str) -> None:
        """Handle text, which matters in scripts only."""
        if self._script is not None:
            self._script.append(text)

    def _attribute(self, index: int, name: str) -> tuple[int, int]:
        """Return the place of an attribute's value in the XML."""
        found = re.compile(rb"\b" + name.encode() + rb"\s*=\s*(\"([^\"]*)\"|'([^']*)')").search(self._xml, index)
        assert found is not None  # the parser saw it there
        return found.start(1) + 1, found.end(1) - 1

    def _add(self, waypoint: _Waypoint) -> None:
        command = f"{self._move[-1] if self._move else 'Move'} {waypoint.name}"
        numbers = _numbers(waypoint.angles)
        reason = ""
        if waypoint.kind not in ("", "Fixed"):
            reason = f"a waypoint of type {waypoint.kind}: its target is known only while the program runs"
        elif len(numbers) != 6 or not np.isfinite(numbers).all():
            reason = "the waypoint has no six joint positions"
        elif waypoint.own_pose:
            reason = "an older form of file, with a pose of its own; save it by PolyScope 5"
        elif not self._is_the_controllers(waypoint):
            expected = "another one than that in arms.*.factory of the profile,"
            if np.array_equal(self._table, self._published):
                expected = "not on the published table"
            reason = (
                f"it was taught on a controller with a calibration of its own, {expected} that this correction is for;"
                " 'cellapp doctor PROFILE --controllers DIR' writes that of the controller"
            )
        if reason:
            self.left.append(LeftMotion(waypoint.line, command, reason))
            return
        first, last = waypoint.span
        spans = tuple(
            (first + found.start(), first + found.end())
            for found in _NUMBER.finditer(self._xml[first:last].decode("latin-1"))
        )
        self.targets.append(
            ProgramTarget(
                line=waypoint.line,
                command=command,
                kind="joints",
                numbers=six(numbers),
                tcp=None,
                near=None,
                function="",
                place=Place(first, last, spans),
            )
        )

    def _is_the_controllers(self, waypoint: _Waypoint) -> bool:
        """Return whether a waypoint's chain, if stated, is that of the controller."""
        if not waypoint.chain or waypoint.status in ("NOT_INITIALIZED", "NOT_LINEARIZED"):
            return True
        columns = [_numbers(waypoint.chain.get(name, "")) for name in ("deltaTheta", "d", "a", "alpha")]
        if any(len(column) != len(self._table) for column in columns) or not np.isfinite(columns).all():
            return False
        return same_chain(np.array(columns).T, self._table, self._published)


def _numbers(text: str) -> list[float]:
    """Parse numbers separated by commas; empty if one is not a number."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []
