"""Published forms of a friction curve, compared with the measured one.

A form is a law whose formula is projected on the measured curve in the metric of the record (`fitting.curve.metric`),
as every formula is before its fit (`fitting.driver.start_search`).  Forms are compared by BIC.

=====================  =========================================  ==================================================
name                   friction at slip speed s                   source
=====================  =========================================  ==================================================
constant               Fs                                         C. A. Coulomb (1785)
linear                 Fs - G s                                   law 3 and 4 (`rig_sim.friction.law`)
hyperbolic             Fs/(1 + gamma s)                           law 5 and 6 (`rig_sim.friction.law`)
stribeck-exponential   Fc + (Fs - Fc) exp(-s/vs)                  A. Tustin, J. IEE 94 (1947) 143
stribeck-gaussian      Fc + (Fs - Fc) exp(-(s/vs)^2)              B. Armstrong-Helouvry et al., Automatica 30 (1994)
(each + viscous)       ... + Fv s                                 the same
logarithmic            Fs - b ln(1 + s/v0)                        J. Dieterich, JGR 84 (1979) 2161; steady state
power                  Fs - b (s/smax)^p                          E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668
polynomial             a0 + a1 s + a2 s^2 + a3 s^3                R. Ibrahim, Appl. Mech. Rev. 47 (1994) 209
=====================  =========================================  ==================================================
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.curve.metric import measured_target
from fitting.curve.result import FormFit
from fitting.curve.spline_fit import SplineFit
from fitting.distributions import chi_square_quantile, normal_quantile
from fitting.driver.start_search import StartSearch
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Parameter
from fitting.law import PUBLISHED, Law
from fitting.undetermined import natural_size
from stickslip.compute.arrays import Array

CONFIDENCE = 0.95  # confidence of the intervals, and of a form inside the band
LEAST_SEEN = 1e-10  # singular value over that of the best known combination of a form's parameters: less is rounding
# Ends of the speed over which friction falls, over the largest slip speed: beyond them the fall lies below the slowest
# speed, or the curve is straight.
FALLS = (2e-3, 1e2)
TUSTIN = "A. Tustin, J. IEE 94 (1947) 143"
ARMSTRONG = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083"
DIETERICH = "J. Dieterich, J. Geophys. Res. 84 (1979) 2161"
IBRAHIM = "R. Ibrahim, Appl. Mech. Rev. 47 (1994) 209"
WRITTEN = {"**": "^", "*": " ", "log": "ln", "_": ""}  # as people write a formula, what a law has


class Form(NamedTuple):
    """A published form."""

    name: str
    law: Law  # a speed that it fixes is replaced by the largest slip speed
    source: str
    bend: str | None = None  # the parameter that bends the curve, fitted by its logarithm, the only one with bounds
    reach: tuple[float, float] = FALLS  # bounds of ``bend`` over its `natural_size`

    def on(self, friction: float, fastest: float) -> Law:
        fix = dict.fromkeys(self.law.fix or {}, fastest)
        if self.bend is None:
            return replace(self.law, bounds=None, fix=fix)
        size = natural_size(self.law, self.bend, friction, fastest)
        return replace(self.law, bounds={self.bend: (self.reach[0] * size, self.reach[1] * size)}, fix=fix)


POSITIVE = {"Fs": (0.0, None)}
FORMS = (
    Form("constant", Law("constant", "Fs", bounds=POSITIVE), "C. A. Coulomb (1785)"),
    Form("linear", Law("linear", "Fs - G*s", bounds=POSITIVE), "law 3 and 4"),
    Form("hyperbolic", Law("hyperbolic", "Fs/(1 + gamma*s)", bounds=POSITIVE), "law 5 and 6", "gamma", (1e-4, 1e5)),
    Form("stribeck-exponential", PUBLISHED["stribeck"], TUSTIN, "v_s"),
    Form("stribeck-exponential-viscous", PUBLISHED["stribeck-viscous"], TUSTIN, "v_s"),
    Form("stribeck-gaussian", PUBLISHED["stribeck-gaussian"], ARMSTRONG, "v_s"),
    Form("stribeck-gaussian-viscous", PUBLISHED["stribeck-gaussian-viscous"], ARMSTRONG, "v_s"),
    Form("logarithmic", PUBLISHED["logarithmic"], DIETERICH, "v_0", (1e-12, 1e3)),  # v0 of rocks is 1e-6 m/s
    Form("power", PUBLISHED["power"], "E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668", "p", (1e-2, 2e1)),
    Form("polynomial", Law("polynomial", "a0 + a1*s + a2*s**2 + a3*s**3"), IBRAHIM),
)
FORM_OF_LAW = {form.law.name: form.name for form in FORMS if form.law.name in PUBLISHED}


def fit_forms(fit: SplineFit, linear: LinearisedFit, speeds: Array) -> tuple[FormFit, ...]:
    """Compare all forms with a curve, best first; ``speeds`` (k,) are slip speeds beyond the ramp, m/s."""
    target, samples = measured_target(fit, linear), fit.solution.residual.size
    near, shown = target.near, target.alone.aim.size
    found = []
    for form in FORMS:
        search = StartSearch(form.on(near.size, float(near.speeds[-1])), near)
        found.append(_fitted(form, search, shown, samples, speeds))
    return tuple(sorted(found, key=lambda row: row.bic))


def _fitted(form: Form, search: StartSearch, shown: int, samples: int, speeds: Array) -> FormFit:
    """Return the nearest curve of a form by the ``shown`` distances that count, of so many ``samples``."""
    law, start = search.law, search.nearest()
    values = start.values
    sizes = np.array([values[name] if name == form.bend else search.sizes[name] for name in law.free])
    slopes = search.sloped(values, law.free)
    if slopes is None:
        raise RuntimeError("a form has derivatives where it is nearest")
    inverse = np.linalg.pinv(slopes * sizes, rcond=LEAST_SEEN) * sizes[:, None]
    deviations = dict(zip(law.free, np.linalg.norm(inverse, axis=1).tolist(), strict=True))
    freedom, quantile = max(shown - len(law.free), 1), normal_quantile(0.5 + CONFIDENCE / 2)
    fall = None
    if "Fc" in law.free:
        at = [law.free.index(name) for name in ("Fs", "Fc")]
        error = float(np.linalg.norm(inverse[at[0]] - inverse[at[1]]))
        fall = replace(Parameter.around(values["Fs"] - values["Fc"], error, quantile), unit=law.unit("Fs"))
    parameters = {}
    for name in sorted(law.free, key=lambda name: (name != "Fs", law.free.index(name))):
        limits = form.law.limits(name)
        item = Parameter.around(values[name], deviations[name], quantile, limits, by_log=name == form.bend)
        parameters[_written(name)] = replace(item, unit=law.unit(name))
    fixed = {name: f"{value:.4g} m/s" for name, value in (law.fix or {}).items()}
    return FormFit(
        name=form.name,
        formula=_written(form.law.formula, fixed),
        source=form.source,
        parameters=parameters,
        fall=fall,
        misfit=start.misfit,
        chi=math.sqrt(start.misfit / freedom),
        bic=start.misfit + len(law.free) * math.log(samples),
        inside_band=bool(start.misfit <= chi_square_quantile(CONFIDENCE, freedom)),
        values=law.curve.value(speeds, values | dict(law.fix or {})),
    )


def _written(text: str, named: dict[str, str] | None = None) -> str:
    """Return a formula or name in the usual notation, with replacements for some names."""
    for old, new in ((named or {}) | WRITTEN).items():
        text = text.replace(old, new)
    return text
