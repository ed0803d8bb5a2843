"""Read the targets of a URScript program.

Source of the arguments: URScript Manual (Universal Robots), "Module motion": ``movej(q)``, ``movel(pose)``,
``movep(pose)``, ``movec(pose_via, pose_to)``; each takes joint positions or a pose; of ``pose_via`` only the position
is used. ``get_inverse_kin(x, qnear, ..., tcp)`` returns the solution nearest to ``qnear``, else to the present joint
positions, for the active TCP unless one is given.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

from cellapp.cell.programs.targets import LeftMotion, Place, ProgramTarget, ReadProgram, Six
from cellapp.cell.programs.urscript import (
    SIX,
    Call,
    Constants,
    Expression,
    Items,
    Name,
    Number,
    Operation,
    Program,
    Statement,
    Unresolved,
    Value,
    check_chain,
    parse_program,
    parts_of,
)
from cellapp.ground.errors import InputError

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
_NO_TARGETS = ("speedj", "speedl", "force_mode", "freedrive_mode", "teach_mode")
_NO_TCP = "the TCP is not known: the program has no set_tcp; give --tcp"
_OPEN_TCP = "the TCP is not known: set_tcp has several values, and the program's course decides which holds here"


@dataclass(frozen=True)
class _Goal:
    """Resolved target: its value, the expression that holds it, and the variables through which it was reached."""

    value: Value
    stands: Expression
    use: Expression
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
    reader = _Reader(program, where, tcp)
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


class _Reader:
    """Reads the motions of one program."""

    def __init__(self, program: Program, where: str, tcp: Six | None) -> None:
        self._program, self._constants = program, Constants(program)
        self._goals: list[_Goal | None] = []
        self._tcps = [
            (statement, call)
            for statement in program.statements
            for call in _calls(statement)
            if call.function == "set_tcp"
        ]
        self._given = tcp
        if tcp is not None and self._tcps:
            raise InputError(
                f"{where}:{self._tcps[0][0].line}: the program sets its own TCP; leave --tcp out. Nothing was written"
            )
        self._names = Counter(
            word.text for statement in program.statements for word in statement.tokens if word.kind == "name"
        )

    def motions(self) -> tuple[list[ProgramTarget], list[LeftMotion]]:
        """Return all motions, in the order of the text."""
        targets: list[ProgramTarget] = []
        left: list[LeftMotion] = []
        for statement in self._program.statements:
            if statement.expression is None:
                left += _unreadable(statement)
            for call in _calls(statement):
                if call.function in _OTHER_TARGETS:
                    left.append(LeftMotion(statement.line, call.function, _OTHER_TARGETS[call.function]))
                elif call.function in _NO_TARGETS:
                    left.append(LeftMotion(statement.line, call.function, "it has no target", refused=False))
                elif call.function in _MOTIONS:
                    try:
                        targets += self._targets(statement, call)
                    except Unresolved as reason:
                        left.append(LeftMotion(statement.line, call.function, str(reason)))
        return targets, left

    def _targets(self, statement: Statement, call: Call) -> list[ProgramTarget]:
        found: list[ProgramTarget] = []
        goals: list[_Goal] = []
        for index, name in _MOTIONS[call.function]:
            argument = call.argument(index, name)
            if argument is None:
                raise Unresolved(f"its argument '{name}' is missing")
            goal = self._goal(argument)
            goals.append(goal)
            found.append(self._target(statement, call.function, goal))
        if call.function == "movec" and found[0].kind == found[1].kind == "pose":
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
            tcp=(goal.tcp or self._tcp_at(statement)) if pose else None,
            near=goal.near,
            function=statement.function,
            place=_place(goal.use),
            as_joints=goal.solved and bool(goal.variables) and goal.use is not goal.stands,
        )

    def _goal(self, expression: Expression, within: tuple[str, ...] = ()) -> _Goal:
        """Resolve an expression as a target; ``within`` are the variables whose definitions led to it."""
        if isinstance(expression, Name):
            check_chain(expression.name, within)
            inner = self._goal(self._constants.definition(expression.name), (*within, expression.name))
            return replace(inner, use=expression, variables=(expression.name, *inner.variables))
        if isinstance(expression, Call) and expression.function == "get_inverse_kin":
            return self._solved(expression, within)
        return _Goal(self._constants.value(expression), expression, expression)

    def _solved(self, call: Call, within: tuple[str, ...]) -> _Goal:
        argument = call.argument(0, "x")
        if argument is None:
            raise Unresolved("get_inverse_kin has no pose")
        inner = self._goal(argument, within)
        if not inner.value.pose:
            raise Unresolved("get_inverse_kin is given joint positions instead of a pose")
        tcp = call.argument(4, "tcp")
        return replace(
            inner,
            near=self._near(call.argument(1, "qnear")),
            tcp=None if tcp is None else self._pose(tcp),
            # at the motion, a variable inside the call is replaced by a pose, but the whole call by joint positions
            solved=bool(within),
        )

    def _near(self, expression: Expression | None) -> Six | None:
        if expression is None:
            return None
        try:
            numbers = self._constants.value(expression).numbers
        except Unresolved:
            return None
        return six(numbers) if len(numbers) == SIX else None

    def _pose(self, expression: Expression) -> Six:
        value = self._constants.value(expression)
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
        poses = [(where, self._set_tcp(call)) for where, call in self._tcps]
        if len({pose for _, pose in poses}) == 1:
            return poses[0][1]
        if any(where.depth > 0 or where.function != statement.function for where, _ in poses):
            raise Unresolved(_OPEN_TCP)
        above = [pose for where, pose in poses if where.line < statement.line]
        if not above:
            raise Unresolved(_OPEN_TCP)
        return above[-1]

    def _set_tcp(self, call: Call) -> Six:
        argument = call.argument(0, "pose")
        try:
            if argument is not None:
                return self._pose(argument)
            raise Unresolved("set_tcp has no pose")
        except Unresolved as reason:
            raise Unresolved(f"the TCP is not known: {reason}") from None

    def payload_kg(self) -> float | None:
        """Return the payload if all calls that set one agree; else None."""
        masses = set()
        for statement in self._program.statements:
            for call in _calls(statement):
                if call.function in ("set_payload", "set_target_payload") and (mass := call.argument(0, "m")):
                    try:
                        masses.add(self._constants.value(mass).numbers)
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


def _calls(statement: Statement) -> list[Call]:
    if statement.expression is None:
        return []
    return [part for part in parts_of(statement.expression) if isinstance(part, Call)]


def _has_word(statement: Statement, word: str) -> bool:
    return any(token.text == word for token in statement.tokens if token.kind == "name")


def _unreadable(statement: Statement) -> list[LeftMotion]:
    """Return the motions in a line that cannot be parsed."""
    words = [word.text for word in statement.tokens if word.kind == "name"]
    known = [word for word in words if word in _MOTIONS or word in _OTHER_TARGETS or word == "set_tcp"]
    return [LeftMotion(statement.line, word, "this line cannot be read") for word in known[:1]]


def _place(expression: Expression) -> Place:
    """Return where the numbers of an expression are in the text, each one's place if it is a list of plain numbers."""
    if isinstance(expression, Items) and all(_is_number(item) for item in expression.items):
        return Place(expression.start, expression.end, tuple((item.start, item.end) for item in expression.items))
    return Place(expression.start, expression.end)


def _is_number(expression: Expression) -> bool:
    """Return whether an expression consists of numbers only, as ``-0.3`` or ``d2r(90)``."""
    inner = list(parts_of(expression))
    return all(isinstance(part, Number | Operation | Call) for part in inner)
