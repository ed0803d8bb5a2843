"""Parse a URScript program into statements: assignments, calls and blocks, with their functions and lines."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.transforms import Array, invert, rotation_from_vector, rotation_vectors, transform

# -- Tokenize and parse expressions of URScript; every part keeps its place in the text -------------------------------
#
# URScript Manual (Universal Robots), "The URScript Programming Language": comments begin with ``#``, poses are written
# ``p[x, y, z, rx, ry, rz]`` in m and rad with the rotation as axis times angle, lists ``[...]``; arguments may be
# named.


_TOKEN = re.compile(
    r"""(?P<space>[ \t\r\f\v\ufeff]+|\#[^\n]*)
    |(?P<newline>\n)
    |(?P<string>"[^"\n]*"?|'[^'\n]*'?)
    |(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    |(?P<name>[^\W\d]\w*)
    |(?P<sign>==|!=|<=|>=|<<|>>|.)""",
    re.VERBOSE,
)
_OPEN, _CLOSE = "([{", ")]}"
_DEEPEST = 100
"""Largest depth of nested parts, or of operations in a row; deeper expressions count as unreadable. People do not write
them, and functions that process expressions are recursive."""
_WORD_SIGNS = {"and": "and", "or": "or", "xor": "or ", "not": "not"}
_SIGNS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%", ast.UAdd: "+", ast.USub: "-"
}  # fmt: skip
"""Operators that are evaluated."""
_LOGIC = (ast.BoolOp, ast.Not, ast.And, ast.Or, ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.Gt, ast.LtE, ast.GtE)
_PARTS = (ast.Name, ast.Load, ast.List, ast.Subscript, ast.Tuple, ast.Attribute, ast.Call, ast.keyword)
_READABLE = (*_PARTS, ast.BinOp, ast.UnaryOp, *_SIGNS, *_LOGIC)
"""What an expression may consist of."""

TokenKind = Literal["newline", "string", "number", "name", "sign"]


@dataclass(frozen=True)
class Token:
    """Token of the program: its first character's offset in the text, and its line, from 1."""

    kind: TokenKind
    text: str
    start: int
    line: int

    @property
    def end(self) -> int:
        """Offset after its last character."""
        return self.start + len(self.text)


def tokens_of(text: str) -> Iterator[Token]:
    """Yield the tokens of a program without spaces and comments; skip line ends within brackets."""
    line, depth = 1, 0
    for found in _TOKEN.finditer(text):
        kind, word = found.lastgroup, found.group()
        if kind == "space":
            continue
        if word in _OPEN:
            depth += 1
        elif word in _CLOSE:
            depth = max(0, depth - 1)
        if kind != "newline" or depth == 0:
            yield Token(kind, word, found.start(), line)  # type: ignore[arg-type]
        line += kind == "newline"


class Unreadable(Exception):
    """The tokens are not an expression that this parser knows."""


def parse_expression(tokens: Sequence[Token]) -> ast.expr:
    """Parse tokens as one expression, whose columns are offsets in the text of the program. Raise ``Unreadable``.

    Expressions of URScript are like those of Python, except for ``xor`` and for the words that may be names. Python's
    own parser reads them, with each word replaced by a name of the same length, so that every part keeps its place.
    """
    if not tokens:
        raise Unreadable
    begin, line = tokens[0].start, ""
    for token in tokens:
        named = token.kind != "sign" and token.text not in _WORD_SIGNS
        if named and line.endswith("x") and token.start - begin == len(line):
            raise Unreadable  # a number followed by a name without a space
        word = "x" * len(token.text) if named else _WORD_SIGNS.get(token.text, token.text)
        line += " " * (token.start - begin - len(line)) + word
    words = {token.start - begin: token for token in tokens}
    try:
        parsed: ast.expr = _Restored(words, begin).visit(ast.parse(line, mode="eval").body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # the last two if it is nested too deeply
        raise Unreadable from error
    return parsed


class _Restored(ast.NodeTransformer):
    """Puts the words of a program, by their offset in the line, back into Python's syntax tree.

    Numbers become constants; so do texts, True and False, which can be no target. Columns count from ``begin`` on.
    """

    def __init__(self, words: Mapping[int, Token], begin: int) -> None:
        self._words, self._begin, self._depth = words, begin, 0
        self._items: list[ast.expr] = []

    def visit(self, node: ast.AST) -> Any:
        """Restore a part and all parts inside it."""
        items = isinstance(node, ast.Tuple) and node not in self._items
        if items or not isinstance(node, _READABLE) or self._depth > _DEEPEST:
            raise Unreadable
        self._depth += 1
        node = super().visit(node)
        self._depth -= 1
        if isinstance(node, ast.expr):
            assert node.end_col_offset is not None
            node.col_offset, node.end_col_offset = node.col_offset + self._begin, node.end_col_offset + self._begin
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Restore a variable, a number or a text."""
        word = self._words[node.col_offset]
        if word.kind == "name" and word.text not in ("True", "False"):
            return ast.copy_location(ast.Name(word.text, node.ctx), node)
        return ast.copy_location(ast.Constant(float(word.text) if word.kind == "number" else word.text), node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        """Restore a pose or an item: only there may expressions stand beside each other."""
        self._items.append(node.slice)
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Restore a call of a function by its name."""
        restored = self.generic_visit(node)
        if not isinstance(node.func, ast.Name):
            raise Unreadable
        return restored

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        """Restore a named argument."""
        if node.arg is None:
            raise Unreadable
        node.arg = self._words[node.col_offset].text
        return self.generic_visit(node)


def function_of(call: ast.Call) -> str:
    """Return the name of the function that is called."""
    assert isinstance(call.func, ast.Name)
    return call.func.id


def argument_of(call: ast.Call, index: int, name: str) -> ast.expr | None:
    """Return the argument at an index or with a name; None if there is none."""
    if index < len(call.args):
        return call.args[index]
    return next((one.value for one in call.keywords if one.arg == name), None)


def items_of(expression: ast.expr) -> list[ast.expr] | None:
    """Return the items of a list, or of a pose ``p[...]``; None for other expressions."""
    match expression:
        case ast.List(elts=items) | ast.Subscript(value=ast.Name(id="p"), slice=ast.Tuple(elts=items)):
            return items
        case ast.Subscript(value=ast.Name(id="p"), slice=item):
            return [item]
    return None


def parts_of(expression: ast.expr) -> Iterator[ast.expr]:
    """Yield the expression and everything inside it, in the order of the text, without names of functions."""
    yield expression
    for node in ast.iter_child_nodes(expression):
        inner = node.value if isinstance(node, ast.keyword) else node
        if isinstance(inner, ast.expr) and inner is not getattr(expression, "func", None):
            yield from parts_of(inner)


_FUNCTIONS = ("def", "thread", "sec")
_BLOCKS = ("if", "while", "for", "switch", "case", "default")
_BRANCHES = ("elif", "elseif", "else")
_WORDS = ("return", "run", "join", "kill", "global", "local")


@dataclass(frozen=True, eq=False)
class Statement:
    """One statement of a program.

    Attributes
    ----------
    line : int
    path : tuple of str
        Functions and threads that contain it, the innermost last.
    depth : int
        Number of blocks (if, while, ...) around it within that function.
    assigned : str
        Variable that it assigns; empty if none.
    expression : ast.expr or None
        Expression that is assigned, called or tested; None if the statement cannot be parsed.
    tokens : tuple of Token
    """

    line: int
    path: tuple[str, ...]
    depth: int
    assigned: str
    expression: ast.expr | None
    tokens: tuple[Token, ...]

    @property
    def function(self) -> str:
        """Innermost function or thread; empty outside of all."""
        return self.path[-1] if self.path else ""


@dataclass(frozen=True)
class ParsedProgram:
    """Program: its text, statements, and the parameters of its functions; of one that is defined twice, all and ""."""

    text: str
    statements: tuple[Statement, ...]
    parameters: Mapping[str, tuple[str, ...]]


def parse_program(text: str, where: str) -> ParsedProgram:
    """Parse a program.

    Raises
    ------
    InputError
        If its blocks do not match; the message has ``where`` and the line.
    """
    statements: list[Statement] = []
    parameters: dict[str, tuple[str, ...]] = {}
    stack: list[tuple[str, str, int]] = []  # kind of block, function, line
    for words in _pieces(text):
        first = words[0]
        path = tuple(name for kind, name, _ in stack if kind in _FUNCTIONS)
        inner = [kind for kind, _, _ in stack]
        depth = next((k for k, kind in enumerate(reversed(inner)) if kind in _FUNCTIONS), len(inner))
        if first.text == "end" and len(words) == 1:
            if not stack:
                raise InputError(f"{where}:{first.line}: 'end' without a block; nothing was written")
            stack.pop()
        elif first.text in _FUNCTIONS and first.kind == "name":
            name = words[1].text if len(words) > 1 else ""
            stack.append((first.text, name, first.line))
            own = [word.text for sign, word in pairwise(words[2:]) if sign.text in "(," and word.kind == "name"]
            parameters[name] = (*parameters[name], *own, "") if name in parameters else tuple(own)
        else:
            statements.append(_statement(words, path, depth))
            if first.text in _BLOCKS and words[-1].text == ":":
                stack.append((first.text, "", first.line))
    if stack:
        kind, _, line = stack[-1]
        raise InputError(f"{where}:{line}: '{kind}' has no 'end'; nothing was written")
    return ParsedProgram(text, tuple(statements), parameters)


# -- inside -----------------------------------------------------------------------------------------------------------


def _pieces(text: str) -> Iterator[Sequence[Token]]:
    """Yield the tokens of each statement: a line, split after a block's colon and before an ``end`` in the line."""
    words: list[Token] = []
    for token in [*tokens_of(text), Token("newline", "\n", len(text), 0)]:
        if token.kind != "newline" and token.text != ";":
            words.append(token)
            continue
        while words:
            cut = _cut(words)
            yield words[:cut]
            words = words[cut:]


def _cut(words: Sequence[Token]) -> int:
    """Return the number of tokens in the first statement of a line."""
    if words[0].text in (*_FUNCTIONS, *_BLOCKS, *_BRANCHES):
        depth = 0
        for place, word in enumerate(words):
            depth += (word.text in "([{") - (word.text in ")]}")
            if word.text == ":" and depth == 0:
                return place + 1
        return len(words)
    return next((k for k, word in enumerate(words) if word.text == "end" and k > 0), len(words))


def _statement(words: Sequence[Token], path: tuple[str, ...], depth: int) -> Statement:
    rest, assigned = list(words), ""
    if rest[0].text in (*_BLOCKS, *_BRANCHES):
        rest = rest[1:-1] if rest[-1].text == ":" else rest[1:]
    elif rest[0].text in _WORDS:
        rest = rest[1:]
    if len(rest) > 1 and rest[0].kind == "name" and rest[1].text == "=":
        assigned, rest = rest[0].text, rest[2:]
    try:
        expression = parse_expression(rest)
    except Unreadable:
        expression = None
    return Statement(words[0].line, path, depth, assigned, expression, tuple(words))


# -- Evaluate expressions that have the same value whenever the program runs ------------------------------------------
#
# A variable is constant if it is assigned once, to such an expression, and is no parameter. Functions that do not
# contain each other may have variables of the same name: without ``global``, and with none outside of functions, each
# has its own (URScript Manual, "Scoping rules"). Functions: ``pose_trans``, ``pose_inv``, ``pose_add``, ``d2r``,
# ``r2d`` (module urmath).


SIX = 6
_LONGEST_CHAIN = 40
_RUNNING = "is known only while the program runs"


class Unresolved(Exception):
    """The value is not constant; the text says why, as the end of a sentence."""


@dataclass(frozen=True, eq=False)
class Value:
    """Number, list of joint positions, or pose."""

    numbers: tuple[float, ...]
    pose: bool = False

    def T(self) -> Array:
        """Return the pose as a matrix (4, 4)."""
        return pose_matrix(self.numbers)


def pose_matrix(pose: Sequence[float]) -> Array:
    """Return the matrix (4, 4) of x, y, z [m] and a rotation vector [rad]."""
    return transform(rotation_from_vector(pose[3:]), pose[:3])


def pose_numbers(T: Array) -> tuple[float, ...]:
    """Return x, y, z [m] and rotation vector [rad] of a matrix (4, 4)."""
    return (*T[:3, 3].tolist(), *rotation_vectors(T[None, :3, :3])[0].tolist())


class Constants:
    """Constant variables of a program."""

    def __init__(self, program: ParsedProgram) -> None:
        self._parameters = program.parameters
        self._assigned = grouped((name, one) for one in program.statements for name in _assigned_names(one))

    def definition(self, name: str, path: tuple[str, ...]) -> tuple[ast.expr, tuple[str, ...]]:
        """Return the only expression that a variable in a function (``path``) is assigned, and the function where.

        Raise ``Unresolved``.
        """
        if any(name in self._parameters.get(function, ()) for function in path):
            raise Unresolved(f"'{name}' is a parameter of a function")
        found = self._assigned.get(name, [])
        own = [one for one in found if one.path == path]
        if len(own) == 1 and not any(_shared(one, path) for one in found):
            found = own
        if not found:
            raise Unresolved(f"'{name}' is not assigned in this program")
        if len(found) > 1:
            lines = ", ".join(str(statement.line) for statement in found)
            raise Unresolved(f"'{name}' is assigned {len(found)} times (lines {lines})")
        if found[0].assigned != name or found[0].expression is None:
            raise Unresolved(f"what line {found[0].line} does to '{name}' cannot be read")
        return found[0].expression, found[0].path

    def value(self, expression: ast.expr, path: tuple[str, ...], within: tuple[str, ...] = ()) -> Value:
        """Return the value of an expression in a function. Raise ``Unresolved``."""
        if (items := items_of(expression)) is not None:
            numbers = tuple(self._number(item, path, within) for item in items)
            return Value(numbers, pose=isinstance(expression, ast.Subscript))
        match expression:
            case ast.Constant(value=float(number)):
                return Value((number,))
            case ast.Name(id=name):
                check_chain(name, within)
                return self.value(*self.definition(name, path), (*within, name))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _SIGNS:
                return _operation(_SIGNS[type(op)], [self.value(operand, path, within)])
            case ast.BinOp(left=left, op=op, right=right):
                return _operation(_SIGNS[type(op)], [self.value(one, path, within) for one in (left, right)])
            case ast.Call(args=arguments, keywords=[]):
                return _call(function_of(expression), [self.value(argument, path, within) for argument in arguments])
            case ast.Call():
                raise Unresolved(f"{function_of(expression)}(...) {_RUNNING}")
        raise Unresolved(f"it {_RUNNING}")

    def _number(self, expression: ast.expr, path: tuple[str, ...], within: tuple[str, ...]) -> float:
        numbers = self.value(expression, path, within).numbers
        if len(numbers) != 1:
            raise Unresolved("a list stands where a number is expected")
        return numbers[0]


def check_chain(name: str, within: Sequence[str]) -> None:
    """Raise ``Unresolved`` if a variable is in its own definition, or behind too many others."""
    if name in within:
        raise Unresolved(f"'{name}' is defined by itself")
    if len(within) > _LONGEST_CHAIN:
        raise Unresolved(f"'{name}' stands behind more than {_LONGEST_CHAIN} other variables")


# -- inside -----------------------------------------------------------------------------------------------------------


def _shared(statement: Statement, path: tuple[str, ...]) -> bool:
    """Return whether a variable that a statement assigns may be the same one in the function ``path``."""
    if statement.path == path:
        return statement.tokens[0].text == "global"
    nested = min(len(statement.path), len(path))
    return statement.tokens[0].text == "global" or statement.path[:nested] == path[:nested]


def _assigned_names(statement: Statement) -> list[str]:
    """Return the variables that a statement changes; if unreadable, it may change all names before its last '='."""
    if statement.expression is not None:
        return [statement.assigned] if statement.assigned else []
    words = statement.tokens
    equals = max((k for k, word in enumerate(words) if word.text == "="), default=0)
    return list(dict.fromkeys(word.text for word in words[:equals] if word.kind == "name"))


def _operation(sign: str, values: Sequence[Value]) -> Value:
    if any(len(value.numbers) != 1 for value in values):
        raise Unresolved(f"'{sign}' of lists or poses {_RUNNING}")
    numbers = [value.numbers[0] for value in values]
    if (evaluated := _OF_SIGN.get((sign, len(numbers)))) is None or (sign == "/" and numbers[1] == 0.0):
        raise Unresolved(f"'{sign}' is not evaluated")
    return Value((evaluated(*numbers),))


def _call(function: str, values: Sequence[Value]) -> Value:
    if function in _OF_NUMBER and len(values) == 1 and len(values[0].numbers) == 1:
        return Value((_OF_NUMBER[function](values[0].numbers[0]),))
    poses = [value.T() for value in values if value.pose and len(value.numbers) == SIX]
    if (evaluated := _OF_POSES.get((function, len(values)))) is None or len(poses) < len(values):
        raise Unresolved(f"{function}(...) {_RUNNING}")
    return Value(pose_numbers(evaluated(*poses)), pose=True)


def _pose_add(first: Array, second: Array) -> Array:
    return transform(first[:3, :3] @ second[:3, :3], first[:3, 3] + second[:3, 3])


_OF_SIGN: Mapping[tuple[str, int], Callable[..., float]] = {
    ("+", 1): operator.pos,
    ("-", 1): operator.neg,
    ("+", 2): operator.add,
    ("-", 2): operator.sub,
    ("*", 2): operator.mul,
    ("/", 2): operator.truediv,
}
"""Sign and number of its operands -> what it does; of functions of poses, too."""
_OF_NUMBER = {"d2r": math.radians, "r2d": math.degrees}
_OF_POSES: Mapping[tuple[str, int], Callable[..., Array]] = {
    ("pose_inv", 1): invert,
    ("pose_trans", 2): np.matmul,
    ("pose_add", 2): _pose_add,
}
