"""Rivals of the six: published forms that the measured curve prefers, fitted to the record and judged beside them.

A rival is fitted where the information criterion of its form on the measured curve is below that of every form of the
six.  What is evidence and who is in the set is decided as between the six (`fitting.selection.evidence`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fitting.curve.formula_fit import FormulaFit, fit_formula
from fitting.curve.result import FormFit, MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit
from fitting.estimation.result import Parameter
from fitting.law import PUBLISHED, Law
from fitting.model.problem import Run
from fitting.selection import evidence
from fitting.selection.evidence import OPEN, Candidate, Evidence, ModelSet

OF_THE_SIX = ("constant", "linear", "hyperbolic")
# Of each law: its form of the measured curve, and the form's names of its parameters.
FORM = {
    "stribeck": ("stribeck-exponential", {"v_s": "vs"}),
    "stribeck-viscous": ("stribeck-exponential-viscous", {"v_s": "vs"}),
    "stribeck-gaussian": ("stribeck-gaussian", {"v_s": "vs"}),
    "stribeck-gaussian-viscous": ("stribeck-gaussian-viscous", {"v_s": "vs"}),
    "logarithmic": ("logarithmic", {"v_0": "v0"}),
    "power": ("power", {}),
}


@dataclass(frozen=True, eq=False)
class RivalResult:
    """A row of the ranking for a law given as a formula.

    Attributes
    ----------
    law : str
        Its name.
    formula : str
    asked : bool
        Whether it was asked for; else the measured curve prefers it.
    score, weight, in_set, rms_m, cycles, parameters, cpu_s, behind
        As `fitting.selection.result.LawResult`.
    fit : FormulaFit
    """

    law: str
    formula: str
    asked: bool
    score: float
    weight: float
    in_set: bool
    rms_m: float
    cycles: int
    parameters: dict[str, Parameter]
    cpu_s: float
    behind: tuple[float, float]
    fit: FormulaFit = field(repr=False)

    @property
    def name(self) -> str:
        """The law's name in words."""
        return self.law.replace("-", " ")

    def as_json(self) -> dict[str, Any]:
        """Return the document's form."""
        shown = ("law", "name", "formula", "asked", "score", "weight", "in_set", "rms_m", "cycles")
        document: dict[str, Any] = {name: getattr(self, name) for name in shown}
        fixed = self.fit.formula.fix or {}
        document["parameters"] = {
            name: item.as_json() | ({"fixed": True} if name in fixed else {}) for name, item in self.parameters.items()
        }
        return document | {"outside_band": None, "orbit_distance": None, "cpu_s": self.cpu_s}


@dataclass(frozen=True, eq=False)
class Competition:
    """The six and their rivals together.

    Attributes
    ----------
    chosen : ModelSet
        Of the six: members are those of the combined set, scores and weights those beside the rivals.
    rivals : tuple of RivalResult
        Best first.
    """

    chosen: ModelSet
    rivals: tuple[RivalResult, ...]

    @property
    def beaten(self) -> bool:
        """Whether rivals leave none of the six in the set."""
        return not self.chosen.members

    @property
    def lead(self) -> float:
        """By how much the best rival leads the best of the six, in log evidence; negative where it does not."""
        return 0.5 * (min(self.chosen.score.values()) - min(rival.score for rival in self.rivals))

    def inside_band(self, curve: MeasuredCurve | None) -> list[FormulaFit]:
        """Return the rivals of the set whose forms lie inside the band of the measured curve: they describe it."""
        inside = {form.name for form in curve.forms if form.inside_band} if curve is not None else set()
        return [row.fit for row in self.rivals if row.in_set and FORM[row.law][0] in inside]


def preferred_forms(forms: Sequence[FormFit]) -> list[tuple[Law, FormFit]]:
    """Return the published laws whose forms the measured curve prefers to those of the six, best first.

    Those that it hardly distinguishes from the best of them are among them.
    """
    by_name = {form.name: form for form in forms}
    limit = min(by_name[name].bic for name in OF_THE_SIX)
    found = [(PUBLISHED[name], by_name[form]) for name, (form, _) in FORM.items() if by_name[form].bic < limit]
    least = min((form.bic for _, form in found), default=0.0)
    return sorted(((law, form) for law, form in found if form.bic < least + OPEN), key=lambda one: one[1].bic)


