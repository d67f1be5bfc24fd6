"""A friction curve written as a formula: parsed, evaluated and differentiated, never run as Python.

    formula    = product {("+" | "-") product}
    product    = signed {("*" | "/") signed}
    signed     = "-" signed | power
    power      = item ["**" signed]                  so -s**2 is -(s**2), and 2**3**2 is 2**(3**2)
    item       = number | name | function "(" formula {"," formula} ")" | "(" formula ")"

``s`` is the slip speed (m/s, 0 or more); a name that is no function is a parameter.  Numbers are floats.  Functions are
exp, log (natural), sqrt, tanh and abs of one argument, min and max of two or more.

A parsed formula is a list of steps on a stack.  Values follow IEEE arithmetic: ``1/(1 + exp(s/v))`` is 0 where exp
overflows.  Only a result that is not finite is an error, which names the step that caused it.

Derivatives are exact, by the chain rule through the steps.  Where abs, min or max has a corner the derivative is the
one towards larger values of what it is taken by: that of ``abs(s - a)`` by s at s = a is 1.  Not covered: a derivative
that is finite only as a limit, as that of ``sqrt(s**2)`` at 0.
"""

import math
import re
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from stickslip.errors import InputError, nearest

if TYPE_CHECKING:
    from stickslip.compute.arrays import Array

SPEED = "s"
FUNCTIONS = {"exp": 1, "log": 1, "sqrt": 1, "tanh": 1, "abs": 1, "min": 2, "max": 2}  # (least) number of arguments
# Published forms have up to 60 characters and 3 levels.  At half of either a sum of several forms still fits; at twice,
# parsing, which calls itself for each level, would use half of the levels that Python allows.
LONGEST, DEEPEST = 2000, 60
OVERFLOW = 1e150  # no friction and no derivative of one is as large, and its square is not finite
TOKEN = re.compile(r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[^\W\d]\w*)|(?P<mark>\*\*|[-+*/(),])")
BLANKS = " \t\r\n"
INSTEAD = {
    "^": "write ** for powers",
    "=": "write the right-hand side alone",
    "[": "use round brackets",
    "{": "use round brackets",
    ".": "write a name of letters, digits and _",
}
# Letters that look like a plain one; Unicode's compatibility forms (NFKC) make plain only others, as full-width ones.
LOOK_ALIKES = str.maketrans(
    "аеорсухѕіјһԁԛԝѵԍАВЕЅІЈКМНОРСТУХԌԚԜѴονϳΑΒΕΖΗΙΚΜΝΟΡΤΥΧհոսօցքɑɡıꜱᴠᴡᴢᴏᴜᴄʋ",
    "aeopcyxsijhdqwvgABESIJKMHOPCTYXGQWVovjABEZHIKMNOPTYXhnuogqagisvwzoucv",
)
Slopes = dict[str, "Array"]  # derivative by each variable that the value depends on


class Token(NamedTuple):
    """A number, name or mark of the text, and the column at which it begins."""

    kind: str
    text: str
    column: int


class Operation(NamedTuple):
    """One operation on the stack: ``do`` is '+', '-', '*', '/', '**', 'negative', 'number', 'name' or a function.

    ``name`` is what 'name' puts on the stack, ``number`` what 'number' puts there; ``takes`` is how many values the
    operation takes from the stack; ``column`` is where it stands in the text.
    """

    do: str
    column: int
    takes: int = 0
    name: str = ""
    number: float = 0.0


