"""The syntax of conditions: a small CEL parser that checks a text before the engine sees it.

The engine provides neither its syntax tree nor a limit on its work, so each text is parsed here
first: with limits on length, depth and terms, and into a tree whose cost can be estimated. The
engine receives the text that `write` generates from the tree, so that both agree. Syntax outside
this subset (messages, optionals, extension macros) is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

__all__ = [
    "DEPTH",
    "LENGTH",
    "MACROS",
    "TERMS",
    "Call",
    "ExpressionError",
    "Index",
    "ListLiteral",
    "Literal",
    "Macro",
    "MapLiteral",
    "Name",
    "Node",
    "Select",
    "parse",
    "write",
]

LENGTH = 2000
"""Maximum length of an expression, characters."""
TERMS = 200
"""Maximum number of names, literals, operators and calls."""
DEPTH = 24
"""Maximum nesting of brackets, signs and choices."""
MACROS = ("all", "exists", "exists_one", "filter", "map")


class ExpressionError(ValueError):
    """A text is not a valid expression, or exceeds a limit; the message says why."""

    def __init__(self, why: str, *, excess: bool = False) -> None:
        super().__init__(why)
        self.excess = excess
        """Whether it is valid but exceeds a limit."""


class Literal(NamedTuple):
    """A number, string, boolean or null, as written."""

    text: str


class Name(NamedTuple):
    """A variable: a value, or bound by a macro."""

    name: str


class Select(NamedTuple):
    """A field of an expression."""

    of: Node
    field: str


class Index(NamedTuple):
    """An element of a list or a map."""

    of: Node
    at: Node


class Call(NamedTuple):
    """A function, method (with its receiver as the first operand) or operator."""

    name: str
    operands: tuple[Node, ...]
    form: str
    """`function`, `method`, `prefix`, `infix` or `choice`."""


class Macro(NamedTuple):
    """A comprehension over a list or the keys of a map."""

    name: str
    range: Node
    variable: str
    body: tuple[Node, ...]


class ListLiteral(NamedTuple):
    """A list literal."""

    items: tuple[Node, ...]


class MapLiteral(NamedTuple):
    """A map literal: keys and values alternating."""

    items: tuple[Node, ...]


Node = Literal | Name | Select | Index | Call | Macro | ListLiteral | MapLiteral
_T = TypeVar("_T", bound=Node)

_STRING = (
    r"[bB]?[rR][bB]?(?:'''.*?'''|\"\"\".*?\"\"\"|'[^'\r\n]*'|\"[^\"\r\n]*\")"
    r"|[bB]?(?:'''(?:\\.|[^\\])*?'''|\"\"\"(?:\\.|[^\\])*?\"\"\""
    r"|'(?:\\.|[^'\\\r\n])*'|\"(?:\\.|[^\"\\\r\n])*\")"
)
_TOKEN = re.compile(
    rf"(?:[ \t\r\n\f]+|//[^\n]*)*+"
    rf"(?:(?P<string>{_STRING})"
    r"|(?P<number>0[xX][0-9a-fA-F]+[uU]?|(?:\d+\.\d+|\.\d+)(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+"
    r"|\d+[uU]?)"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>\|\||&&|[<>=!]=|[-+*/%<>!?:.,()\[\]{}])"
    r"|(?P<end>\Z))",
    re.DOTALL,
)
_WORDS = ("true", "false", "null")
_LEVELS: tuple[tuple[str, ...], ...] = (
    ("||",),
    ("&&",),
    ("<", "<=", ">", ">=", "==", "!=", "in"),
    ("+", "-"),
    ("*", "/", "%"),
)
_CHOICE, _UNARY, _MEMBER = 0, len(_LEVELS) + 1, len(_LEVELS) + 2
_PRECEDENCE = {sign: level for level, signs in enumerate(_LEVELS, 1) for sign in signs}


def parse(text: str) -> tuple[Node, int]:
    """Parse an expression; return its tree and the number of its terms.

    :raises ExpressionError: it is invalid, or exceeds a limit.
    """
    if len(text) > LENGTH:
        raise ExpressionError(f"it has {len(text)} characters; the limit is {LENGTH}", excess=True)
    parser = _Parser(text)
    return parser.whole(), parser.terms


class _Parser:
    """A recursive descent parser of one text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._place = 0
        self._start = 0
        self._kind = ""
        self._lexeme = ""
        self._depth = 0
        self.terms = 0
        self._step()

    def whole(self) -> Node:
        tree = self._choice()
        if self._kind != "end":
            raise self._unexpected()
        return tree

    # -- tokens --------------------------------------------------------------------------------

    def _step(self) -> None:
        found = _TOKEN.match(self._text, self._place)
        if found is None:
            raise ExpressionError(f"Syntax error: {self._text[self._place :].strip()[:20]!r}")
        self._kind = found.lastgroup or ""
        self._lexeme = found[self._kind]
        self._place = found.end()

    def _unexpected(self) -> ExpressionError:
        what = repr(self._lexeme[:20]) if self._kind != "end" else "the end"
        return ExpressionError(f"Syntax error: {what} is not expected at {self._place}")

    def _take(self, *signs: str) -> str | None:
        if self._kind in ("sign", "word") and self._lexeme in signs:
            found = self._lexeme
            self._step()
            return found
        return None

    def _need(self, sign: str) -> None:
        if self._take(sign) is None:
            raise self._unexpected()

    def _word(self) -> str:
        if self._kind != "word" or self._lexeme in (*_WORDS, "in"):
            raise self._unexpected()
        found = self._lexeme
        self._step()
        return found

    def _count(self, node: _T) -> _T:
        self.terms += 1
        if self.terms > TERMS:
            raise ExpressionError(f"it has more than {TERMS} terms", excess=True)
        return node

    # -- grammar -------------------------------------------------------------------------------

    def _choice(self) -> Node:
        self._depth += 1
        if self._depth > DEPTH:
            raise ExpressionError(f"it is nested deeper than {DEPTH} levels", excess=True)
        node = self._infix(1)
        if self._lexeme == "?" and self._take("?"):
            second = self._infix(1)
            self._need(":")
            node = self._count(Call("?:", (node, second, self._choice()), "choice"))
        self._depth -= 1
        return node

    def _infix(self, least: int) -> Node:
        """Parse operators of at least this precedence, each with its left operand."""
        left = self._unary()
        while (own := _PRECEDENCE.get(self._lexeme, 0)) >= least and self._kind != "string":
            sign = self._lexeme
            self._step()
            left = self._count(Call(sign, (left, self._infix(own + 1)), "infix"))
        return left

    def _unary(self) -> Node:
        sign = self._lexeme
        if sign not in ("!", "-"):
            return self._member()
        count = 0
        while self._take(sign):
            count += 1
        # By the grammar: a run of one sign, without another sign after it.
        self._depth += count
        if self._depth > DEPTH:
            raise ExpressionError(f"it is nested deeper than {DEPTH} levels", excess=True)
        node = self._member()
        self._depth -= count
        for _ in range(count):
            node = self._count(Call(sign, (node,), "prefix"))
        return node

    def _member(self) -> Node:
        node = self._primary()
        while self._lexeme in (".", "["):
            if self._take("."):
                field = self._word()
                if self._take("("):
                    node = self._method(node, field)
                else:
                    node = self._count(Select(node, field))
            else:
                self._step()
                at = self._choice()
                self._need("]")
                node = self._count(Index(node, at))
        return node

    def _method(self, receiver: Node, name: str) -> Node:
        operands = self._items(")")
        if name not in MACROS:
            return self._count(Call(name, (receiver, *operands), "method"))
        if len(operands) not in ((2, 3) if name == "map" else (2,)) or not isinstance(
            operands[0], Name
        ):
            raise ExpressionError(f"`{name}` takes a name and what it stands for: {name}(x, x > 0)")
        return self._count(Macro(name, receiver, operands[0].name, operands[1:]))

    def _primary(self) -> Node:
        kind, token = self._kind, self._lexeme
        if kind in ("string", "number") or (kind == "word" and token in _WORDS):
            self._step()
            return self._count(Literal(token))
        if kind == "word":
            name = self._word()
            if self._take("("):
                return self._count(Call(name, self._items(")"), "function"))
            return self._count(Name(name))
        if self._take("("):
            node = self._choice()
            self._need(")")
            return node
        if self._take("["):
            return self._count(ListLiteral(self._items("]")))
        if self._take("{"):
            return self._count(MapLiteral(self._entries()))
        raise self._unexpected()

    def _items(self, end: str) -> tuple[Node, ...]:
        items: list[Node] = []
        while not self._take(end):
            items.append(self._choice())
            if not self._take(","):
                self._need(end)
                break
            if end == ")" and self._lexeme == ")":
                raise self._unexpected()
        return tuple(items)

    def _entries(self) -> tuple[Node, ...]:
        items: list[Node] = []
        while not self._take("}"):
            items.append(self._choice())
            self._need(":")
            items.append(self._choice())
            if not self._take(","):
                self._need("}")
                break
        return tuple(items)