def fit_rivals(curve: MeasuredCurve) -> list[FormulaFit]:
    """Fit the laws whose forms the measured curve prefers; those whose motion cannot be followed are missing."""
    host = curve.spline_fit
    ramp = bool(host.path.curve.ramp)
    fits = (fit_formula(replace(law, ramp=ramp), host) for law, _ in preferred_forms(curve.forms))
    return [fit for fit in fits if fit is not None]


def compete(
    fits: Sequence[Fit],
    chosen: ModelSet,
    rivals: Sequence[FormulaFit],
    runs: Sequence[Run],
    motion: MeasuredMotion,
    alpha: float,
    *,
    asked: Mapping[str, Law] | None = None,
) -> Competition:
    """Judge the six and their rivals by the same evidence and set rule.

    Parameters
    ----------
    fits : sequence of Fit
        Of the six.
    chosen : ModelSet
        Of the six alone: between themselves they are judged without rivals, which beat all of its set or none.
    rivals : sequence of FormulaFit
    runs : sequence of Run
    motion : MeasuredMotion
        Of the first run: its mass or stiffness turns parameters into newtons.
    alpha : float
    asked : mapping of str to Law, optional
        The rivals that were asked for.
    """
    every: list[Candidate] = [*fits, *rivals]
    units = evidence.common_units(every, runs, sustained=True)
    errors = np.array([evidence.penalised(fit, evidence.unit_errors(fit, runs, units), units) for fit in every])
    together = evidence.model_confidence_set(Evidence(tuple(fit.law for fit in every), errors, units.samples), alpha)
    led_by_rival = isinstance(min(together.score, key=together.score.__getitem__), str)
    left = not led_by_rival or any(law in together.members for law in chosen.members)
    members = chosen.members if left else ()
    lag = min(together.score[fit.law] for fit in fits)
    score = {law: own + lag for law, own in chosen.score.items()} | {fit.law: together.score[fit.law] for fit in rivals}
    total = sum(math.exp(-own / 2) for own in score.values())
    weight = {law: math.exp(-own / 2) / total for law, own in score.items()}
    six = ModelSet(
        order=(*members, *(law for law in chosen.order if law not in members)),
        members=members,
        score={law: score[law] for law in chosen.score},
        weight={law: weight[law] for law in chosen.weight},
        behind={law: together.behind[law] if led_by_rival else own for law, own in chosen.behind.items()},
    )
    rows = [
        RivalResult(
            law=fit.law,
            formula=fit.formula.formula,
            asked=fit.law in (asked or {}),
            score=score[fit.law],
            weight=weight[fit.law],
            in_set=fit.law in together.members,
            rms_m=fit.rms,
            cycles=len(fit.rows),
            parameters=_in_newtons(fit, motion, fit.parameters(alpha)),
            cpu_s=fit.cpu_s,
            behind=together.behind[fit.law],
            fit=fit,
        )
        for fit in rivals
    ]
    return Competition(six, tuple(sorted(rows, key=lambda row: row.score)))


def _in_newtons(fit: FormulaFit, motion: MeasuredMotion, found: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """Return the parameters by name; those with a friction in their unit also per unit mass, as ``NAME/m``.

    With a mass or a stiffness the first are in newtons.
    """
    K = found["k/m"].value
    mass = motion.mass.value if motion.mass else motion.stiffness.value / K if motion.stiffness else None
    known = motion.mass or motion.stiffness
    out: dict[str, Parameter] = {}
    for name, item in found.items():
        force, _ = fit.formula.dimensions.get(name, (0, 0))
        sign = motion.sign if name == "v_dr" else 1.0
        if name in ("k/m", "v_dr") or not force:
            lo, hi = sorted((sign * item.lo, sign * item.hi))
            out[name] = Parameter(sign * item.value, item.stderr, lo, hi, item.unit)
            continue
        out[f"{name}/m"] = item
        if mass is None or known is None:
            out[name] = item
            continue
        factor = mass**force
        spread = math.hypot(item.stderr * factor, force * item.value * factor * known.sd / known.value)
        wider = spread / (item.stderr * factor) if item.stderr > 0 else 1.0
        value = item.value * factor
        lo, hi = (value + wider * factor * (end - item.value) for end in (item.lo, item.hi))
        out[name] = Parameter(value, spread, lo, hi, fit.formula.unit(name, newtons=True))
    return out
