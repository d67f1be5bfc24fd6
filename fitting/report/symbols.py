"""Formulas of the laws in plain text and typeset in MathML, and the meaning of their symbols.

Browsers show and print MathML without a script.  Names of Greek letters become the letters, ``v_s`` and ``Fs`` get
subscripts, a quotient is a fraction, ``exp`` a power of e; brackets follow from the notation, not from the input.
"""

import html
import re
from collections.abc import Callable, Iterable

from fitting.laws import Law
from rig_sim.friction.formula import Formula, Operation

SUM, PRODUCT, SIGNED, POWER, ATOM = range(5)  # how strongly an expression binds
Typeset = tuple[str, int]  # MathML, and how strongly its outermost operation binds
LETTERS = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho sigmaf sigma tau upsilon "
    "phi chi psi omega"
)
GREEK = {name: chr(code) for code, name in enumerate(LETTERS.split(), start=0x3B1)}
INDEXED = re.compile(r"([A-Z](?=[a-z])|[A-Za-z](?=\d))([a-z]{0,2}\d?)")  # Fs, Fc, F0, x0


def typeset_formula(text: str) -> str:
    stack: list[Typeset] = []
    for step in Formula.parse(text).steps:
        taken = [stack.pop() for _ in range(step.takes)][::-1]
        stack.append(_step(step, taken))
    return f"<math>{stack[-1][0]}</math>"


def identifier(name: str) -> str:
    parts = [f"<mi>{html.escape(part)}</mi>" for part in _split(name)]
    return f"<msub>{''.join(parts)}</msub>" if len(parts) > 1 else parts[0]


def _split(name: str) -> list[str]:
    """Return a symbol and its index, if it has one."""
    indexed = INDEXED.fullmatch(name)
    first, _, below = name.partition("_") if indexed is None else (indexed[1], "", indexed[2])
    return [GREEK.get(part, part) for part in ((first, below) if first else (name,)) if part]


def parameter(name: str) -> str:
    """Return the name of a parameter, which may be a combination of several, as MathML."""
    words = re.findall(r"\w+|[^\w\s]", name)
    return f"<math>{''.join(identifier(word) if word[0].isalpha() else f'<mo>{word}</mo>' for word in words)}</math>"


def mathtext(name: str) -> str:
    """Return the name of a parameter as matplotlib sets it."""
    return re.sub(r"[A-Za-z]\w*", lambda word: f"${'_'.join(_set(part) for part in _split(word[0]))}$", name)


def _set(part: str) -> str:
    return part if len(part) == 1 else rf"\mathrm{{{part}}}"


def _step(step: Operation, taken: list[Typeset]) -> Typeset:
    if step.do == "number":
        return f"<mn>{step.number:.6g}</mn>", ATOM
    if step.do == "name":
        return identifier(step.name), ATOM
    return SET[step.do](taken, step.do)


def _within(part: Typeset, least: int) -> str:
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


def _power(taken: list[Typeset], _: str) -> Typeset:
    base = taken[0] if "<mfrac>" not in taken[0][0][:7] else (taken[0][0], PRODUCT)
    return f"<msup>{_within(base, ATOM)}<mrow>{taken[1][0]}</mrow></msup>", POWER


def _function(taken: list[Typeset], name: str) -> Typeset:
    inner = "<mo>,</mo>".join(text for text, _ in taken)
    shown = "ln" if name == "log" else name
    return f"<mrow><mi>{shown}</mi><mo>&#x2061;</mo><mo>(</mo>{inner}<mo>)</mo></mrow>", ATOM


SET: dict[str, Callable[[list[Typeset], str], Typeset]] = {
    "+": _sum,
    "-": _sum,
    "*": _product,
    "/": lambda taken, _: (f"<mfrac>{taken[0][0]}{taken[1][0]}</mfrac>", POWER),
    "**": _power,
    "negative": lambda taken, _: (f"<mrow><mo>\N{MINUS SIGN}</mo>{_within(taken[0], POWER)}</mrow>", SIGNED),
    "exp": lambda taken, _: (f"<msup><mi>e</mi><mrow>{taken[0][0]}</mrow></msup>", POWER),
    "sqrt": lambda taken, _: (f"<msqrt>{taken[0][0]}</msqrt>", ATOM),
    "abs": lambda taken, _: (f"<mrow><mo>|</mo>{taken[0][0]}<mo>|</mo></mrow>", ATOM),
    "log": _function,
    "tanh": _function,
    "min": _function,
    "max": _function,
}


