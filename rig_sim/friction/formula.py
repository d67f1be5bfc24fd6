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
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from stickslip.errors import InputError, nearest

if TYPE_CHECKING:
    from stickslip.compute.arrays import Array

SPEED = "s"
FUNCTIONS = {"exp": 1, "log": 1, "sqrt": 1, "tanh": 1, "abs": 1, "min": 2, "max": 2}  # (least) number of arguments
# Characters and levels; published forms have up to 60 and 3.  Parsing calls itself for each level.
LONGEST, DEEPEST = 2000, 60
OVERFLOW = 1e150  # no friction and no derivative of one is as large, and its square is not finite
TOKEN = re.compile(r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[^\W\d]\w*)|(?P<mark>\*\*|[-+*/(),])")
BLANKS = " \t\r\n"
INSTEAD = {
    "^": "write ** for powers",
    "=": "write only the right-hand side",
    "[": "use round brackets",
    "{": "use round brackets",
    ".": "write a name of letters, digits and _",
    ";": "write one formula; only --law accepts a second one, z' = ..., the rate of a state",
}
# Letters that look like a plain one; Unicode's compatibility forms (NFKC) make plain only others, as full-width ones.
LOOK_ALIKES = str.maketrans(
    "аеорсухѕіјһԁԛԝѵԍАВЕЅІЈКМНОРСТУХԌԚԜѴονϳΑΒΕΖΗΙΚΜΝΟΡΤΥΧհոսօցքɑɡıꜱᴠᴡᴢᴏᴜᴄʋ",
    "aeopcyxsijhdqwvgABESIJKMHOPCTYXGQWVovjABEZHIKMNOPTYXhnuogqagisvwzoucv",
)
Slopes = dict[str, "Array"]  # derivative by each variable of the value


class Token(NamedTuple):
    """A number, name or mark of the text, and its first column."""

    kind: str
    text: str
    column: int


class Operation(NamedTuple):
    """One operation on the stack: ``do`` is '+', '-', '*', '/', '**', 'negative', 'number', 'name' or a function."""

    do: str
    column: int  # in the text
    takes: int = 0  # number of values taken from the stack
    name: str = ""  # put on the stack by 'name'
    number: float = 0.0  # put on the stack by 'number'


