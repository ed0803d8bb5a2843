"""Read the targets of a URScript program.

Source of the arguments: URScript Manual (Universal Robots), "Module motion": ``movej(q)``, ``movel(pose)``,
``movep(pose)``, ``movec(pose_via, pose_to)``; each takes joint positions or a pose; of ``pose_via`` only the position
is used. ``get_inverse_kin(x, qnear, ..., tcp)`` returns the solution nearest to ``qnear``, else to the present joint
positions, for the active TCP unless one is given.

Read the targets of a PolyScope program (``.urp``): the joint positions of its waypoints.

A ``.urp`` is gzipped XML. A fixed ``Waypoint`` has ``position/JointAngles`` and the ``Kinematics`` of the arm on which
it was taught; PolyScope computes its pose from both ("URP Syntax", a description of the format by funh of Universal
Robots, 2025). Its TCP moves with the flange, so that correcting the joint positions corrects the pose.
"""

from __future__ import annotations

import ast
import gzip
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from cellapp.cell.profile.factory import fitting_types
from cellapp.cell.profile.loader import own_arm_types
from cellapp.cell.programs.records import ArmPlace, ProgramTarget, ReadProgram, Six, UnchangedMotion
from cellapp.cell.programs.urscript import (
    SIX,
    Constants,
    ParsedProgram,
    Statement,
    Unresolved,
    Value,
    argument_of,
    check_chain,
    function_of,
    items_of,
    parse_program,
    parts_of,
)
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import of_one_type, same_chain
from cellapp.robot.kinematics.transforms import Array

_MOTIONS = {
    "movej": ((0, "q"),),
    "movel": ((0, "pose"),),
    "movep": ((0, "pose"),),
    "movec": ((0, "pose_via"), (1, "pose_to")),
}
_OTHER_TARGETS = {
    "servoj": "it is streamed while the program runs",
    "servoc": "it is streamed while the program runs",
    "servol": "it is streamed while the program runs",
    "track_conveyor_linear": "targets move with the conveyor",
    "track_conveyor_circular": "targets move with the conveyor",
    "path_offset_set": "it shifts targets while the program runs",
    "mc_add_linear": "motions of this module are not read",
    "mc_add_circular": "motions of this module are not read",
    "mc_add_path": "motions of this module are not read",
}
_NUMBERS = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Call)
"""Parts of a number such as ``-0.3`` or ``d2r(90)``."""
_NO_TARGETS = ("speedj", "speedl", "force_mode", "freedrive_mode", "teach_mode")
_NO_TCP = "the TCP is not known: the program has no set_tcp; give --tcp"
_OPEN_TCP = "the TCP is not known: set_tcp has several values, and the program's course decides which holds here"


@dataclass(frozen=True)
class _Goal:
    """Resolved target: its value, the expression that holds it, and the variables through which it was reached."""

    value: Value
    stands: ast.expr
    use: ast.expr
    variables: tuple[str, ...] = ()
    near: Six | None = None
    tcp: Six | None = None
    solved: bool = False


def read_script(data: bytes, where: str, tcp: Six | None = None) -> ReadProgram:
    """Read the targets of a ``.script`` file.

    Parameters
    ----------
    data : bytes
    where : str
        Name of the file for messages.
    tcp : six numbers or None
        Pose of the TCP in the flange frame if the program sets none.

    Raises
    ------
    InputError
        If the blocks do not match, or both the program and ``tcp`` set a TCP.
    """
    text = data.decode("utf-8", "surrogateescape")
    program = parse_program(text, where)
    reader = _TargetReader(program, where, tcp)
    targets, left = reader.motions()
    return ReadProgram(
        text=text,
        targets=tuple(reader.with_shared(targets)),
        left=tuple(left),
        payload_kg=reader.payload_kg(),
        encode=lambda changed: changed.encode("utf-8", "surrogateescape"),
    )


def six(numbers: Iterable[float]) -> Six:
    """Return six numbers as a tuple of six."""
    a, b, c, d, e, f = numbers
    return a, b, c, d, e, f


