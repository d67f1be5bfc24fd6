"""A friction formula typeset in MathML, which browsers show and print without a script.

Names of Greek letters become the letters, ``v_s`` and ``Fs`` get subscripts, a quotient is a fraction, ``exp`` a power
of e.  Brackets follow from the notation, not from the input.
"""

import html
import re
from collections.abc import Callable

from rig_sim.friction.formula import Formula, Operation

SUM, PRODUCT, SIGNED, POWER, ATOM = range(5)  # how strongly an expression binds
Typeset = tuple[str, int]  # MathML, and how strongly its outermost operation binds
GREEK = {
    name: chr(code)
    for code, name in enumerate(
        (
            "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho sigmaf sigma tau "
            "upsilon phi chi psi omega"
        ).split(),
        start=0x3B1,
    )
}
INDEXED = re.compile(r"([A-Z])([a-z]{1,2}\d?|\d)")  # Fs, Fc, F0


def typeset(text: str) -> str:
    stack: list[Typeset] = []
    for step in Formula.parse(text).steps:
        taken = [stack.pop() for _ in range(step.takes)][::-1]
        stack.append(_step(step, taken))
    return f"<math>{stack[-1][0]}</math>"


def identifier(name: str) -> str:
    """Return a name: a letter, a Greek letter, or a word, with its subscript."""
    indexed = INDEXED.fullmatch(name)
    first, _, below = name.partition("_") if indexed is None else (indexed[1], "", indexed[2])
    if not first:
        first, below = name, ""
    parts = [f"<mi>{html.escape(GREEK.get(part, part))}</mi>" for part in (first, below) if part]
    return f"<msub>{''.join(parts)}</msub>" if len(parts) > 1 else parts[0]


def _step(step: Operation, taken: list[Typeset]) -> Typeset:
    if step.do == "number":
        return f"<mn>{step.number:.6g}</mn>", ATOM
    if step.do == "name":
        return identifier(step.name), ATOM
    return SET[step.do](taken, step.do)


def _within(part: Typeset, least: int) -> str:
    """Return an expression, in brackets where it binds less strongly than ``least``."""
    text, binds = part
    return text if binds >= least else f"<mrow><mo>(</mo>{text}<mo>)</mo></mrow>"


def _sum(taken: list[Typeset], sign: str) -> Typeset:
    left, right = taken
    shown = "+" if sign == "+" else "\N{MINUS SIGN}"
    return f"<mrow>{_within(left, SUM)}<mo>{shown}</mo>{_within(right, PRODUCT)}</mrow>", SUM


def _product(taken: list[Typeset], _: str) -> Typeset:
    left, right = (_within(part, PRODUCT if place == 0 else POWER) for place, part in enumerate(taken))
    sign = "\N{MIDDLE DOT}" if "<mn>" in right[:4] else "&#x2062;"  # invisible times
    return f"<mrow>{left}<mo>{sign}</mo>{right}</mrow>", PRODUCT


def _quotient(taken: list[Typeset], _: str) -> Typeset:
    return f"<mfrac>{taken[0][0]}{taken[1][0]}</mfrac>", POWER


def _negative(taken: list[Typeset], _: str) -> Typeset:
    return f"<mrow><mo>\N{MINUS SIGN}</mo>{_within(taken[0], POWER)}</mrow>", SIGNED


def _power(taken: list[Typeset], _: str) -> Typeset:
    base = taken[0] if "<mfrac>" not in taken[0][0][:7] else (taken[0][0], PRODUCT)
    return f"<msup>{_within(base, ATOM)}<mrow>{taken[1][0]}</mrow></msup>", POWER


def _exponential(taken: list[Typeset], _: str) -> Typeset:
    return f"<msup><mi>e</mi><mrow>{taken[0][0]}</mrow></msup>", POWER


def _root(taken: list[Typeset], _: str) -> Typeset:
    return f"<msqrt>{taken[0][0]}</msqrt>", ATOM


def _size(taken: list[Typeset], _: str) -> Typeset:
    return f"<mrow><mo>|</mo>{taken[0][0]}<mo>|</mo></mrow>", ATOM


def _function(taken: list[Typeset], name: str) -> Typeset:
    inner = "<mo>,</mo>".join(text for text, _ in taken)
    shown = "ln" if name == "log" else name
    return f"<mrow><mi>{shown}</mi><mo>&#x2061;</mo><mo>(</mo>{inner}<mo>)</mo></mrow>", ATOM


SET: dict[str, Callable[[list[Typeset], str], Typeset]] = {
    "+": _sum,
    "-": _sum,
    "*": _product,
    "/": _quotient,
    "**": _power,
    "negative": _negative,
    "exp": _exponential,
    "sqrt": _root,
    "abs": _size,
    "log": _function,
    "tanh": _function,
    "min": _function,
    "max": _function,
}