@dataclass(frozen=True)
class Formula:
    """A friction curve as a formula; `Formula.parse` makes one from its text."""

    text: str  # as written
    parameters: tuple[str, ...]  # every name but ``s``, in the order of first appearance
    # in order of evaluation: each takes from a stack the values of earlier ones
    steps: tuple[Operation, ...] = field(repr=False)

    @classmethod
    def parse(cls, text: str) -> "Formula":
        """Return the formula of a text; raises InputError, with a caret below the column, where it is not a formula."""
        if len(text) > LONGEST:
            problem = f"has {len(text)} characters, which is too long for a friction curve"
            raise InputError(problem, "formula", f"write at most {LONGEST}")
        steps = _Parser(text).steps
        names = dict.fromkeys(step.name for step in steps if step.do == "name" and step.name != SPEED)
        return cls(text, tuple(names), tuple(steps))

    def renamed(self, names: Mapping[str, str]) -> "Formula":
        """Return the formula with other names for some of its parameters."""
        text = self.text
        for step in sorted(self.steps, key=lambda step: -step.column):
            if step.do == "name" and step.name in names:
                text = text[: step.column] + names[step.name] + text[step.column + len(step.name) :]
        return Formula.parse(text)

    def value(self, s: "Array | float", parameters: Mapping[str, float]) -> "Array":
        """Return the curve at slip speeds ``s`` (m/s), in their shape and in the unit that the parameters give it.

        ``parameters`` has a value, or an array in the shape of ``s``, for each of ``self.parameters``; others are
        ignored.  Raises InputError where one is
        missing, or the curve is not finite, with the slip speed, the parameters and the failed operation.
        """
        return self._evaluate(s, parameters, ())[0]

    def slope(self, s: "Array | float", parameters: Mapping[str, float]) -> "Array":
        """Return the derivative by slip speed, in the shape of ``s``; parameters and errors as of `value`."""
        return self._evaluate(s, parameters, (SPEED,))[1][0]

    def gradient(
        self, s: "Array | float", parameters: Mapping[str, float], by: tuple[str, ...] | None = None
    ) -> "Array":
        """Return the derivatives by the parameters: the shape of ``s`` and one more axis, in the order of ``by``.

        By all parameters, in their order, where ``by`` is None.
        """
        import numpy as np

        slopes = self._evaluate(s, parameters, self.parameters if by is None else by)[1]
        return np.stack(slopes, axis=-1) if slopes else np.empty((*np.shape(s), 0))

    def _evaluate(
        self, s: "Array | float", parameters: Mapping[str, float], by: tuple[str, ...]
    ) -> "tuple[Array, list[Array]]":
        """Return the values and their derivatives by the variables ``by``, each in the shape of ``s``."""
        import numpy as np

        missing = [name for name in self.parameters if name not in parameters]
        if missing:
            raise InputError(
                f"has no value for {', '.join(missing)}", f"formula {self.text!r}", "pass a value for each"
            )
        speeds = np.asarray(s, dtype=np.float64)
        variables = {SPEED: speeds} | {name: np.asarray(parameters[name], np.float64) for name in self.parameters}
        with np.errstate(all="ignore"):
            value, slopes = self._run_steps(variables, by)[-1]
        values = np.broadcast_to(value, speeds.shape).copy()
        self._refuse_not_finite(values, speeds, parameters, "")
        derivatives = []
        for variable in by:
            derivative = np.broadcast_to(slopes.get(variable, 0.0), speeds.shape).copy()
            self._refuse_not_finite(derivative, speeds, parameters, variable)
            derivatives.append(derivative)
        return values, derivatives

    def _run_steps(self, variables: "Mapping[str, Array]", by: tuple[str, ...]) -> "list[tuple[Array, Slopes]]":
        """Return the result of each step, with its derivatives; the caller switches numpy's warnings off."""
        import numpy as np

        stack: list[int] = []
        results: list[tuple[Array, Slopes]] = []
        for step in self.steps:
            arguments = [results[stack.pop()] for _ in range(step.takes)][::-1]
            if step.do == "number":
                results.append((np.asarray(step.number), {}))
            elif step.do == "name":
                results.append((variables[step.name], {step.name: np.asarray(1.0)} if step.name in by else {}))
            else:
                results.append(list_operations()[step.do](*arguments))
            stack.append(len(results) - 1)
        return results

    def _refuse_not_finite(
        self, values: "Array", speeds: "Array", parameters: Mapping[str, float], variable: str
    ) -> None:
        """Raise InputError where values, or derivatives by ``variable``, are not finite."""
        import numpy as np

        wrong = np.flatnonzero(~(np.abs(values.ravel()) < OVERFLOW))
        if not wrong.size:
            return
        speed = float(speeds.ravel()[wrong[0]])
        parameters = {
            name: float(np.broadcast_to(parameters[name], speeds.shape).ravel()[wrong[0]]) for name in self.parameters
        }
        position = self.place(speed, parameters)
        if variable:
            problem = f"the derivative with respect to {variable} is not finite {position}"
            raise InputError(problem, "formula", "choose other values, or a formula without this corner or pole")
        cause, column = self._find_cause(speed, parameters)
        do = f"choose other values, or a formula that is finite at this speed\n{point_at(self.text, column)}"
        raise InputError(f"friction is not finite {position}: {cause}", "formula", do)

    def place(self, s: float, parameters: Mapping[str, float]) -> str:
        """Return 'at s = ... m/s with ...' for messages."""
        values = ", ".join(f"{name} = {float(parameters[name]):.6g}" for name in self.parameters)
        return f"at s = {s:.6g} m/s" + (f" with {values}" if values else "")

    def _find_cause(self, s: float, parameters: Mapping[str, float]) -> tuple[str, int]:
        """Return why a step first gives a number that is not finite at a slip speed, and its column in the text."""
        import numpy as np

        variables = {SPEED: np.asarray(s)} | {name: np.asarray(float(parameters[name])) for name in self.parameters}
        with np.errstate(all="ignore"):
            results = self._run_steps(variables, ())
        stack: list[int] = []
        for i, step in enumerate(self.steps):
            arguments = [float(results[stack.pop()][0]) for _ in range(step.takes)][::-1]
            stack.append(i)
            if not math.isfinite(float(results[i][0])):
                return explain_failure(step, arguments), step.column
        return "overflow", self.steps[-1].column


def explain_failure(step: Operation, arguments: list[float]) -> str:
    """Return why a step with finite arguments gives a number that is not finite."""
    if step.do == "name":
        return f"{step.name} is not finite"
    if step.do == "/" and arguments[1] == 0.0:
        return "division by 0"
    if step.do in ("log", "sqrt") and arguments[0] <= 0.0:
        return f"{step.do} of {arguments[0]:.6g}"
    if step.do == "**" and arguments[0] <= 0.0:
        return f"{arguments[0]:.6g} to the power {arguments[1]:.6g}"
    return "overflow"


