"""Expressions of URScript: tokens and a parser that keeps the place of every part in the text.

URScript Manual (Universal Robots), "The URScript Programming Language": comments begin with ``#``, poses are written
``p[x, y, z, rx, ry, rz]`` in m and rad with the rotation as axis times angle, lists ``[...]``; arguments may be named.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
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
_DEEPEST, _LONGEST = 40, 100
"""Nesting, and operations in a row, beyond which an expression counts as unreadable: no program of a person has them,
and what reads expressions recurses."""

TokenKind = Literal["newline", "string", "number", "name", "sign"]


@dataclass(frozen=True)
class Token:
    """A word of the program with its first character's place in the text and its line, from 1."""

    kind: TokenKind
    text: str
    start: int
    line: int

    @property
    def end(self) -> int:
        """The place behind its last character."""
        return self.start + len(self.text)


def tokens_of(text: str) -> Iterator[Token]:
    """Words of a program without spaces and comments; line ends within brackets are left out."""
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
    """A part of the text from ``start`` to before ``end``; compared by identity."""

    start: int
    end: int


@dataclass(frozen=True, eq=False)
class Number(Expression):
    """A number."""

    value: float


@dataclass(frozen=True, eq=False)
class Name(Expression):
    """A variable."""

    name: str


@dataclass(frozen=True, eq=False)
class Items(Expression):
    """A list, or a pose if ``pose``."""

    items: tuple[Expression, ...]
    pose: bool


@dataclass(frozen=True, eq=False)
class Call(Expression):
    """A call of a function by name."""

    function: str
    arguments: tuple[Expression, ...]
    named: dict[str, Expression] = field(default_factory=dict)

    def argument(self, index: int, name: str) -> Expression | None:
        """The argument at a place or with a name; None without."""
        return self.arguments[index] if index < len(self.arguments) else self.named.get(name)


@dataclass(frozen=True, eq=False)
class Operation(Expression):
    """``operands`` joined by a sign; one operand for a sign in front."""

    sign: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True, eq=False)
class Other(Expression):
    """Strings, True and False, elements of lists: nothing that can be a target; ``parts`` are within it."""

    parts: tuple[Expression, ...] = ()


class Unreadable(Exception):
    """The words are no expression that this parser knows."""


def parse_expression(tokens: Sequence[Token]) -> Expression:
    """The expression that these words are. Raises ``Unreadable``."""
    parser = _Parser(tokens)
    found = parser.comparison(0)
    if parser.place != len(tokens):
        raise Unreadable
    return found


def parts_of(expression: Expression) -> Iterator[Expression]:
    """The expression and everything within it, in the order of the text."""
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

_LEVELS = (("or", "xor"), ("and",), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "%"))


class _Parser:
    """Recursive descent over the words of one expression."""

    def __init__(self, tokens: Sequence[Token]) -> None:
        self.tokens, self.place, self.depth, self.operations = tokens, 0, 0, 0

    def _word(self) -> str:
        return self.tokens[self.place].text if self.place < len(self.tokens) else ""

    def _next(self) -> Token:
        if self.place >= len(self.tokens):
            raise Unreadable
        self.place += 1
        return self.tokens[self.place - 1]

    def _count(self) -> None:
        self.operations += 1
        if self.operations > _LONGEST:
            raise Unreadable

    def _expect(self, text: str) -> Token:
        token = self._next()
        if token.text != text:
            raise Unreadable
        return token

    def comparison(self, level: int) -> Expression:
        """Operations of one precedence, the left one first."""
        if level == len(_LEVELS):
            return self._signed()
        left = self.comparison(level + 1)
        while self._word() in _LEVELS[level]:
            self._count()
            sign = self._next().text
            right = self.comparison(level + 1)
            left = Operation(left.start, right.end, sign, (left, right))
        return left

    def _signed(self) -> Expression:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise Unreadable
        if self._word() in ("-", "+", "not"):
            token = self._next()
            operand = self._signed()
            found: Expression = Operation(token.start, operand.end, token.text, (operand,))
        else:
            found = self._followed(self._single())
        self.depth -= 1
        return found

    def _single(self) -> Expression:
        token = self._next()
        if token.kind == "number":
            return Number(token.start, token.end, float(token.text))
        if token.kind == "string":
            return Other(token.start, token.end)
        if token.text == "[":
            return self._items(token.start, pose=False)
        if token.text == "(":
            inner = self.comparison(0)
            end = self._expect(")").end
            return Operation(token.start, end, "(", (inner,))
        if token.kind != "name":
            raise Unreadable
        if token.text == "p" and self._word() == "[" and self.tokens[self.place].start == token.end:
            self._next()
            return self._items(token.start, pose=True)
        if self._word() == "(":
            return self._call(token)
        if token.text in ("True", "False"):
            return Other(token.start, token.end)
        return Name(token.start, token.end, token.text)

    def _followed(self, expression: Expression) -> Expression:
        """Elements and members: ``x[0]``, ``x.y``."""
        while self._word() in ("[", "."):
            self._count()
            token = self._next()
            if token.text == ".":
                expression = Other(expression.start, self._next().end, (expression,))
            else:
                index = self._items(token.start, pose=False)
                expression = Other(expression.start, index.end, (expression, index))
        return expression

    def _items(self, start: int, *, pose: bool) -> Items:
        items = []
        while self._word() != "]":
            items.append(self.comparison(0))
            if self._word() != "]":
                self._expect(",")
        return Items(start, self._next().end, tuple(items), pose)

    def _call(self, name: Token) -> Call:
        self._next()
        arguments: list[Expression] = []
        named: dict[str, Expression] = {}
        while self._word() != ")":
            ahead = self.tokens[self.place : self.place + 2]
            if len(ahead) == 2 and ahead[0].kind == "name" and ahead[1].text == "=":
                self.place += 2
                named[ahead[0].text] = self.comparison(0)
            else:
                arguments.append(self.comparison(0))
            if self._word() != ")":
                self._expect(",")
        return Call(name.start, self._next().end, name.text, tuple(arguments), named)