class _TargetReader:
    """Reads the motions of one program."""

    def __init__(self, program: ParsedProgram, where: str, tcp: Six | None) -> None:
        self._program, self._constants = program, Constants(program)
        self._goals: list[_Goal | None] = []
        self._tcps = [
            (statement, call)
            for statement in program.statements
            for call in _calls(statement)
            if function_of(call) == "set_tcp"
        ]
        self._given = tcp
        if tcp is not None and self._tcps:
            raise InputError(
                f"{where}:{self._tcps[0][0].line}: the program sets its own TCP; leave --tcp out. Nothing was written"
            )
        self._names = Counter(
            word.text for statement in program.statements for word in statement.tokens if word.kind == "name"
        )
        self._motions: dict[str, tuple[tuple[int, str], ...]] = dict(_MOTIONS)
        self._moves: dict[str, Statement] = {}
        while self._find_wrapper():
            pass

    def _find_wrapper(self) -> bool:
        """Find a function that moves to one of its parameters, and uses that for nothing else; False if none is left.

        A call of it is a motion to what it is given; ``_moves`` has the motion inside.
        """
        called = {function_of(call) for statement in self._program.statements for call in _calls(statement)}
        for function, parameters in self._program.parameters.items():
            if function in self._motions or function not in called or "" in parameters:
                continue
            inside = [one for one in self._program.statements if function in one.path]
            for place, name in enumerate(parameters):
                moves = [
                    self._moves.get(function_of(call), one)
                    for one in inside
                    for call in _calls(one)
                    for argument in self._arguments(call)
                    if isinstance(argument, ast.Name) and argument.id == name and function_of(call) != "movec"
                ]
                if moves and len(moves) == sum(word.text == name for one in inside for word in one.tokens):
                    self._motions[function], self._moves[function] = ((place, name),), moves[0]
                    return True
        return False

    def _arguments(self, call: ast.Call) -> list[ast.expr | None]:
        return [argument_of(call, index, name) for index, name in self._motions.get(function_of(call), ())]

    def _is_wrapped(self, statement: Statement, call: ast.Call) -> bool:
        """Return whether a motion goes to the parameter of its function: then the calls of that are the motions."""
        own = self._motions.get(statement.function, ())
        return any(isinstance(one, ast.Name) and own and one.id == own[0][1] for one in self._arguments(call))

    def motions(self) -> tuple[list[ProgramTarget], list[UnchangedMotion]]:
        """Return all motions, in the order of the text."""
        targets: list[ProgramTarget] = []
        left: list[UnchangedMotion] = []
        for statement in self._program.statements:
            if statement.expression is None:
                left += _unreadable(statement)
            for call in _calls(statement):
                function = function_of(call)
                if function in _OTHER_TARGETS:
                    left.append(UnchangedMotion(statement.line, function, _OTHER_TARGETS[function]))
                elif function in _NO_TARGETS:
                    left.append(UnchangedMotion(statement.line, function, "it has no target", refused=False))
                elif function in self._motions and not self._is_wrapped(statement, call):
                    try:
                        targets += self._targets(statement, call)
                    except Unresolved as reason:
                        left.append(UnchangedMotion(statement.line, function, str(reason)))
        return targets, left

    def _targets(self, statement: Statement, call: ast.Call) -> list[ProgramTarget]:
        found: list[ProgramTarget] = []
        goals: list[_Goal] = []
        for index, name in self._motions[function_of(call)]:
            argument = argument_of(call, index, name)
            if argument is None:
                raise Unresolved(f"its argument '{name}' is missing")
            goal = self._goal(argument, statement.path)
            goals.append(goal)
            found.append(self._target(statement, function_of(call), goal))
        if function_of(call) == "movec" and found[0].kind == found[1].kind == "pose":
            found[0] = replace(found[0], position_only=True, facing=found[1].numbers)
        self._goals += goals
        return found

    def _target(self, statement: Statement, command: str, goal: _Goal) -> ProgramTarget:
        if len(goal.value.numbers) != SIX:
            raise Unresolved(f"its target has {len(goal.value.numbers)} numbers instead of 6")
        pose = goal.value.pose
        return ProgramTarget(
            line=statement.line,
            command=command,
            kind="pose" if pose else "joints",
            numbers=six(goal.value.numbers),
            tcp=(goal.tcp or self._tcp_at(self._moves.get(command, statement))) if pose else None,
            near=goal.near,
            function=statement.function,
            place=_place(goal.use),
            as_joints=goal.solved and bool(goal.variables) and goal.use is not goal.stands,
        )

    def _goal(self, expression: ast.expr, path: tuple[str, ...], within: tuple[str, ...] = ()) -> _Goal:
        """Resolve an expression as a target; ``within`` are the variables whose definitions led to it."""
        if isinstance(expression, ast.Name):
            check_chain(expression.id, within)
            inner = self._goal(*self._constants.definition(expression.id, path), (*within, expression.id))
            return replace(inner, use=expression, variables=(expression.id, *inner.variables))
        if isinstance(expression, ast.Call) and function_of(expression) == "get_inverse_kin":
            return self._solved(expression, path, within)
        return _Goal(self._constants.value(expression, path), expression, expression)

    def _solved(self, call: ast.Call, path: tuple[str, ...], within: tuple[str, ...]) -> _Goal:
        argument = argument_of(call, 0, "x")
        if argument is None:
            raise Unresolved("get_inverse_kin has no pose")
        inner = self._goal(argument, path, within)
        if not inner.value.pose:
            raise Unresolved("get_inverse_kin is given joint positions instead of a pose")
        tcp = argument_of(call, 4, "tcp")
        return replace(
            inner,
            near=self._near(argument_of(call, 1, "qnear"), path),
            tcp=None if tcp is None else self._pose(tcp, path),
            # at the motion, a variable inside the call is replaced by a pose, but the whole call by joint positions
            solved=bool(within),
        )

    def _near(self, expression: ast.expr | None, path: tuple[str, ...]) -> Six | None:
        if expression is None:
            return None
        try:
            numbers = self._constants.value(expression, path).numbers
        except Unresolved:
            return None
        return six(numbers) if len(numbers) == SIX else None

    def _pose(self, expression: ast.expr, path: tuple[str, ...]) -> Six:
        value = self._constants.value(expression, path)
        if not value.pose or len(value.numbers) != SIX:
            raise Unresolved("the TCP is no pose")
        return six(value.numbers)

    def _tcp_at(self, statement: Statement) -> Six:
        """Return the TCP that is active at a statement.

        Several values are distinguished only if all are set in one function outside of its blocks: then the last one
        above is active.
        """
        if any(one.expression is None and _has_word(one, "set_tcp") for one in self._program.statements):
            raise Unresolved("the TCP is not known: a line with set_tcp cannot be read")
        if not self._tcps:
            if self._given is None:
                raise Unresolved(_NO_TCP)
            return self._given
        poses = [(where, self._set_tcp(call, where.path)) for where, call in self._tcps]
        if len({pose for _, pose in poses}) == 1:
            return poses[0][1]
        if any(where.depth > 0 or where.function != statement.function for where, _ in poses):
            raise Unresolved(_OPEN_TCP)
        above = [pose for where, pose in poses if where.line < statement.line]
        if not above:
            raise Unresolved(_OPEN_TCP)
        return above[-1]

    def _set_tcp(self, call: ast.Call, path: tuple[str, ...]) -> Six:
        argument = argument_of(call, 0, "pose")
        try:
            if argument is not None:
                return self._pose(argument, path)
            raise Unresolved("set_tcp has no pose")
        except Unresolved as reason:
            raise Unresolved(f"the TCP is not known: {reason}") from None

    def payload_kg(self) -> float | None:
        """Return the payload if all calls that set one agree; else None."""
        masses = set()
        for statement in self._program.statements:
            for call in _calls(statement):
                if function_of(call) in ("set_payload", "set_target_payload") and (mass := argument_of(call, 0, "m")):
                    try:
                        masses.add(self._constants.value(mass, statement.path).numbers)
                    except Unresolved:
                        return None
        return masses.pop()[0] if len(masses) == 1 else None

    def with_shared(self, targets: list[ProgramTarget]) -> list[ProgramTarget]:
        """Return the targets with the places of variables that are used for nothing else."""
        uses = Counter(goal.variables for goal in self._goals if goal is not None)
        shared = []
        for target, goal in zip(targets, self._goals, strict=True):
            alone = goal is not None and len(goal.variables) == 1
            if goal is not None and alone and self._names[goal.variables[0]] == uses[goal.variables] + 1:
                target = replace(target, shared=_place(goal.stands))
            shared.append(target)
        return shared