@dataclass(frozen=True)
class Formula:
    """A friction curve as a formula; `Formula.parse` makes one from its text.

    Attributes
    ----------
    text : str
        As written.
    parameters : tuple of str
        Every name but ``s``, in the order of first appearance.
    """

    text: str
    parameters: tuple[str, ...]
    _steps: tuple[Operation, ...] = field(repr=False)

    @classmethod
    def parse(cls, text: str) -> "Formula":
        """Return the formula that a text describes.

        Raises
        ------
        InputError
            What is no formula, shown with a caret under the place; or one longer or deeper than any curve is.
        """
        if len(text) > LONGEST:
            what = f"has {len(text)} characters, more than any friction curve needs"
            raise InputError(what, "formula", f"write at most {LONGEST}")
        steps = _Parser(text).steps
        names = dict.fromkeys(step.name for step in steps if step.do == "name" and step.name != SPEED)
        return cls(text, tuple(names), tuple(steps))

    @property
    def steps(self) -> tuple[Operation, ...]:
        """What is done to evaluate the formula, in order: each step takes from a stack what earlier ones put there."""
        return self._steps

    def renamed(self, names: Mapping[str, str]) -> "Formula":
        """Return the formula with other names for some of its parameters."""
        text = self.text
        for step in sorted(self._steps, key=lambda step: -step.column):
            if step.do == "name" and step.name in names:
                text = text[: step.column] + names[step.name] + text[step.column + len(step.name) :]
        return Formula.parse(text)

    def value(self, s: "Array | float", parameters: Mapping[str, float]) -> "Array":
        """Return the curve at slip speeds.

        Parameters
        ----------
        s : float or array
            Slip speeds, m/s.
        parameters : mapping of str to float
            One value for each of ``self.parameters``; others are ignored.

        Returns
        -------
        array
            In the shape of ``s``; in the unit that the parameters give it.

        Raises
        ------
        InputError
            A parameter is missing, or the curve is not finite: named are the slip speed, the parameters and the
            operation that failed.
        """
        return self._evaluated(s, parameters, ())[0]

    def slope(self, s: "Array | float", parameters: Mapping[str, float]) -> "Array":
        """Return the derivative by slip speed, in the shape of ``s``; as `value` otherwise.

        Raises
        ------
        InputError
            As `value`; or the derivative is not finite.
        """
        return self._evaluated(s, parameters, (SPEED,))[1][0]

    def gradient(
        self, s: "Array | float", parameters: Mapping[str, float], by: tuple[str, ...] | None = None
    ) -> "Array":
        """Return the derivatives by the parameters: the shape of ``s`` and one more axis, in the order of ``by``.

        By all parameters, in their order, where ``by`` does not name some of them.

        Raises
        ------
        InputError
            As `value`; or a derivative is not finite.
        """
        import numpy as np

        slopes = self._evaluated(s, parameters, self.parameters if by is None else by)[1]
        return np.stack(slopes, axis=-1) if slopes else np.empty((*np.shape(s), 0))

    def _evaluated(
        self, s: "Array | float", parameters: Mapping[str, float], by: tuple[str, ...]
    ) -> "tuple[Array, list[Array]]":
        """Return the values and their derivatives by the variables ``by``, each in the shape of ``s``."""
        import numpy as np

        missing = [name for name in self.parameters if name not in parameters]
        if missing:
            raise InputError(f"has no value for {', '.join(missing)}", f"formula {self.text!r}", "give one for each")
        speeds = np.asarray(s, dtype=np.float64)
        known = {SPEED: speeds} | {name: np.asarray(float(parameters[name])) for name in self.parameters}
        with np.errstate(all="ignore"):
            value, slopes = self._run(known, by)[-1]
        found = np.broadcast_to(value, speeds.shape).copy()
        self._refuse_not_finite(found, speeds, parameters, "")
        derivatives = []
        for variable in by:
            one = np.broadcast_to(slopes.get(variable, 0.0), speeds.shape).copy()
            self._refuse_not_finite(one, speeds, parameters, variable)
            derivatives.append(one)
        return found, derivatives

    def _run(self, known: "Mapping[str, Array]", by: tuple[str, ...]) -> "list[tuple[Array, Slopes]]":
        """Return what each step gives, with its derivatives: numpy's warnings are off."""
        import numpy as np

        stack: list[int] = []
        results: list[tuple[Array, Slopes]] = []
        for step in self._steps:
            taken = [results[stack.pop()] for _ in range(step.takes)][::-1]
            if step.do == "number":
                results.append((np.asarray(step.number), {}))
            elif step.do == "name":
                results.append((known[step.name], {step.name: np.asarray(1.0)} if step.name in by else {}))
            else:
                results.append(OPERATIONS[step.do](*taken))
            stack.append(len(results) - 1)
        return results

    def _refuse_not_finite(
        self, found: "Array", speeds: "Array", parameters: Mapping[str, float], variable: str
    ) -> None:
        """Raise InputError where values, or derivatives by ``variable``, are not finite."""
        import numpy as np

        wrong = np.flatnonzero(~(np.abs(found.ravel()) < OVERFLOW))
        if not wrong.size:
            return
        at = float(speeds.ravel()[wrong[0]])
        where = self.place(at, parameters)
        if variable:
            what = f"the derivative by {variable} is not finite {where}"
            raise InputError(what, "formula", "choose other values, or a form without that corner or pole")
        cause, column = self._cause(at, parameters)
        do = f"choose other values, or a form that is finite at this speed\n{pointed(self.text, column)}"
        raise InputError(f"friction is not finite {where}: {cause}", "formula", do)

    def place(self, s: float, parameters: Mapping[str, float]) -> str:
        """Return 'at s = ... m/s with ...', which says in a message where the curve was evaluated."""
        values = ", ".join(f"{name} = {float(parameters[name]):.6g}" for name in self.parameters)
        return f"at s = {s:.6g} m/s" + (f" with {values}" if values else "")

    def _cause(self, s: float, parameters: Mapping[str, float]) -> tuple[str, int]:
        """Return what first made a number that is not finite at a slip speed, and its column in the text."""
        import numpy as np

        known = {SPEED: np.asarray(s)} | {name: np.asarray(float(parameters[name])) for name in self.parameters}
        with np.errstate(all="ignore"):
            results = self._run(known, ())
        stack: list[int] = []
        for i, step in enumerate(self._steps):
            taken = [float(results[stack.pop()][0]) for _ in range(step.takes)][::-1]
            stack.append(i)
            if not math.isfinite(float(results[i][0])):
                return _reason(step, taken), step.column
        return "overflow", self._steps[-1].column


