"""Formulas and symbols of the laws, in words and plain text: for the report, the run file and the documentation."""

from collections.abc import Iterable

from fitting.law import Law
from fitting.report import mathml

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
    "Fs": "friction level: friction as slip begins, the mean of the record (N); Fs/m in m s^-2",
    "Fs/k": "stretch of the spring that the friction level holds (m)",
    "v_dr": "speed of the belt, positive towards +x (m/s)",
    "gamma": "how fast friction falls with slip speed: to a half at s = 1/gamma (s/m)",
    "G_slip": "decrease of friction per slip speed (N s/m)",
    "d": "half-width of the ramp through w = 0 (m/s)",
    "static": "break-away level of a ramp law, over Fs",
    "x0": "position at which the spring is at rest, as the record reads it (m)",
    "c": "viscous damping of the mass (N s/m); c/m in s^-1",
    "Fs0": "friction level when the recording began (N)",
    "wear": "fraction of the friction level that is lost per second (s^-1)",
    "droop": "decrease of the belt's speed under the load Fs (m/s)",
    "ripple": "amplitude of the belt's varying speed (m/s)",
    "ripple_hz": "frequency of the belt's varying speed (Hz)",
    "x0 + Fs/k": "where the mass breaks away: known where x0 and Fs/k apart are not (m)",
    "(G_slip - c)": "how much friction falls faster than damping grows: known where the two apart are not (N s/m)",
}
ALWAYS = ("x", "v", "w", "s", "F", "m")


def formula(law: Law) -> str:
    curve = law.formula.replace("*", " ") if law.number else law.formula
    return _contact(law, f"({curve})", "F(0)")


def typeset(law: Law) -> tuple[str, str]:
    """Return the curve of a law as MathML, and its contact in words."""
    return mathml.typeset(law.formula), _contact(law, "f(s)", "f(0)")


def _contact(law: Law, curve: str, at_rest: str) -> str:
    if law.ramp:
        level = "Fs" if law.number else at_rest
        return f"F = -{level} w/d for |w| <= d, else -sign(w) {curve} with s = |w| - d"
    return f"F = -sign(w) {curve} with s = |w|"


def symbols(parameters: Iterable[str]) -> list[tuple[str, str]]:
    """Return each symbol and its meaning: those of every formula, and those of the named parameters."""
    used = {name.removesuffix("/m") for name in parameters} | {"k", "c", "x0", "Fs", "v_dr"}
    return [(symbol, pretty(text)) for symbol, text in SYMBOLS.items() if symbol in ALWAYS or symbol in used]


def pretty(text: str) -> str:
    """Return words or a unit with raised exponents and the letter mu."""
    signs = (("^-1", "⁻¹"), ("^-2", "⁻²"), ("^2", "²"), ("^3", "³"), (" +- ", " ± "), (" um", " µm"))
    for plain, typeset in signs:
        text = text.replace(plain, typeset)
    return text