# -- inside -----------------------------------------------------------------------------------------------------------


def _calls(statement: Statement) -> list[ast.Call]:
    if statement.expression is None:
        return []
    return [part for part in parts_of(statement.expression) if isinstance(part, ast.Call)]


def _has_word(statement: Statement, word: str) -> bool:
    return any(token.text == word for token in statement.tokens if token.kind == "name")


def _unreadable(statement: Statement) -> list[UnchangedMotion]:
    """Return the motions in a line that cannot be parsed."""
    words = [word.text for word in statement.tokens if word.kind == "name"]
    known = [word for word in words if word in _MOTIONS or word in _OTHER_TARGETS or word == "set_tcp"]
    return [UnchangedMotion(statement.line, word, "this line cannot be read") for word in known[:1]]


def _place(expression: ast.expr) -> ArmPlace:
    """Return where the numbers of an expression are in the text, each one's place if it is a list of plain numbers."""
    items = items_of(expression) or []
    plain = all(isinstance(part, _NUMBERS) for item in items for part in parts_of(item))
    return ArmPlace(*_span(expression), tuple(map(_span, items)) if plain else ())


def _span(expression: ast.expr) -> tuple[int, int]:
    assert expression.end_col_offset is not None
    return expression.col_offset, expression.end_col_offset


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
    reader = _XmlReader(xml, table, published)
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
        notes=("PolyScope compares a checksum (crcValue) when it loads the copy; save it there once",),
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