def point_at(text: str, column: int) -> str:
    """Return the text on its own line with a caret below the column; the part around it where it is long.

    Every character that is not printable ASCII is shown as one letter, so that the caret stays in its column.
    """
    first = max(0, column - 60)
    visible = "".join(
        " " if letter in BLANKS else letter if letter.isascii() and letter.isprintable() else "?"
        for letter in text[first : column + 40]
    )
    return f"    {visible}\n    {'^':>{column - first + 1}}"


def with_plain_letters(name: str) -> str:
    """Return a name with the letters that its own look like."""
    return unicodedata.normalize("NFKC", name).translate(LOOK_ALIKES)


class _Parser:
    """Recursive descent over the tokens of a text; ``steps`` is the formula in the order of evaluation."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = self._split_tokens()
        self.next = 0
        self.depth = 0
        self.steps: list[Operation] = []
        self._parse_sum()
        token = self._peek()
        if token.kind == "end":
            return
        if token.text == ")":
            self._fail(
                "this bracket has no matching opening bracket", token.column, "remove it, or add the opening bracket"
            )
        if token.text == ",":
            self._fail("a comma is allowed only in min and max", token.column, "write a decimal point, or remove it")
        if token.text == "(":
            self._fail("an operator is missing", token.column, "write * for a product")
        self._fail(f"an operator is missing before {token.text:.40}", token.column, "write * for a product")

    def _split_tokens(self) -> list[Token]:
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
                self._fail(f"{letter!a} has no meaning in a formula", column, do)
            tokens.append(Token(str(match.lastgroup), match.group(), column))
            self._refuse_look_alikes(tokens[-1])
            column = match.end()
        return [*tokens, Token("end", "", len(self.text.rstrip(BLANKS)))]

    def _refuse_look_alikes(self, token: Token) -> None:
        """Refuse a name with a letter that looks like another one: two names would look the same."""
        plain = with_plain_letters(token.text)
        if token.kind != "name" or plain == token.text:
            return
        position = next(k for k, letter in enumerate(token.text) if with_plain_letters(letter) != letter)
        letter = token.text[position]
        looks = f"{letter!r} ({unicodedata.name(letter, 'unnamed').lower()}) looks like {with_plain_letters(letter)!r}"
        power = unicodedata.decomposition(letter).startswith("<super>")
        do = "write ** for powers" if power else f"did you mean {plain}?"
        self._fail(f"{looks} in the name {token.text!r:.40}", token.column + position, do)

    def _fail(self, problem: str, column: int, do: str) -> NoReturn:
        raise InputError(problem, "formula", f"{do}\n{point_at(self.text, column)}")

    def _peek(self) -> Token:
        return self.tokens[self.next]

    def _take(self, *marks: str) -> Token | None:
        """Return the next token and advance, if it is one of these marks."""
        token = self.tokens[self.next]
        if token.kind != "mark" or token.text not in marks:
            return None
        self.next += 1
        return token

    def _parse_sum(self) -> None:
        self._parse_product()
        while token := self._take("+", "-"):
            self._parse_product()
            self.steps.append(Operation(token.text, token.column, 2))

    def _parse_product(self) -> None:
        self._parse_signed()
        while token := self._take("*", "/"):
            self._parse_signed()
            self.steps.append(Operation(token.text, token.column, 2))

    def _parse_signed(self) -> None:
        self.depth += 1  # every bracket, sign and power comes through here
        if self.depth > DEEPEST:
            self._fail("is nested too deeply", self._peek().column, f"use at most {DEEPEST} levels")
        if token := self._take("-"):
            self._parse_signed()
            self.steps.append(Operation("negative", token.column, 1))
        else:
            self._parse_item()
            if token := self._take("**"):
                self._parse_signed()
                self.steps.append(Operation("**", token.column, 2))
        self.depth -= 1

    def _parse_item(self) -> None:
        token = self._peek()
        self.next += 1
        if token.kind == "number":
            number = float(token.text)
            if not math.isfinite(number):
                self._fail("a number beyond 1.8e308", token.column, "choose other units")
            self.steps.append(Operation("number", token.column, number=number))
        elif token.kind == "name":
            self._parse_name(token)
        elif token.text == "(" and token.kind == "mark":
            self._parse_sum()
            self._parse_close(token)
        elif token.kind == "end":
            self._fail("a value is missing at the end", token.column, "add a number, a name or a function")
        else:
            self._fail(f"a value is missing before {token.text}", token.column, "write a number, a name or a function")

    def _parse_name(self, token: Token) -> None:
        bracket = self._take("(")
        functions = list(FUNCTIONS)
        if bracket is None:
            if token.text in FUNCTIONS:
                self._fail(f"{token.text} is a function", token.column, f"write {token.text}(...)")
            self.steps.append(Operation("name", token.column, name=token.text))
            return
        if token.text not in FUNCTIONS:
            do = f"{nearest(token.text, functions)} (a product needs a *)"
            self._fail(f"unknown function {token.text:.40}", token.column, do)
        takes = 0
        if self._peek().text != ")":
            self._parse_sum()
            takes = 1
            while self._take(","):
                self._parse_sum()
                takes += 1
        self._parse_close(bracket)
        needed = FUNCTIONS[token.text]
        if takes < needed or (needed == 1 and takes > 1):
            problem = f"{token.text} has {takes} argument{'s' * (takes != 1)}"
            self._fail(problem, token.column, "pass one" if needed == 1 else "pass two or more")
        self.steps.append(Operation(token.text, token.column, takes))

    def _parse_close(self, opened: Token) -> None:
        if self._take(")"):
            return
        token = self._peek()
        if token.kind == "end":
            self._fail("this bracket is not closed", opened.column, "add a )")
        if token.text == ",":
            self._fail("a comma is allowed only in min and max", token.column, "write a decimal point, or remove it")
        self._fail(f"an operator is missing before {token.text:.40}", token.column, "write * for a product")


Dual = tuple["Array", Slopes]  # a value and its derivatives


def apply_chain_rule(value: "Array", *parts: tuple[Any, Slopes]) -> Dual:
    """Return the value with the sum of each factor times its derivatives."""
    total: Slopes = {}
    for factor, slopes in parts:
        for name, slope in slopes.items():
            part = slope * factor
            total[name] = total[name] + part if name in total else part
    return value, total


def make_operation(value_of: Callable[..., "Array"], *slopes_of: Callable[..., Any]) -> Callable[..., Dual]:
    """Return an operation of values and derivatives; ``slopes_of`` take the result and the values, one by each."""

    def operate(*arguments: Dual) -> Dual:
        values = [value for value, _ in arguments]
        result = value_of(*values)
        factors = [slope_of(result, *values) for slope_of in slopes_of]
        return apply_chain_rule(result, *zip(factors, (slopes for _, slopes in arguments), strict=True))

    return operate


@cache
def list_operations() -> dict[str, Callable[..., Dual]]:
    import numpy as np

    def power(a: Dual, b: Dual) -> Dual:
        (base, base_slopes), (exponent, exponent_slopes) = a, b
        value = np.power(base, exponent)
        # 0**p = 0 for every p above 0: its derivative by p is 0, where log(0) would make it 0 times infinity
        growth = np.where((base == 0.0) & (exponent > 0.0), 0.0, value * np.log(base)) if exponent_slopes else value
        fall = np.where(exponent == 0.0, 0.0, exponent * np.power(base, exponent - 1.0))
        return apply_chain_rule(value, (fall, base_slopes), (growth, exponent_slopes))

    def absolute(a: Dual) -> Dual:
        value = a[0]
        slopes = {name: np.where(value == 0.0, np.abs(slope), np.sign(value) * slope) for name, slope in a[1].items()}
        return np.abs(value), slopes

    return {
        "+": make_operation(lambda a, b: a + b, lambda v, a, b: 1.0, lambda v, a, b: 1.0),
        "-": make_operation(lambda a, b: a - b, lambda v, a, b: 1.0, lambda v, a, b: -1.0),
        "*": make_operation(lambda a, b: a * b, lambda v, a, b: b, lambda v, a, b: a),
        "/": make_operation(lambda a, b: a / b, lambda v, a, b: 1.0 / b, lambda v, a, b: -v / b),
        "**": power,
        "negative": make_operation(lambda a: -a, lambda v, a: -1.0),
        "exp": make_operation(np.exp, lambda v, a: v),
        "log": make_operation(np.log, lambda v, a: 1.0 / a),
        "sqrt": make_operation(np.sqrt, lambda v, a: 0.5 / v),
        "tanh": make_operation(np.tanh, lambda v, a: (1.0 - v) * (1.0 + v)),
        "abs": absolute,
        "min": partial(select_extreme, np.minimum),
        "max": partial(select_extreme, np.maximum),
    }


def select_extreme(select: Callable[..., "Array"], *arguments: Dual) -> Dual:
    """Return the largest or least argument; among equal ones the derivative is the largest or least too."""
    import numpy as np

    value, slopes = arguments[0]
    for other, other_slopes in arguments[1:]:
        selected = select(value, other)
        selected_slopes: Slopes = {}
        for name in {**slopes, **other_slopes}:
            slope, other_slope = slopes.get(name, np.float64(0.0)), other_slopes.get(name, np.float64(0.0))
            selected_slopes[name] = np.where(
                value == other, select(slope, other_slope), np.where(selected == value, slope, other_slope)
            )
        value, slopes = selected, selected_slopes
    return value, slopes