def write(node: Node, level: int = _CHOICE) -> str:
    """Format a tree as text, with brackets only where precedence requires them."""
    # One function, to use one Python stack frame per level of the tree.
    own = _MEMBER
    match node:
        case Literal(text) | Name(text):
            return text
        case Select(of, field):
            return f"{write(of, _MEMBER)}.{field}"
        case Index(of, at):
            return f"{write(of, _MEMBER)}[{write(at)}]"
        case Macro(name, range_, variable, body):
            return f"{write(range_, _MEMBER)}.{name}({variable}, {_several(body)})"
        case ListLiteral(items):
            return f"[{_several(items)}]"
        case MapLiteral(items):
            pairs = zip(items[::2], items[1::2], strict=True)
            return "{" + ", ".join(f"{write(k)}: {write(v)}" for k, v in pairs) + "}"
        case Call(_, (first, second, third), "choice"):
            own = _CHOICE
            text = f"{write(first, 1)} ? {write(second, 1)} : {write(third)}"
        case Call(name, (left, right), "infix"):
            own = _PRECEDENCE[name]
            text = f"{write(left, own)} {name} {write(right, own + 1)}"
        case Call(name, (inner,), "prefix"):
            own = _UNARY
            run = isinstance(inner, Call) and inner.form == "prefix" and inner.name == name
            text = f"{name}{write(inner, _UNARY if run else _MEMBER)}"
        case Call(name, (receiver, *operands), "method"):
            return f"{write(receiver, _MEMBER)}.{name}({_several(operands)})"
        case Call(name, operands, _):
            return f"{name}({_several(operands)})"
    return f"({text})" if own < level else text


def _several(items: Sequence[Node]) -> str:
    return ", ".join(map(write, items))
