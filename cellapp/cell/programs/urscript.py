"""Parse a URScript program into statements: assignments, calls and blocks, with their functions and lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cellapp.cell.programs.expressions import Expression, Token, Unreadable, parse_expression, tokens_of
from cellapp.ground.errors import InputError

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
    function : str
        Innermost function or thread that contains it; empty outside of all.
    depth : int
        Number of blocks (if, while, ...) around it within that function.
    assigned : str
        Variable that it assigns; empty if none.
    expression : Expression or None
        Expression that is assigned, called or tested; None if the statement cannot be parsed.
    tokens : tuple of Token
    """

    line: int
    function: str
    depth: int
    assigned: str
    expression: Expression | None
    tokens: tuple[Token, ...]


@dataclass(frozen=True)
class Program:
    """Program: its text, its statements, and the names of the parameters of its functions."""

    text: str
    statements: tuple[Statement, ...]
    parameters: frozenset[str]


def parse_program(text: str, where: str) -> Program:
    """Parse a program.

    Raises
    ------
    InputError
        If its blocks do not match; the message has ``where`` and the line.
    """
    statements: list[Statement] = []
    parameters: set[str] = set()
    stack: list[tuple[str, str, int]] = []  # kind of block, function, line
    for words in _pieces(text):
        first = words[0]
        function = next((name for kind, name, _ in reversed(stack) if kind in _FUNCTIONS), "")
        inner = [kind for kind, _, _ in stack]
        depth = next((k for k, kind in enumerate(reversed(inner)) if kind in _FUNCTIONS), len(inner))
        if first.text == "end" and len(words) == 1:
            if not stack:
                raise InputError(f"{where}:{first.line}: 'end' without a block; nothing was written")
            stack.pop()
        elif first.text in _FUNCTIONS and first.kind == "name":
            name = words[1].text if len(words) > 1 else ""
            stack.append((first.text, name, first.line))
            parameters.update(word.text for word in words[2:] if word.kind == "name")
        else:
            statements.append(_statement(words, function, depth))
            if first.text in _BLOCKS and words[-1].text == ":":
                stack.append((first.text, function, first.line))
    if stack:
        kind, _, line = stack[-1]
        raise InputError(f"{where}:{line}: '{kind}' has no 'end'; nothing was written")
    return Program(text, tuple(statements), frozenset(parameters))


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


def _statement(words: Sequence[Token], function: str, depth: int) -> Statement:
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
    return Statement(words[0].line, function, depth, assigned, expression, tuple(words))