MOTION = "m dv/dt = F(w) - k (x - x0) - c v, with w = v - v_dr"
# Every symbol of the formulas, and every parameter that a fit reports, without "/m".
SYMBOLS = {
    "x": "position of the mass, positive towards +x (m)",
    "v": "velocity of the mass (m/s)",
    "w": "relative velocity: that of the mass minus that of the belt (m/s)",
    "s": "slip speed (m/s)",
    "F": "friction force of the belt on the mass (N); per unit mass (m s^-2) where neither mass nor stiffness is known",
    "m": "moving mass (kg)",
    "k": "stiffness of the spring (N/m); k/m in s^-2",
    "Fs": "friction level: friction at the start of a slip, averaged over the record (N); Fs/m in m s^-2",
    "Fs/k": "extension of the spring at the friction level (m)",
    "v_dr": "speed of the belt, positive towards +x (m/s)",
    "gamma": "rate at which friction falls with slip speed; it is one half at s = 1/gamma (s/m)",
    "G_slip": "decrease of friction per slip speed (N s/m)",
    "d": "half-width of the ramp through w = 0 (m/s)",
    "static": "break-away level of a ramp law, relative to Fs",
    "x0": "position reading with the spring relaxed (m)",
    "c": "viscous damping of the mass (N s/m); c/m in s^-1",
    "Fs0": "friction level at the start of the recording (N)",
    "wear": "fraction of the friction level that is lost per second (s^-1)",
    "droop": "decrease of the belt's speed under the load Fs (m/s)",
    "ripple": "amplitude of the belt's varying speed (m/s)",
    "ripple_hz": "frequency of the belt's varying speed (Hz)",
    "x0 + Fs/k": "position of break-away, which can be known even if x0 and Fs/k are not (m)",
    "(G_slip - c)": "difference of the two, which can be known even if they are not (N s/m)",
}
ALWAYS = ("x", "v", "w", "s", "F", "m")


def formula(law: Law) -> str:
    curve = law.formula.replace("*", " ") if law.number else law.formula
    return _contact(law, f"({curve})", "F(0)")


def typeset(law: Law) -> tuple[str, str]:
    """Return the curve of a law as MathML, and its contact in plain text."""
    if law.own_memory:
        return typeset_formula(law.formula), _contact(law, "f(s, z)", "")
    return typeset_formula(law.formula), _contact(law, "f(s)", "f(0)")


def _contact(law: Law, curve: str, at_rest: str) -> str:
    if law.ramp:
        level = "Fs" if law.number else at_rest
        return f"F = -{level} w/d for |w| <= d, else -sign(w) {curve} with s = |w| - d"
    state = f", z' = {law.rate}" if law.own_memory else ""
    return f"F = -sign(w) {curve} with s = |w|{state}"


def symbols(parameters: Iterable[str]) -> list[tuple[str, str]]:
    """Return symbol and meaning of every formula's symbols and of these parameters."""
    used = {name.removesuffix("/m") for name in parameters} | {"k", "c", "x0", "Fs", "v_dr"}
    return [(symbol, pretty(text)) for symbol, text in SYMBOLS.items() if symbol in ALWAYS or symbol in used]


def pretty(text: str) -> str:
    powers = (("^-1", "⁻¹"), ("^-2", "⁻²"), ("^2", "²"), ("^3", "³"), ("**2", "²"))
    signs = (*powers, (" +- ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}"), (" um", " µm"))
    text = re.sub(r"(?<=[\w)])\*(?=[\w(])", "\N{MIDDLE DOT}", re.sub(r"\bgamma\b", GREEK["gamma"], text))
    for plain, typeset in signs:
        text = text.replace(plain, typeset)
    return text
