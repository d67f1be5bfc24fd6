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

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.compute.distributions import chi_square_quantile, normal_quantile
from fitting.curve.result import FormFit
from fitting.curve.spline_fit import SplineFit
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Parameter
from fitting.least_squares.normal_equations import eigen
from fitting.model.parameters import Global

GRID_SPEEDS = 300  # speeds at which a form is projected on the spline, as dense as the knots
CONFIDENCE = 0.95  # confidence of the intervals, and of a form inside the band
# Unit of each kind of parameter, and the powers of friction and speed in it.
KINDS = {
    "friction": ("m s^-2", 1, 0),  # not negative
    "force": ("m s^-2", 1, 0),
    "force/speed": ("s^-1", 1, -1),
    "force/speed^2": ("m^-1", 1, -2),
    "force/speed^3": ("s m^-2", 1, -3),
    "speed": ("m/s", 0, 1),
    "1/speed": ("s/m", 0, -1),
    "": ("", 0, 0),
}
LOW_COEFFICIENTS = 2  # coefficients, which act below a twentieth of the largest slip speed
LEAST_INFORMATION = 1e-12  # information over the largest: less is rounding
LEAST_SEEN = 1e-10  # singular value over that of the best known combination of a form's parameters: less is rounding
# The parameter that is not linear: values tried over its range, and how often each bracket of a minimum is divided
# again.  Half as many over the range still find the same minima; each division narrows the bracket four times.
TRIED, DIVISIONS, DIVIDED = 60, 11, 9
SLOPE_STEP = 1e-5  # step of its logarithm: central differences err by 1e-10


class Term(NamedTuple):
    """One parameter of a form: its name, what it measures, and whether the form is not linear in it."""

    name: str
    kind: str
    bends: bool = False


class Form(NamedTuple):
    """A form with y friction over its size at rest and x the slip speed over the largest.

    ``columns`` (x, bend) gives what a unit of each linear parameter adds to y, in the order of ``terms``; ``bend`` is
    the one parameter in which the form is not linear, positive, within ``reach``.
    """

    name: str
    formula: str
    source: str
    terms: tuple[Term, ...]
    columns: Callable[[Array, float], tuple[Array, ...]]
    reach: tuple[float, float] = (1.0, 1.0)


FS, FC, VS, FV = Term("Fs", "friction"), Term("Fc", "friction"), Term("vs", "speed", True), Term("Fv", "force/speed")
TUSTIN = "A. Tustin, J. IEE 94 (1947) 143"
ARMSTRONG = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083"
# Beyond them the fall lies below the slowest speed, or the curve is straight.
FALLS = (2e-3, 1e2)


def _stribeck(power: int, viscous: bool) -> Callable[[Array, float], tuple[Array, ...]]:
    def columns(x: Array, vs: float) -> tuple[Array, ...]:
        fall = np.exp(-((x / vs) ** power))
        return (fall, 1 - fall, x) if viscous else (fall, 1 - fall)

    return columns


FORMS = (
    Form("constant", "Fs", "C. A. Coulomb (1785)", (FS,), lambda x, _: (np.ones_like(x),)),
    Form("linear", "Fs - G s", "law 3 and 4", (FS, Term("G", "force/speed")), lambda x, _: (np.ones_like(x), -x)),
    Form(
        "hyperbolic",
        "Fs/(1 + gamma s)",
        "law 5 and 6",
        (FS, Term("gamma", "1/speed", True)),
        lambda x, gamma: (1 / (1 + gamma * x),),
        (1e-4, 1e5),
    ),
    Form(
        "stribeck-exponential",
        "Fc + (Fs - Fc) exp(-s/vs)",
        TUSTIN,
        (FS, FC, VS),
        _stribeck(1, viscous=False),
        FALLS,
    ),
    Form(
        "stribeck-exponential-viscous",
        "Fc + (Fs - Fc) exp(-s/vs) + Fv s",
        TUSTIN,
        (FS, FC, VS, FV),
        _stribeck(1, viscous=True),
        FALLS,
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
        FALLS,
    ),
    Form(
        "logarithmic",
        "Fs - b ln(1 + s/v0)",
        "J. Dieterich, J. Geophys. Res. 84 (1979) 2161",
        (FS, Term("b", "force"), Term("v0", "speed", True)),
        lambda x, v0: (np.ones_like(x), -np.log1p(x / v0)),
        (1e-12, 1e3),  # v0 of rocks is a micrometre a second
    ),
    Form(
        "power",
        "Fs - b (s/{fastest:.4g} m/s)^p",
        "E. Rabinowicz, Proc. Phys. Soc. 71 (1958) 668",
        (FS, Term("b", "force"), Term("p", "", True)),
        lambda x, p: (np.ones_like(x), -(x**p)),
        (1e-2, 2e1),
    ),
    Form(
        "polynomial",
        "a0 + a1 s + a2 s^2 + a3 s^3",
        "R. Ibrahim, Appl. Mech. Rev. 47 (1994) 209",
        (Term("a0", "force"), Term("a1", "force/speed"), Term("a2", "force/speed^2"), Term("a3", "force/speed^3")),
        lambda x, _: (np.ones_like(x), x, x**2, x**3),
    ),
)


class Metric(NamedTuple):
    """What a form is compared with, in the directions of the curve's coefficients that the record shows.

    A form with coefficients c is at the distance root c - aim from what the record alone says, without the prior on the
    curve; ``root`` (m, n) makes each of the m distances one of unit variance.  ``samples`` is how many positions there
    are.
    ``level_sd`` (m/s^2) is that of a constant by which the whole curve may be off, beyond what these say.
    """

    root: Array
    aim: Array
    samples: int
    level_sd: float


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
    if fit.rest is not None:  # taken as known here: how far it may be off is `Metric.level_sd`
        known = fit.places.index(Global.DATUM)
        data[known], data[:, known], prior[known, known], gradient[known] = 0.0, 0.0, 1.0, 0.0
    first = places + LOW_COEFFICIENTS
    others = data[:first, :first] + prior[:first, :first]
    cross = data[first:, :first]
    follow = followed(others, cross)
    own = data[first:, first:] - np.einsum("ik,kj->ij", cross, follow)
    size, axes = eigen(0.5 * (own + own.T))
    # shown is what the record knows better than the prior
    held = np.einsum("ik,ij,jk->k", axes, prior[first:, first:], axes)
    shown = size > np.maximum(held, LEAST_INFORMATION * size.max())
    deviation = np.sqrt(size[shown])
    root = np.zeros((deviation.size, n))
    root[:, LOW_COEFFICIENTS:] = deviation[:, None] * axes[:, shown].T
    # where the record alone would have the curve: not pulled by its prior, and at the very minimum
    pull = gradient[first:] - np.einsum("ki,k->i", follow, gradient[:first])
    aim = np.einsum("ki,i->k", root, fit.spline.coefficients)
    aim -= np.einsum("ik,i->k", axes[:, shown], pull) / deviation
    excess = max(fit.chi, 1.0)
    level_sd = 0.0 if fit.rest is None else fit.fit.values.K * fit.rest.sd
    return Metric(root / excess, aim / excess, fit.solution.residual.size, level_sd)


def followed(curvature: Array, cross: Array) -> Array:
    """Return by how much some unknowns (p,) follow others (n,): inv(curvature) cross', shape (p, n).

    By a solution: an inverse left the weakest direction, 1e-8 of the strongest, to rounding, and forms that differed
    from the curve along it then cost nothing.  An unknown that elimination left no curvature, as where the search for
    the curve failed, does not move.
    """
    found = np.zeros(cross.T.shape)
    seen = np.diag(curvature) > 0
    scale = 1 / np.sqrt(np.diag(curvature)[seen])
    scaled = curvature[np.ix_(seen, seen)] * scale[:, None] * scale
    found[seen] = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * cross.T[seen])
    return found


def _fit_form(form: Form, fit: SplineFit, metric: Metric, speeds: Array) -> FormFit:
    fastest, size = float(fit.spline.knots[-1]), float(np.median(fit.spline.coefficients))
    x = np.linspace(0.0, 1.0, GRID_SPEEDS) ** 1.6
    onto = size * np.einsum("ij,jg->ig", metric.root, fit.spline.projection(x * fastest))

    aim = metric.aim
    constant = np.zeros((aim.size, 0))
    if metric.level_sd > 0:  # one unknown more, and what is known of it
        constant = np.append(size * metric.root.sum(axis=1), size / metric.level_sd)[:, None]
        onto, aim = np.append(onto, np.zeros((1, GRID_SPEEDS)), axis=0), np.append(aim, 0.0)

    def columns(bend: float) -> Array:
        return np.hstack((np.einsum("ig,lg->il", onto, np.stack(form.columns(x, bend))), constant))

    bend = best_bend(columns, aim, *form.reach)
    slopes = columns(bend)
    linear = np.linalg.lstsq(slopes, aim, rcond=None)[0]
    misfit = float(np.sum((np.einsum("il,l->i", slopes, linear) - aim) ** 2))
    bends = [i for i, term in enumerate(form.terms) if term.bends]
    values = np.insert(linear, bends, math.log(bend))
    linear_terms = linear[: len(form.terms) - len(bends)]
    if bends:
        beside = columns(bend * math.exp(SLOPE_STEP)) - columns(bend * math.exp(-SLOPE_STEP))
        slopes = np.insert(slopes, bends, np.einsum("il,l->i", beside, linear)[:, None] / (2 * SLOPE_STEP), axis=1)
    count = len(form.terms)
    freedom = max(metric.aim.size - count, 1)
    inverse = np.linalg.pinv(slopes, rcond=LEAST_SEEN)
    deviations = np.linalg.norm(inverse, axis=1)
    quantile = normal_quantile(0.5 + CONFIDENCE / 2)
    parameters = {}
    for term, value, error in zip(form.terms, values[:count], deviations[:count], strict=True):
        unit, force, speed = KINDS[term.kind]
        factor = size**force * fastest**speed
        ends = [value - quantile * error, value, value + quantile * error]
        lo, middle, hi = factor * (np.exp(np.clip(ends, -300, 300)) if term.bends else np.array(ends))
        if term.kind == "friction":
            lo = max(lo, 0.0)
        parameters[term.name] = Parameter(
            float(middle), float(error * (middle if term.bends else factor)), float(lo), float(hi), unit
        )
    fall = None
    if form.terms[:2] == (FS, FC):
        value, error = size * float(values[0] - values[1]), size * float(np.linalg.norm(inverse[0] - inverse[1]))
        fall = Parameter(value, error, value - quantile * error, value + quantile * error, KINDS["friction"][0])
    return FormFit(
        name=form.name,
        formula=form.formula.format(fastest=fastest),
        source=form.source,
        parameters=parameters,
        fall=fall,
        misfit=misfit,
        chi=float(np.sqrt(misfit / freedom)),
        bic=misfit + count * float(np.log(metric.samples)),
        inside_band=bool(misfit <= chi_square_quantile(CONFIDENCE, freedom)),
        values=np.asarray(size * np.einsum("l,lk->k", linear_terms, np.stack(form.columns(speeds / fastest, bend)))),
    )


def best_bend(columns: Callable[[float], Array], aim: Array, low: float, high: float) -> float:
    """Return the parameter between ``low`` and ``high`` with which the linear ones come nearest to ``aim`` (m,).

    What they leave is the part of ``aim`` outside the space of their columns.
    """
    if low == high:
        return low
    found: list[tuple[float, float]] = []
    for first, last in _brackets(columns, aim, np.linspace(math.log(low), math.log(high), TRIED)):
        begin, end, least = first, last, math.inf
        for _ in range(DIVISIONS):
            tried = np.linspace(begin, end, DIVIDED)
            left = _left(columns, aim, tried)
            best = int(np.argmin(left))
            begin, end, least = tried[max(best - 1, 0)], tried[min(best + 1, DIVIDED - 1)], float(left[best])
        found.append((least, 0.5 * (begin + end)))
    return math.exp(min(found)[1])


def _brackets(columns: Callable[[float], Array], aim: Array, tried: Array) -> list[tuple[float, float]]:
    """Return the neighbours of every local minimum among ``tried`` (k,).

    On fine records the valley of the true value is so narrow that a wide one elsewhere is lower on the grid.
    """
    left = np.pad(_left(columns, aim, tried), 1, constant_values=np.inf)
    lowest = np.flatnonzero((left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:]))
    return [(float(tried[max(i - 1, 0)]), float(tried[min(i + 1, tried.size - 1)])) for i in lowest.tolist()]


def _left(columns: Callable[[float], Array], aim: Array, tried: Array) -> Array:
    """Return the square (k,) of what is left of ``aim`` (m,) at each logarithm of the parameter in ``tried`` (k,)."""
    spaces = np.linalg.qr(np.stack([columns(math.exp(value)) for value in tried])).Q
    away = aim - np.einsum("tml,tl->tm", spaces, np.einsum("tml,m->tl", spaces, aim))
    return np.asarray(np.sum(away**2, axis=1))