class _XmlReader:
    """Collects waypoints and scripts during XML parsing."""

    def __init__(self, xml: bytes, table: Array, published: Array) -> None:
        self._xml, self._table, self._published = xml, table, published
        self.root, self.targets, self.left = "", list[ProgramTarget](), list[UnchangedMotion]()
        self._waypoint: _Waypoint | None = None
        self._move: list[str] = []
        self._script: list[str] | None = None
        self._script_line = 0
        self._types: dict[bytes, str] = {}
        self._of_program: dict[str, str] = {}

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
        elif tag == "kinematics":
            self._of_program = {}
        elif waypoint is None:
            if tag in ("deltaTheta", "a", "d", "alpha"):
                self._of_program.setdefault(tag, values.get("value", ""))
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
                self.left.append(UnchangedMotion(self._script_line, what, reason))
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
        elif other := self._other_type(waypoint):
            reason = f"it was taught on an arm of another type: its rows are those of {other}"
        elif not self._is_the_controllers(waypoint):
            expected = "another one than that in arms.*.factory of the profile,"
            if np.array_equal(self._table, self._published):
                expected = "not on the published table"
            reason = (
                f"it was taught on a controller with a calibration of its own, {expected} that this correction is for;"
                " 'cellapp doctor PROFILE --controllers FOLDER' writes that of the controller"
            )
        if reason:
            self.left.append(UnchangedMotion(waypoint.line, command, reason))
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
                place=ArmPlace(first, last, spans),
            )
        )

    def _is_the_controllers(self, waypoint: _Waypoint) -> bool:
        """Return whether a waypoint's chain, if stated, is that of the controller."""
        if not waypoint.chain or waypoint.status in ("NOT_INITIALIZED", "NOT_LINEARIZED"):
            return True
        rows = self._rows(waypoint)
        return rows is not None and same_chain(rows, self._table, self._published)

    def _rows(self, waypoint: _Waypoint) -> Array | None:
        """Return the rows (6, 4) of a waypoint's chain, else of the program's; None if one is not stated."""
        chain = waypoint.chain or self._of_program
        columns = [_numbers(chain.get(name, "")) for name in ("deltaTheta", "d", "a", "alpha")]
        if any(len(column) != len(self._table) for column in columns) or not np.isfinite(columns).all():
            return None
        return np.array(columns).T

    def _other_type(self, waypoint: _Waypoint) -> str:
        """Return the types of arms that a waypoint was taught on if they are others than this one; else empty."""
        rows = self._rows(waypoint)
        if rows is None or of_one_type(rows, self._published):
            return ""
        if rows.tobytes() not in self._types:  # a program has the same rows at each waypoint
            self._types[rows.tobytes()] = fitting_types(rows, 0.0, own_arm_types())
        return self._types[rows.tobytes()]


def _numbers(text: str) -> list[float]:
    """Parse numbers separated by commas; empty if one is not a number."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []
