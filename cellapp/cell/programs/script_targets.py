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
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np

from cellapp.cell.profile.factory import fitting_types
from cellapp.cell.profile.loader import own_arm_types
from cellapp.cell.programs.records import ArmPlace, ProgramTarget, ReadProgram, UnchangedMotion
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
from cellapp.estimation.uncertainty.records import Six
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
        self._goals: list[_Goal] = []
        self._calls = [(statement, call) for statement in program.statements for call in _calls(statement)]
        self._tcps = [(statement, call) for statement, call in self._calls if function_of(call) == "set_tcp"]
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
        called = {function_of(call) for _, call in self._calls}
        for function, parameters in self._program.parameters.items():
            if function in self._motions or function not in called or "" in parameters:
                continue
            inside = [(one, call) for one, call in self._calls if function in one.path]
            words = [word.text for one in self._program.statements if function in one.path for word in one.tokens]
            for place, name in enumerate(parameters):
                moves = [
                    self._moves.get(function_of(call), one)
                    for one, call in inside
                    for argument in self._arguments(call)
                    if isinstance(argument, ast.Name) and argument.id == name and function_of(call) != "movec"
                ]
                if moves and len(moves) == words.count(name):
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
        above = [pose for where, pose in poses if where.line < statement.line]
        if not above or any(where.depth > 0 or where.function != statement.function for where, _ in poses):
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
        for statement, call in self._calls:
            if function_of(call) in ("set_payload", "set_target_payload") and (mass := argument_of(call, 0, "m")):
                try:
                    masses.add(self._constants.value(mass, statement.path).numbers)
                except Unresolved:
                    return None
        return masses.pop()[0] if len(masses) == 1 else None

    def with_shared(self, targets: list[ProgramTarget]) -> list[ProgramTarget]:
        """Return the targets with the places of variables that are used for nothing else."""
        uses = Counter(goal.variables for goal in self._goals)
        shared = []
        for target, goal in zip(targets, self._goals, strict=True):
            if len(goal.variables) == 1 and self._names[goal.variables[0]] == uses[goal.variables] + 1:
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


LARGEST = 32 * 1024 * 1024
"""Maximum size of the unpacked XML [bytes]: a program of a thousand waypoints has about one MB."""
_GZIP = 31
_HIDDEN = re.compile(rb"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)
"""Parts of XML in which a tag is none; one that does not end is hidden to the end, where the parser refuses it."""
_DECLARED = re.compile(rb"<!(?:DOCTYPE|ENTITY)")
_TAG = re.compile(rb"<[^/!]")
_MOVES = re.compile(r"\b(?:move[jlpc]|servo[jcl])\s*\(")
_NUMBER = re.compile(rb"[^,\s]+")
_HOLDERS = {"JointAngles": "angles", "position": "joints"}
"""Elements of a waypoint that hold joint positions -> the attribute of these."""
_CHAIN = ("deltaTheta", "d", "a", "alpha")


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
    ends, starts = [found.start() for found in re.finditer(rb"\n", xml)], _elements(xml, where)
    root = next(iter(starts))
    moves = {one: move.get("motionType", "Move") for move in root.iter("Move") for one in move.iter("Waypoint")}
    of_program = {one.tag: one.get("value", "") for one in root.iterfind(".//kinematics/*")}
    targets, left = list[ProgramTarget](), list[UnchangedMotion]()
    for element, start in starts.items():
        line = bisect(ends, start) + 1
        if element.tag == "Waypoint":
            command = f"{moves.get(element, 'Move')} {element.get('name', '?')}"
            try:
                numbers, holder = _taught(element, of_program, table, published)
            except Unresolved as reason:
                left.append(UnchangedMotion(line, command, str(reason)))
                continue
            place = _attribute(xml, starts[holder], _HOLDERS[holder.tag])
            targets.append(ProgramTarget(line, command, "joints", numbers, None, None, "", place))
        elif element.tag in ("cachedContents", "script") and (found := _MOVES.search("".join(element.itertext()))):
            text = "script text within the .urp is not read; correct the .script file"
            left.append(UnchangedMotion(line, found.group().rstrip("( \t\n"), text))
    return ReadProgram(
        text=xml.decode("latin-1"),  # one character per byte: places count bytes
        targets=tuple(targets),
        left=tuple(left),
        payload_kg=None,
        encode=lambda changed: gzip.compress(changed.encode("latin-1"), mtime=0),
        notes=("PolyScope compares a checksum (crcValue) when it loads the copy; save it there once",),
    )


def _unpacked(data: bytes, where: str) -> bytes:
    unpacker = zlib.decompressobj(_GZIP)
    try:
        xml = unpacker.decompress(data, LARGEST)
    except zlib.error:
        raise InputError(f"{where}: no PolyScope program: it is not packed by gzip") from None
    if unpacker.unconsumed_tail:
        raise InputError(f"{where}: unpacked it has more than {LARGEST // 2**20} MB; no program has")
    if not unpacker.eof:
        raise InputError(f"{where}: the file ends too early; copy it again")
    return xml


def _elements(xml: bytes, where: str) -> dict[Element, int]:
    """Return the elements of a program in the order of the text, each with the byte at which it begins."""
    tags = _HIDDEN.sub(lambda found: b" " * len(found[0]), xml)
    if declared := _DECLARED.search(tags):
        line = xml.count(b"\n", 0, declared.start()) + 1
        raise InputError(f"{where}:{line}: a document type or an entity; no program needs one")
    try:
        root = ElementTree.fromstring(xml, ElementTree.XMLParser(encoding="UTF-8"))
    except ElementTree.ParseError as error:
        raise InputError(f"{where}:{error.position[0]}: not XML ({expat.ErrorString(error.code)})") from None
    if root.tag != "URProgram":
        raise InputError(f"{where}: no PolyScope program: its XML is '{root.tag}' instead of 'URProgram'")
    return dict(zip(root.iter(), (found.start() for found in _TAG.finditer(tags)), strict=True))


def _attribute(xml: bytes, start: int, name: str) -> ArmPlace:
    """Return the place of the numbers in an attribute of the element that begins at ``start``."""
    found = re.compile(rb"\b" + name.encode() + rb"\s*=\s*(?:\"([^\"]*)\"|'([^']*)')").search(xml, start)
    assert found is not None  # the parser saw it there
    first, last = found.span(found.lastindex or 0)
    return ArmPlace(first, last, tuple(one.span() for one in _NUMBER.finditer(xml, first, last)))


def _taught(waypoint: Element, of_program: Mapping[str, str], table: Array, published: Array) -> tuple[Six, Element]:
    """Return the joint positions of a waypoint and the element that holds them.

    ``of_program`` is the chain of a waypoint that states none. Raise ``Unresolved`` if they cannot be corrected.
    """
    if (kind := waypoint.get("type", "")) not in ("", "Fixed"):
        raise Unresolved(f"a waypoint of type {kind}: its target is known only while the program runs")
    holders = [waypoint, *(one for one in waypoint.iter() if _HOLDERS.get(one.tag) in one.attrib)]
    holder = holders[-1]  # the last one counts
    numbers = _numbers(holder.get(_HOLDERS.get(holder.tag, ""), ""))
    if len(numbers) != SIX or not np.isfinite(numbers).all():
        raise Unresolved("the waypoint has no six joint positions")
    if {one.tag: "pose" in one.attrib for one in holders}.get("position"):  # of the last ``position``
        raise Unresolved("an older form of file, with a pose of its own; save it by PolyScope 5")
    own = {one.tag: one.get("value", "") for one in waypoint.iter() if one.tag in _CHAIN}
    rows = _rows(own or of_program, len(table))
    if rows is not None and not of_one_type(rows, published):
        types = _fitting(tuple(map(tuple, rows.tolist())))
        raise Unresolved(f"it was taught on an arm of another type: its rows are those of {types}")
    statuses = [one.get("status", "") for one in waypoint.iter("Kinematics")]
    stated = own and statuses[-1:] not in (["NOT_INITIALIZED"], ["NOT_LINEARIZED"])
    if stated and (rows is None or not same_chain(rows, table, published)):
        expected = "another one than that in arms.*.factory of the profile,"
        if np.array_equal(table, published):
            expected = "not on the published table"
        raise Unresolved(
            f"it was taught on a controller with a calibration of its own, {expected} that this correction is for;"
            " 'cellapp doctor PROFILE --controllers FOLDER' writes that of the controller"
        )
    return six(numbers), holder


def _rows(chain: Mapping[str, str], joints: int) -> Array | None:
    """Return the rows (N, 4) of a chain; None if it does not state them all."""
    columns = [_numbers(chain.get(name, "")) for name in _CHAIN]
    if any(len(column) != joints for column in columns) or not np.isfinite(columns).all():
        return None
    return np.array(columns).T


@lru_cache
def _fitting(rows: tuple[tuple[float, ...], ...]) -> str:
    """Name the types of arms that rows belong to; a program has the same ones at each waypoint."""
    return fitting_types(np.array(rows), 0.0, own_arm_types())


def _numbers(text: str) -> list[float]:
    """Parse numbers separated by commas; empty if one is not a number."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []
