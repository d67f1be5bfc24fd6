"""Published forms of a friction curve, fitted to the measured one.

A form is fitted in the metric of the record: minimised is (c(form) - c)' I (c(form) - c), c the coordinates of the
measured curve and I the information on them with everything else fitted again.  What the record does not show does not
count.  Forms are compared by BIC.

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
power                  Fs - b (s/smax)^p                           E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668
polynomial             a0 + a1 s + a2 s^2 + a3 s^3                R. Ibrahim, Appl. Mech. Rev. 47 (1994) 209
=====================  =========================================  ==================================================
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from daq.compute.arrays import Array
from fitting.curve.result import FormFit
from fitting.curve.spline_fit import SplineFit, project
from fitting.estimation.covariance import scaled_inverse
from fitting.estimation.levenberg_marquardt import eigen
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Parameter

GRID = 300  # speeds at which a form is projected on the spline, as dense as the knots
CONFIDENCE = 0.95
# Unit of each kind of parameter, and the powers of friction and speed in it.
KINDS = {
    "force": ("m s^-2", 1, 0),
    "force/speed": ("s^-1", 1, -1),
    "force/speed^2": ("m^-1", 1, -2),
    "force/speed^3": ("s m^-2", 1, -3),
    "speed": ("m/s", 0, 1),
    "1/speed": ("s/m", 0, -1),
    "": ("", 0, 0),
}
LOWEST = 2  # coefficients, which act below a twentieth of the largest slip speed
ROUNDING = 1e-12  # of the largest information
MOST_CALLS = 60  # of a form from one start


class Term(NamedTuple):
    """One parameter of a form: its name, what it measures, and whether its logarithm is fitted."""

    name: str
    kind: str
    log: bool = False


class Form(NamedTuple):
    """A form y(x; parameters) with y friction over its size at rest and x the slip speed over the largest."""

    name: str
    formula: str
    source: str
    terms: tuple[Term, ...]
    value: Callable[[Array, Array], Array]
    starts: tuple[tuple[float, ...], ...]


FS, FC, VS, FV = Term("Fs", "force"), Term("Fc", "force"), Term("vs", "speed", True), Term("Fv", "force/speed")
TUSTIN = "A. Tustin, J. IEE 94 (1947) 143"
ARMSTRONG = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083"
FALLS = tuple((1.0, level, speed) for level in (0.4, 0.7) for speed in (0.05, 0.15, 0.4))


def _stribeck(power: int, viscous: bool) -> Callable[[Array, Array], Array]:
    def value(x: Array, p: Array) -> Array:
        fall = p[1] + (p[0] - p[1]) * np.exp(-((x / p[2]) ** power))
        return np.asarray(fall + p[3] * x if viscous else fall)

    return value


FORMS = (
    Form("constant", "Fs", "C. A. Coulomb (1785)", (FS,), lambda x, p: p[0] + 0 * x, ((1.0,),)),
    Form(
        "linear", "Fs - G s", "law 3 and 4", (FS, Term("G", "force/speed")), lambda x, p: p[0] - p[1] * x, ((1.0, 0.1),)
    ),
    Form(
        "hyperbolic",
        "Fs/(1 + gamma s)",
        "law 5 and 6",
        (FS, Term("gamma", "1/speed", True)),
        lambda x, p: p[0] / (1 + p[1] * x),
        ((1.0, 1.0), (1.0, 8.0)),
    ),
    Form("stribeck-exponential", "Fc + (Fs - Fc) exp(-s/vs)", TUSTIN, (FS, FC, VS), _stribeck(1, viscous=False), FALLS),
    Form(
        "stribeck-exponential-viscous",
        "Fc + (Fs - Fc) exp(-s/vs) + Fv s",
        TUSTIN,
        (FS, FC, VS, FV),
        _stribeck(1, viscous=True),
        tuple((*start, 0.1) for start in FALLS),
    ),
    Form(
        "stribeck-gaussian",
        "Fc + (Fs - Fc) exp(-(s/vs)^2)",
        ARMSTRONG,
        (FS, FC, VS),
        _stribeck(2, viscous=False),
        FALLS,
    ),
    Form(
        "stribeck-gaussian-viscous",
        "Fc + (Fs - Fc) exp(-(s/vs)^2) + Fv s",
        ARMSTRONG,
        (FS, FC, VS, FV),
        _stribeck(2, viscous=True),
        tuple((*start, 0.1) for start in FALLS),
    ),
    Form(
        "logarithmic",
        "Fs - b ln(1 + s/v0)",
        "J. Dieterich, J. Geophys. Res. 84 (1979) 2161",
        (FS, Term("b", "force"), Term("v0", "speed", True)),
        lambda x, p: p[0] - p[1] * np.log1p(x / p[2]),
        ((1.0, 0.1, 0.01), (1.0, 0.2, 0.1), (1.0, 0.5, 0.5)),
    ),
    Form(
        "power",
        "Fs - b (s/{fastest:.4g} m/s)^p",
        "E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668",
        (FS, Term("b", "force"), Term("p", "", True)),
        lambda x, p: p[0] - p[1] * x ** p[2],
        ((1.0, 0.4, 0.5), (1.0, 0.4, 1.5)),
    ),
    Form(
        "polynomial",
        "a0 + a1 s + a2 s^2 + a3 s^3",
        "R. Ibrahim, Appl. Mech. Rev. 47 (1994) 209",
        (Term("a0", "force"), Term("a1", "force/speed"), Term("a2", "force/speed^2"), Term("a3", "force/speed^3")),
        lambda x, p: p[0] + x * (p[1] + x * (p[2] + x * p[3])),
        ((1.0, 0.0, 0.0, 0.0),),
    ),
)


class Metric(NamedTuple):
    """What a form is compared with, in the directions of the curve's coefficients that the record shows.

    A form with coefficients c is at the distance root c - aim from what the record alone says, without the prior on the
    curve; ``root`` (m, n) makes each of the m distances one of unit variance.  ``samples`` is how many positions there
    are.
    """

    root: Array
    aim: Array
    samples: int


def fit_forms(fit: SplineFit, linear: LinearisedFit, speeds: Array) -> tuple[FormFit, ...]:
    """Fit all forms to a curve, best first.

    Parameters
    ----------
    fit : SplineFit
    linear : LinearisedFit
        About its solution.
    speeds : (k,) f8
        Slip speeds beyond the ramp, m/s, at which the forms' values are wanted.
    """
    metric = metric_of(fit, linear)
    found = [_fit_form(form, fit, metric, speeds) for form in FORMS]
    return tuple(sorted(found, key=lambda row: row.bic))


def metric_of(fit: SplineFit, linear: LinearisedFit) -> Metric:
    """Return the metric of the record about its curve; where the residuals exceed the noise, as if that were larger.

    The lowest coefficients are fitted again beside each form, as all else: what they do is not linear in them.
    """
    _, total = linear.information()
    places, n = len(fit.places), fit.basis.precision.size
    turn = np.eye(places + n)
    turn[places:] = fit.basis.inverse_slopes  # from coordinates to coefficients
    prior = np.zeros((places + n, places + n))
    prior[places:, places:] = np.diag(fit.basis.precision)
    total, prior, data = (np.einsum("ki,kl,lj->ij", turn, one, turn) for one in (total, prior, total - prior))
    gradient = linear.gradients().sum(axis=0)
    gradient[:places] += linear.prior_gradient[:places]
    gradient = np.einsum("ki,k->i", turn, gradient)
    first = places + LOWEST
    others = data[:first, :first] + prior[:first, :first]
    scale, inverse = scaled_inverse(others, np.diag(others))
    inverse = inverse * scale[:, None] * scale
    cross = data[first:, :first]
    own = data[first:, first:] - np.einsum("ik,kl,jl->ij", cross, inverse, cross)
    size, axes = eigen(0.5 * (own + own.T))
    # shown is what the record knows better than the prior
    held = np.einsum("ik,ij,jk->k", axes, prior[first:, first:], axes)
    shown = size > np.maximum(held, ROUNDING * size.max())
    deviation = np.sqrt(size[shown])
    root = np.zeros((deviation.size, n))
    root[:, LOWEST:] = deviation[:, None] * axes[:, shown].T
    # where the record alone would have the curve: not pulled by its prior, and at the very minimum
    pull = gradient[first:] - np.einsum("ik,kl,l->i", cross, inverse, gradient[:first])
    aim = np.einsum("ki,i->k", root, fit.spline.coefficients)
    aim -= np.einsum("ik,i->k", axes[:, shown], pull) / deviation
    excess = max(fit.chi, 1.0)
    return Metric(root / excess, aim / excess, fit.solution.residual.size)


def _fit_form(form: Form, fit: SplineFit, metric: Metric, speeds: Array) -> FormFit:
    from scipy import stats
    from scipy.optimize import least_squares

    fastest, size = float(fit.spline.knots[-1]), float(np.median(fit.spline.coefficients))
    x = np.linspace(0.0, 1.0, GRID) ** 1.6
    onto = size * np.einsum("ij,jg->ig", metric.root, project(fit.spline, x * fastest))
    logs = np.array([term.log for term in form.terms])

    def natural(p: Array) -> Array:
        return np.where(logs, np.exp(np.clip(p, -30.0, 30.0)), p)

    def distance(p: Array) -> Array:
        return np.asarray(np.einsum("ig,g->i", onto, form.value(x, natural(p))) - metric.aim)

    tried = []
    for start in form.starts:
        first = np.where(logs, np.log(np.where(logs, start, 1.0)), start)
        found = least_squares(distance, first, method="lm", max_nfev=MOST_CALLS * len(start))
        tried.append((2 * float(found.cost), np.asarray(found.x), np.asarray(found.jac)))
    misfit, best, slopes = min(tried, key=lambda row: row[0])
    count = len(form.terms)
    freedom = max(metric.aim.size - count, 1)
    covariance = np.linalg.pinv(np.einsum("ki,kj->ij", slopes, slopes), rcond=1e-14, hermitian=True)
    quantile = float(stats.norm.ppf(0.5 + CONFIDENCE / 2))
    parameters = {}
    for term, value, variance in zip(form.terms, best, np.diag(covariance), strict=True):
        unit, force, speed = KINDS[term.kind]
        factor, error = size**force * fastest**speed, float(np.sqrt(max(variance, 0.0)))
        ends = [value - quantile * error, value, value + quantile * error]
        lo, middle, hi = factor * (np.exp(np.clip(ends, -300, 300)) if term.log else np.array(ends))
        parameters[term.name] = Parameter(
            float(middle), float(error * (middle if term.log else factor)), float(lo), float(hi), unit
        )
    return FormFit(
        name=form.name,
        formula=form.formula.format(fastest=fastest),
        source=form.source,
        parameters=parameters,
        misfit=misfit,
        chi=float(np.sqrt(misfit / freedom)),
        bic=misfit + count * float(np.log(metric.samples)),
        inside_band=bool(misfit <= stats.chi2.ppf(CONFIDENCE, freedom)),
        values=np.asarray(size * form.value(speeds / fastest, natural(best))),
    )
