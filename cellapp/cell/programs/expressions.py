"""Tokenize and parse expressions of URScript; every part keeps its place in the text.

URScript Manual (Universal Robots), "The URScript Programming Language": comments begin with ``#``, poses are written
``p[x, y, z, rx, ry, rz]`` in m and rad with the rotation as axis times angle, lists ``[...]``; arguments may be named.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

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


@dataclass(frozen=True, eq=False)
class Expression:
    """Part of the text from offset ``start`` up to, but excluding, ``end``; compared by identity."""

    start: int
    end: int


@dataclass(frozen=True, eq=False)
class Number(Expression):
    """Number."""

    value: float


@dataclass(frozen=True, eq=False)
class Name(Expression):
    """Variable."""

    name: str


@dataclass(frozen=True, eq=False)
class Items(Expression):
    """List, or a pose if ``pose``."""

    items: tuple[Expression, ...]
    pose: bool


@dataclass(frozen=True, eq=False)
class Call(Expression):
    """Call of a function by name."""

    function: str
    arguments: tuple[Expression, ...]
    named: dict[str, Expression] = field(default_factory=dict)

    def argument(self, index: int, name: str) -> Expression | None:
        """Return the argument at an index or with a name; None if there is none."""
        return self.arguments[index] if index < len(self.arguments) else self.named.get(name)


@dataclass(frozen=True, eq=False)
class Operation(Expression):
    """``operands`` joined by an operator; a single operand for a unary operator."""

    sign: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True, eq=False)
class Other(Expression):
    """Strings, True and False, elements of lists: nothing that can be a target; ``parts`` are inside it."""

    parts: tuple[Expression, ...] = ()


class Unreadable(Exception):
    """The tokens are not an expression that this parser knows."""


def parse_expression(tokens: Sequence[Token]) -> Expression:
    """Parse tokens as one expression. Raise ``Unreadable``.

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
    try:
        parsed = ast.parse(line, mode="eval").body
        return _Reader({token.start - begin: token for token in tokens}, begin).read(parsed)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # the last two if it is nested too deeply
        raise Unreadable from error


def parts_of(expression: Expression) -> Iterator[Expression]:
    """Yield the expression and everything inside it, in the order of the text."""
    yield expression
    inner: tuple[Expression, ...] = ()
    match expression:
        case Items(items=inner) | Operation(operands=inner) | Other(parts=inner):
            pass
        case Call():
            inner = (*expression.arguments, *expression.named.values())
    for part in inner:
        yield from parts_of(part)


# -- inside -----------------------------------------------------------------------------------------------------------

_WORD_SIGNS = {"and": "and", "or": "or", "xor": "or ", "not": "not"}
_SIGNS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%", ast.UAdd: "+", ast.USub: "-",
    ast.Not: "not", ast.And: "and", ast.Or: "or",
}  # fmt: skip
"""Operators by their class in Python's ``ast``; without comparisons, whose values are not used in targets."""
_COMPARED = (ast.Eq, ast.NotEq, ast.Lt, ast.Gt, ast.LtE, ast.GtE)


@dataclass(frozen=True)
class _Reader:
    """Converts Python's syntax tree to expressions; ``words`` are tokens by offset in the line, from ``begin``."""

    words: Mapping[int, Token]
    begin: int

    def read(self, node: ast.expr, depth: int = 0) -> Expression:
        """Convert a part at nesting depth ``depth``."""
        if depth > _DEEPEST:
            raise Unreadable
        inner = [one for one in ast.iter_child_nodes(node) if isinstance(one, ast.expr)]
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple):
            inner = [node.value, *node.slice.elts]
        parts = [self.read(one, depth + 1) for one in inner]
        assert node.end_col_offset is not None
        start, end = self.begin + node.col_offset, self.begin + node.end_col_offset
        match node:
            case ast.Name():
                word = self.words[node.col_offset]
                if word.kind == "number":
                    return Number(start, end, float(word.text))
                is_name = word.kind == "name" and word.text not in ("True", "False")
                return Name(start, end, word.text) if is_name else Other(start, end)
            case ast.List():
                return Items(start, end, tuple(parts), pose=False)
            case ast.Subscript():
                whole, items = parts[0], tuple(parts[1:])
                after = self.words.get(node.value.col_offset + 1)
                if isinstance(whole, Name) and whole.name == "p" and after is not None and after.text == "[":
                    return Items(start, end, items, pose=True)
                return Other(start, end, (whole, Items(whole.end, end, items, pose=False)))
            case ast.Attribute():
                return Other(start, end, tuple(parts))
            case ast.BinOp(op=op) | ast.UnaryOp(op=op) | ast.BoolOp(op=op) if type(op) in _SIGNS:
                return Operation(start, end, _SIGNS[type(op)], tuple(parts))
            case ast.Compare(ops=ops) if all(isinstance(one, _COMPARED) for one in ops):
                return Operation(start, end, "==", tuple(parts))
            case ast.Call(func=ast.Name(), keywords=keywords) if all(one.arg for one in keywords):
                named = {self.words[one.col_offset].text: self.read(one.value, depth + 1) for one in keywords}
                if isinstance(function := parts[0], Name):
                    return Call(start, end, function.name, tuple(parts[1:]), named)
        raise Unreadable