def _reason(step: Operation, taken: list[float]) -> str:
    """Return why a step with finite arguments gives no finite number."""
    if step.do == "name":
        return f"{step.name} is not finite"
    if step.do == "/" and taken[1] == 0.0:
        return "division by 0"
    if step.do in ("log", "sqrt") and taken[0] <= 0.0:
        return f"{step.do} of {taken[0]:.6g}"
    if step.do == "**" and taken[0] <= 0.0:
        return f"{taken[0]:.6g} to the power {taken[1]:.6g}"
    return "overflow"


def pointed(text: str, column: int) -> str:
    """Return the text on a line of its own with a caret below the column; the part about it where it is long.

    What is not of ASCII's printable characters is shown as one letter, so that the caret stays below its place.
    """
    first = max(0, column - 60)
    shown = "".join(
        " " if letter in BLANKS else letter if letter.isascii() and letter.isprintable() else "?"
        for letter in text[first : column + 40]
    )
    return f"    {shown}\n    {'^':>{column - first + 1}}"


def with_plain_letters(name: str) -> str:
    """Return a name with the letters that its own look like."""
    return unicodedata.normalize("NFKC", name).translate(LOOK_ALIKES)


class _Parser:
    """Recursive descent over the tokens of a text; ``steps`` is the formula in the order of evaluation."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = self._tokens()
        self.next = 0
        self.depth = 0
        self.steps: list[Operation] = []
        self._formula()
        token = self._peek()
        if token.kind == "end":
            return
        if token.text == ")":
            self._fault("no bracket is open here", token.column, "remove it, or add the opening one")
        if token.text == ",":
            self._fault("a comma outside min and max", token.column, "write a decimal point, or remove it")
        if token.text == "(":
            self._fault("an operator is missing", token.column, "write * for a product")
        self._fault(f"an operator is missing before {token.text:.40}", token.column, "write * for a product")

    def _tokens(self) -> list[Token]:
        tokens: list[Token] = []
        column = 0
        while column < len(self.text):
            if self.text[column] in BLANKS:
                column += 1
                continue
            match = TOKEN.match(self.text, column)
            if match is None:
                letter = self.text[column]
                do = INSTEAD.get(letter, "use names, numbers, + - * / ** ( ) and functions")
                self._fault(f"{letter!a} has no meaning in a formula", column, do)
            tokens.append(Token(str(match.lastgroup), match.group(), column))
            self._refuse_look_alikes(tokens[-1])
            column = match.end()
        return [*tokens, Token("end", "", len(self.text.rstrip(BLANKS)))]

    def _refuse_look_alikes(self, token: Token) -> None:
        """Refuse a name with a letter that is read as another one: two names would look like one."""
        plain = with_plain_letters(token.text)
        if token.kind != "name" or plain == token.text:
            return
        place = next(k for k, letter in enumerate(token.text) if with_plain_letters(letter) != letter)
        letter = token.text[place]
        looks = f"{letter!r} ({unicodedata.name(letter, 'unnamed').lower()}) looks like {with_plain_letters(letter)!r}"
        power = unicodedata.decomposition(letter).startswith("<super>")
        do = "write ** for powers" if power else f"did you mean {plain}?"
        self._fault(f"{looks} in the name {token.text!r:.40}", token.column + place, do)

    def _fault(self, what: str, column: int, do: str) -> NoReturn:
        raise InputError(what, "formula", f"{do}\n{pointed(self.text, column)}")

    def _peek(self) -> Token:
        return self.tokens[self.next]

    def _take(self, *marks: str) -> Token | None:
        """Return the next token and go on where it is one of these marks."""
        token = self.tokens[self.next]
        if token.kind != "mark" or token.text not in marks:
            return None
        self.next += 1
        return token

    def _formula(self) -> None:
        self._product()
        while token := self._take("+", "-"):
            self._product()
            self.steps.append(Operation(token.text, token.column, 2))

    def _product(self) -> None:
        self._signed()
        while token := self._take("*", "/"):
            self._signed()
            self.steps.append(Operation(token.text, token.column, 2))

    def _signed(self) -> None:
        self.depth += 1  # every bracket, sign and power comes through here
        if self.depth > DEEPEST:
            self._fault("is nested too deeply", self._peek().column, f"use at most {DEEPEST} levels")
        if token := self._take("-"):
            self._signed()
            self.steps.append(Operation("negative", token.column, 1))
        else:
            self._item()
            if token := self._take("**"):
                self._signed()
                self.steps.append(Operation("**", token.column, 2))
        self.depth -= 1

    def _item(self) -> None:
        token = self._peek()
        self.next += 1
        if token.kind == "number":
            number = float(token.text)
            if not math.isfinite(number):
                self._fault("a number beyond 1.8e308", token.column, "choose other units")
            self.steps.append(Operation("number", token.column, number=number))
        elif token.kind == "name":
            self._name(token)
        elif token.text == "(" and token.kind == "mark":
            self._formula()
            self._close(token)
        elif token.kind == "end":
            self._fault("a value is missing at the end", token.column, "add a number, a name or a function")
        else:
            self._fault(f"a value is missing before {token.text}", token.column, "write a number, a name or a function")

    def _name(self, token: Token) -> None:
        bracket = self._take("(")
        known = list(FUNCTIONS)
        if bracket is None:
            if token.text in FUNCTIONS:
                self._fault(f"{token.text} is a function", token.column, f"write {token.text}(...)")
            self.steps.append(Operation("name", token.column, name=token.text))
            return
        if token.text not in FUNCTIONS:
            do = f"{nearest(token.text, known)} (a product needs a *)"
            self._fault(f"unknown function {token.text:.40}", token.column, do)
        takes = 0
        if self._peek().text != ")":
            self._formula()
            takes = 1
            while self._take(","):
                self._formula()
                takes += 1
        self._close(bracket)
        needed = FUNCTIONS[token.text]
        if takes < needed or (needed == 1 and takes > 1):
            what = f"{token.text} has {takes} argument{'s' * (takes != 1)}"
            self._fault(what, token.column, "give one" if needed == 1 else "give two or more")
        self.steps.append(Operation(token.text, token.column, takes))

    def _close(self, opened: Token) -> None:
        if self._take(")"):
            return
        token = self._peek()
        if token.kind == "end":
            self._fault("this bracket is not closed", opened.column, "add a )")
        if token.text == ",":
            self._fault("a comma outside min and max", token.column, "write a decimal point, or remove it")
        self._fault(f"an operator is missing before {token.text:.40}", token.column, "write * for a product")


Dual = tuple["Array", Slopes]  # a value and its derivatives


def _chained(value: "Array", *parts: "tuple[Array, Slopes]") -> Dual:
    """Return the value with the sum of each factor times its derivatives."""
    total: Slopes = {}
    for factor, slopes in parts:
        for name, slope in slopes.items():
            part = slope * factor
            total[name] = total[name] + part if name in total else part
    return value, total


def _add(a: Dual, b: Dual) -> Dual:
    return _chained(a[0] + b[0], (1.0, a[1]), (1.0, b[1]))  # type: ignore[arg-type]


def _subtract(a: Dual, b: Dual) -> Dual:
    return _chained(a[0] - b[0], (1.0, a[1]), (-1.0, b[1]))  # type: ignore[arg-type]


def _multiply(a: Dual, b: Dual) -> Dual:
    return _chained(a[0] * b[0], (b[0], a[1]), (a[0], b[1]))


def _divide(a: Dual, b: Dual) -> Dual:
    quotient = a[0] / b[0]
    return _chained(quotient, (1.0 / b[0], a[1]), (-quotient / b[0], b[1]))


def _power(a: Dual, b: Dual) -> Dual:
    import numpy as np

    (base, base_slopes), (exponent, exponent_slopes) = a, b
    value = np.power(base, exponent)
    # 0**p = 0 for every p above 0: its derivative by p is 0, where log(0) would make it 0 times infinity
    growth = np.where((base == 0.0) & (exponent > 0.0), 0.0, value * np.log(base)) if exponent_slopes else value
    fall = np.where(exponent == 0.0, 0.0, exponent * np.power(base, exponent - 1.0))
    return _chained(value, (fall, base_slopes), (growth, exponent_slopes))


def _negative(a: Dual) -> Dual:
    return _chained(-a[0], (-1.0, a[1]))  # type: ignore[arg-type]


def _exp(a: Dual) -> Dual:
    import numpy as np

    value = np.exp(a[0])
    return _chained(value, (value, a[1]))


def _log(a: Dual) -> Dual:
    import numpy as np

    return _chained(np.log(a[0]), (1.0 / a[0], a[1]))


def _sqrt(a: Dual) -> Dual:
    import numpy as np

    value = np.sqrt(a[0])
    return _chained(value, (0.5 / value, a[1]))


def _tanh(a: Dual) -> Dual:
    import numpy as np

    value = np.tanh(a[0])
    return _chained(value, ((1.0 - value) * (1.0 + value), a[1]))


def _abs(a: Dual) -> Dual:
    import numpy as np

    value = a[0]
    slopes = {name: np.where(value == 0.0, np.abs(slope), np.sign(value) * slope) for name, slope in a[1].items()}
    return np.abs(value), slopes


def _least(*arguments: Dual) -> Dual:
    return _extreme(arguments, largest=False)


def _largest(*arguments: Dual) -> Dual:
    return _extreme(arguments, largest=True)


def _extreme(arguments: tuple[Dual, ...], *, largest: bool) -> Dual:
    """Return the largest or least argument; where several are, the derivative that is the largest or least too."""
    import numpy as np

    better: Callable[..., Array] = np.maximum if largest else np.minimum
    value, slopes = arguments[0]
    for other, other_slopes in arguments[1:]:
        found = better(value, other)
        names = {**slopes, **other_slopes}
        both: Slopes = {}
        for name in names:
            mine, theirs = slopes.get(name, np.float64(0.0)), other_slopes.get(name, np.float64(0.0))
            both[name] = np.where(value == other, better(mine, theirs), np.where(found == value, mine, theirs))
        value, slopes = found, both
    return value, slopes


OPERATIONS: dict[str, Callable[..., Dual]] = {
    "+": _add,
    "-": _subtract,
    "*": _multiply,
    "/": _divide,
    "**": _power,
    "negative": _negative,
    "exp": _exp,
    "log": _log,
    "sqrt": _sqrt,
    "tanh": _tanh,
    "abs": _abs,
    "min": _least,
    "max": _largest,
}
