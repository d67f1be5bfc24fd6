"""A fitted rig as a scene of the simulator: its keys, values and covariance, and the TOML file of them.

Without a mass or a stiffness a record shows forces per unit mass alone.  The scene then has a mass of 1 kg, and its
newtons are per kilogram: times, positions and speeds are those of the rig all the same, and dampings those per kg.

Without a datum the record shows a free curve, and a linear one, but for a constant that moves together with the
spring's rest, and leaves the motion as it is.  The rest is then the one that the curve assumes, or the default that
the fit starts from, or, where friction would fall below `LEAST_FRICTION`, the one that keeps it there; and it is held
in the covariance.

The section ``fit`` names the keys of the scene that were fitted, with their values and covariance in the scene's
units; ``friction.curve.3`` is the friction of the fourth point of a measured curve.  The belt's ripple is left out:
predictions are for a steady belt.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fitting.curve.band import covariances
from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.driver.fit import Fit
from fitting.driver.formula import FormulaCurve
from fitting.driver.task import free_curve
from fitting.estimation.covariance import covariance
from fitting.law import Law
from fitting.least_squares.normal_equations import eigen
from fitting.model.parameters import PER_RUN, Global, PerCycle, Values, columns, values
from fitting.model.problem import datum_calibration
from fitting.model.wear import FEWEST_LEVELS
from fitting.selection.result import Ranking
from processing.statistics import StickSlipStatistics
from stickslip.compute.arrays import Array
from stickslip.errors import DataError
from stickslip.output import atomic
from stickslip.units import Measured

DERIVATIVE_STEP = 1e-6  # step over an unknown or, where that is larger, over its error: derivatives err by 1e-9
# A break-away level above that of slip is written where it exceeds it by this many standard errors, and by this share.
# With 2 errors one in 40 contacts without such a level would be given one; 8 would hide a level twice as high.
STATIC_ERRORS, LEAST_STATIC = 4.0, 0.005
BREAK_AWAY_BLUR = 0.5  # how far smoothing moves a break-away found without a law, over its half-window
LEAST_FRICTION = 0.1  # least friction over a curve's fall: above 0, which changes no motion
# Keys of a scene's section of friction that no parameter of a formula can have (`rig_sim.scenes.checks`).
OWN_KEYS = ("law", "curve", "formula", "contact", "static", "d", "G_stick")
LEAST_SCATTER = 2.0  # scatter of the levels over what noise makes of it: with less the scene has none


class Calibration(NamedTuple):
    """Conversion of the fit's units to a scene's: mass (kg) or stiffness (N/m), and the error of a metre."""

    mass: Measured | None
    stiffness: Measured | None
    length_error: float

    @property
    def errors(self) -> tuple[float, float]:
        """Standard deviations of the mass or stiffness, relative, and of lengths."""
        known = self.mass or self.stiffness
        return (known.sd / known.value if known else 0.0), self.length_error

    def mass_for(self, K: float, factor: float) -> float:
        """Return the mass (kg) for k/m = K, with ``factor`` on the calibration; 1 without one."""
        if self.mass is not None:
            return self.mass.value * factor
        return self.stiffness.value * factor / K if self.stiffness is not None else 1.0


@dataclass(frozen=True, eq=False)
class FittedScene:
    """The contents of the file: keys ``section.key`` in order with their values (n,) and covariance (n, n).

    ``points`` are the slip speeds (m/s) of a measured curve, whose frictions are the last keys; ``scatter`` is the
    standard deviation of the levels, of Fs.  A law given as a formula has its text and ``fixed`` parameters.
    """

    law: int
    keys: tuple[str, ...]
    values: Array
    covariance: Array
    cycles: int
    points: Array
    ramp: bool
    scatter: float
    formula: str = ""
    fixed: Mapping[str, float] = field(default_factory=dict)


def of_ranking(ranking: Ranking, statistics: StickSlipStatistics) -> FittedScene:
    """Return the scene of the best law, or of the measured curve; DataError where neither describes the record.

    ``statistics`` are those of the first run.
    """
    adequacy = ranking.adequacy
    if not adequacy.rejected and ranking.rows:
        fit = ranking.best.fit
        return of_law(ranking, fit) if fit.task.curve.kind else of_formula(ranking, fit)
    if adequacy.curve is None or not adequacy.of_speed or not ranking.rows:
        raise DataError(
            f"no scene: {adequacy.verdict}, and no friction curve describes the record",
            "--save-scene",
            "leave it out; departures in the report may say what is missing",
        )
    return of_curve(ranking, adequacy.curve, statistics)


def of_law(ranking: Ranking, fit: Fit) -> FittedScene:
    motion = ranking.motion
    law = fit.law.kind
    slots = columns(fit.places, len(fit.problem.runs))[0]
    known = slots >= 0
    spread = covariance(fit)[np.ix_(known, known)]
    unknowns_of_run = fit.u[:PER_RUN]
    static = None if law.ramp else _static(ranking)
    names = ["spring.k", "spring.x0", "belt.speed", "damper.c", "friction.Fs"]
    names += {"hyperbolic": ["friction.gamma"], "linear": ["friction.G_slip"], "constant": []}[law.curve]
    names += ["friction.d"] if law.ramp else []
    names += ["friction.static"] if static or Global.STATIC in fit.places else []
    names += ["droop.fraction"] if Global.COMPLIANCE in fit.places else []

    def scene_of(unknowns: Array, calibration: Calibration, factor: float, length: float) -> dict[str, float]:
        u = unknowns_of_run.copy()
        u[slots[known]] = unknowns
        p = values(u)
        m = calibration.mass_for(p.K, factor)
        return _rig_of(p, m, motion.sign, length) | {
            "friction.Fs": p.F * m * length,
            "friction.gamma": p.shape / length,
            "friction.G_slip": p.shape * p.F * m,
            "friction.d": p.d * length,
            "friction.static": static.value if static else p.static,
            "droop.fraction": p.compliance * p.F / p.K / p.v_dr,
        }

    if motion.datum_prior is None and law.curve != "hyperbolic":
        spread = _held(spread, slots[known].tolist().index(Global.DATUM))
    propagated = _propagated(scene_of, unknowns_of_run[slots[known]], spread, motion, names)
    return _built(ranking, law.number, propagated, static, np.empty(0), ramp=False)


def of_formula(ranking: Ranking, fit: Fit) -> FittedScene:
    """Return the scene of a formula; DataError where its belt slows under load, which a scene cannot have."""
    motion, law, curve = ranking.motion, fit.law, fit.task.curve
    if not isinstance(curve, FormulaCurve):
        raise TypeError("not the fit of a formula")
    places = [place % PER_RUN for place in fit.places if place < PER_RUN]
    if Global.COMPLIANCE in places:
        what = "no scene: a belt that slows under load is not modelled beside a formula"
        raise DataError(what, "--save-scene", "leave it out")
    index = [*(k for k, place in enumerate(fit.places) if place < PER_RUN), *range(len(fit.places), fit.q.size)]
    spread = covariance(fit)[np.ix_(index, index)]
    if motion.datum_prior is None and fit.held_rest is not None:
        spread = _held(spread, places.index(Global.DATUM))
    taken = _scene_names(law)
    sized = bool(law.dimensions) or ranking.motion.per_mass
    static = None if fit.problem.ramp else _static(ranking)
    names = ["spring.k", "spring.x0", "belt.speed", "damper.c"]
    names += [f"friction.{taken[name]}" for name in curve.free]
    names += ["friction.d"] if fit.problem.ramp else []
    names += ["friction.static"] if static else []

    def scene_of(unknowns: Array, calibration: Calibration, factor: float, length: float) -> dict[str, float]:
        u = fit.u[:PER_RUN].copy()
        u[places] = unknowns[: len(places)]
        p = values(u)
        m = calibration.mass_for(p.K, factor)
        scene = _rig_of(p, m, motion.sign, length)
        scene |= {"friction.d": p.d * length, "friction.static": static.value if static else 1.0}
        for name, value in curve.values(u, unknowns[len(places) :]).items():
            force, speed = law.dimensions.get(name, (0, 0))
            scene[f"friction.{taken[name]}"] = value * (m**force if sized else 1.0) * length ** (force + speed)
        return scene

    propagated = _propagated(scene_of, fit.q[index], spread, motion, names)
    calibration = Calibration(motion.mass, motion.stiffness, motion.length_error)
    at_fit = scene_of(fit.q[index], calibration, 1.0, 1.0)
    keys = [f"friction.{taken[name]}" for name in law.curve.parameters if name not in curve.free]
    text = law.curve.renamed({name: key for name, key in taken.items() if name != key}).text
    built = _built(ranking, 0, propagated, static, np.empty(0), ramp=fit.problem.ramp)
    return replace(
        built,
        formula=text if sized else f"{calibration.mass_for(fit.values.K, 1.0)!r}*({text})",
        fixed={key.removeprefix("friction."): at_fit[key] for key in keys},
    )


def _scene_names(law: Law) -> dict[str, str]:
    """Return the key of each parameter of a formula in a scene, whose friction section has reserved keys."""
    keys: dict[str, str] = {}
    for name in law.curve.parameters:
        key = name
        while key in OWN_KEYS or (key != name and key in law.curve.parameters):
            key += "_"
        keys[name] = key
    return keys


def of_curve(ranking: Ranking, curve: MeasuredCurve, statistics: StickSlipStatistics) -> FittedScene:
    """Return the scene of the measured curve.

    Slips hardly constrain friction at rest, break-aways do: unless they are significantly above the curve, it passes
    through them, weighted by both errors.
    """
    spline_fit, motion = curve.spline_fit, ranking.motion
    spline, basis = spline_fit.spline, free_curve(spline_fit.task).basis
    knots = spline.knots
    # one more point in the first and in the last piece: a spline through points has no break at those next to its ends
    points = np.sort(np.concatenate((knots, [0.5 * (knots[0] + knots[1]), 0.5 * (knots[-2] + knots[-1])])))
    matrix = spline.basis(points)
    places = list(spline_fit.places)
    unknowns = spline_fit.solution.u.copy()
    datums = [i for i, place in enumerate(places) if place % PER_RUN == Global.DATUM]
    if motion.datum_prior is None:
        default = datum_calibration(motion) if spline_fit.held_rest is None else spline_fit.held_rest
        unknowns[datums] += _other_rest(spline_fit, unknowns, datums[0], default.value)
    slots = columns(tuple(places), len(ranking.sides))[0]

    def values_at(unknowns: Array) -> Values:
        u = spline_fit.u[:PER_RUN].copy()
        u[slots[slots >= 0]] = unknowns[: len(places)][slots >= 0]
        return values(u)

    noise, scattered = covariances(curve.linear)
    wider = np.sqrt(np.maximum(np.diag(noise) / np.maximum(np.diag(scattered), 1e-300), 1.0))
    spread = scattered * wider[:, None] * wider
    if motion.datum_prior is None:
        spread = _held(spread, datums[0])

    static = None
    broken = None if curve.ramp else _break_away_position(statistics, motion)
    if broken is not None:
        place = broken.value

        def above(unknowns: Array) -> float:
            """Return the load at the break-aways minus the curve at rest, m/s^2."""
            p = values_at(unknowns)
            return p.K * (place - p.datum) + p.damping * p.v_dr - float(basis.coefficients(unknowns)[0])

        gap, slopes = above(unknowns), _slopes(above, unknowns, spread)
        along = np.einsum("ij,j->i", spread, slopes)
        placed = (spline_fit.values.K * broken.sd) ** 2
        variance = float(np.sum(along * slopes)) + placed
        rest = float(basis.coefficients(unknowns)[0])
        if gap > max(STATIC_ERRORS * math.sqrt(variance), LEAST_STATIC * rest):
            static = Measured(1 + gap / rest, math.sqrt(placed) / rest)
        else:
            unknowns = unknowns - along * gap / variance
            spread = spread - np.outer(along, along) / variance
    names = ["spring.k", "spring.x0", "belt.speed", "damper.c"]
    names += ["friction.d"] if curve.ramp else []
    names += ["friction.static"] if static else []
    names += [f"friction.curve.{i}" for i in range(points.size)]

    def scene_of(unknowns: Array, calibration: Calibration, factor: float, length: float) -> dict[str, float]:
        p = values_at(unknowns)
        m = calibration.mass_for(p.K, factor)
        friction = m * np.einsum("ij,j->i", matrix, basis.coefficients(unknowns))
        # speeds of the points are exact in the scene: a length's error is that of the belt's speed against them
        return (
            _rig_of(p, m, motion.sign, length)
            | {"friction.d": p.d, "friction.static": static.value if static else 1.0}
            | {f"friction.curve.{i}": float(F) for i, F in enumerate(friction)}
        )

    propagated = _propagated(scene_of, unknowns, spread, motion, names)
    return _built(ranking, 0, propagated, static, points, ramp=bool(curve.ramp))


def _held(spread: Array, place: int) -> Array:
    """Return a covariance (p, p) where the unknown at ``place`` is fixed."""
    if not spread[place, place] > 0:
        return spread
    return np.asarray(spread - np.outer(spread[place], spread[place]) / spread[place, place])


def _other_rest(fit: Fit, unknowns: Array, place: int, default: float) -> float:
    """Return the move of the spring's rest (m), and of the curve with it: see the module."""
    moved = unknowns.copy()
    moved[place] = default
    lowest = fit.spline.with_coefficients(free_curve(fit.task).basis.coefficients(moved))
    friction = lowest(np.linspace(0.0, fit.spline.knots[-1], 20 * fit.spline.knots.size))
    fall = float(np.ptp(friction))
    missing = max(0.0, LEAST_FRICTION * fall - float(friction.min()))
    return default - float(unknowns[place]) - missing / fit.values.K


def _rig_of(p: Values, m: float, sign: float, length: float) -> dict[str, float]:
    return {
        "mass.m": m,
        "spring.k": p.K * m,
        "spring.x0": sign * p.datum * length,
        "belt.speed": sign * p.v_dr * length,
        "damper.c": p.damping * m,
    }


def _propagated(
    scene_of: Callable[[Array, Calibration, float, float], dict[str, float]],
    unknowns: Array,
    spread: Array,
    motion: MeasuredMotion,
    names: list[str],
) -> tuple[list[str], Array, Array]:
    """Return names, values and covariance of the scene's keys, the calibrations' errors included."""
    calibration = Calibration(motion.mass, motion.stiffness, motion.length_error)
    names = ["mass.m", *names] if not motion.per_mass else names
    n = unknowns.size
    start = np.concatenate((unknowns, [1.0, 1.0]))
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n] = spread
    whole[n, n], whole[n + 1, n + 1] = (error**2 for error in calibration.errors)

    def row(u: Array) -> Array:
        found = scene_of(u[:n], calibration, float(u[n]), float(u[n + 1]))
        return np.array([found[name] for name in names])

    slopes = _slopes(row, start, whole)
    return names, row(start), np.asarray(np.einsum("ik,kl,jl->ij", slopes, whole, slopes))


def _slopes(function: Callable[[Array], Array | float], u: Array, spread: Array) -> Array:
    """Return the derivatives of a function of u (n,), along the last axis, by central differences."""
    columns_of = []
    for j in range(u.size):
        step = np.zeros(u.size)
        step[j] = DERIVATIVE_STEP * (max(abs(float(u[j])), math.sqrt(max(float(spread[j, j]), 0.0))) or 1.0)
        columns_of.append((np.asarray(function(u + step)) - np.asarray(function(u - step))) / (2 * step[j]))
    return np.stack(columns_of, axis=-1)


def _built(
    ranking: Ranking,
    law: int,
    propagated: tuple[list[str], Array, Array],
    static: Measured | None,
    points: Array,
    *,
    ramp: bool,
) -> FittedScene:
    names, numbers, spread = propagated
    if static:
        place = names.index("friction.static")
        spread[place, place] = static.sd**2
    fit = ranking.best.fit
    return FittedScene(
        law=law,
        keys=tuple(names),
        values=numbers,
        covariance=_positive(spread),
        cycles=len(fit.rows),
        points=points,
        ramp=ramp,
        scatter=_scatter(fit),
    )


def _positive(spread: Array) -> Array:
    """Return a covariance without the rounding errors of directions with next to no variance."""
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    size, axes = eigen(0.5 * (spread + spread.T) / scale[:, None] / scale)
    root = scale[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
    positive = np.asarray(np.einsum("ik,jk->ij", root, root))
    return np.asarray(0.5 * (positive + positive.T))


def _static(ranking: Ranking) -> Measured | None:
    """Return the break-away level over Fs where it is significantly above 1."""
    ratio = np.array([e.break_away_level for e in ranking.events if e.flag == "" and math.isfinite(e.break_away_level)])
    if ratio.size < FEWEST_LEVELS:
        return None
    mean, error = float(np.mean(ratio)), float(np.std(ratio, ddof=1) / math.sqrt(ratio.size))
    return Measured(mean, error) if mean - 1 > max(STATIC_ERRORS * error, LEAST_STATIC) else None


def _break_away_position(statistics: StickSlipStatistics, motion: MeasuredMotion) -> Measured | None:
    """Return the break-away position in the fit's frame, m, without a law; None with too few."""
    seen = statistics.column("break_away_m")
    seen = seen[np.isfinite(seen)]
    if seen.size < FEWEST_LEVELS:
        return None
    rest = motion.datum_prior.value if motion.datum_prior is not None else 0.0
    error = 1.4826 * float(np.median(np.abs(seen - np.median(seen)))) / math.sqrt(seen.size)
    return Measured(
        float(np.median(seen)) + rest, math.hypot(error, BREAK_AWAY_BLUR * motion.half_window * motion.belt_speed)
    )


def _scatter(fit: Fit) -> float:
    """Return the standard deviation of the cycles' levels about their trend, of Fs, beyond noise, or 0."""
    run = fit.for_run(0)
    table = run.windows.table
    slips = (table[:, 1] == 0) & run.inlier_cycles[table[:, 0]]
    time, level = run.windows.level_epoch[slips], np.exp(run.local[table[slips, 0], PerCycle.LEVEL])
    if level.size <= FEWEST_LEVELS:
        return 0.0
    centred = time - time.mean()
    left = level - level.mean() - centred * float(np.sum(centred * level) / np.sum(centred**2))
    square = float(np.sum(left**2)) / (level.size - 2)
    blocks = fit.solution.blocks
    noise = float(np.median(np.linalg.inv(blocks.Hl)[:, PerCycle.LEVEL, PerCycle.LEVEL]))
    return math.sqrt(square - noise) if square > LEAST_SCATTER**2 * noise else 0.0


def text(scene: FittedScene, ranking: Ranking, run: Path) -> str:
    values = dict(zip(scene.keys, scene.values.tolist(), strict=True))
    assumed = "mass.m" not in values
    mass = values.get("mass.m", 1.0)
    curve = [values[f"friction.curve.{i}"] for i in range(scene.points.size)]
    lines = [f"# Fitted rig, written by fit-friction from {_quoted(run.name)}."]
    if assumed:
        lines.append(
            "# No mass or stiffness is known: mass 1 kg is assumed, so that N here are N per kg of the rig's mass."
        )
    kind = f"law {scene.law}" if scene.law else ranking.best.label if scene.formula else "measured curve"
    lines += [f"title = {_quoted(f'fitted to {run.name}: {kind}')}"]
    lines += [
        "",
        "[mass]",
        f"m = {mass!r}",
        "",
        "[spring]",
        f"k = {values['spring.k']!r}",
        f"x0 = {values['spring.x0']!r}",
    ]
    lines += [
        "",
        "[belt]",
        f"speed = {values['belt.speed']!r}",
        "",
        "[damper]",
        f"c = {max(values['damper.c'], 0.0)!r}",
    ]
    lines += ["", "[start]", f"x = {values['spring.x0']!r}", "", "[friction]"]
    lines += [f"formula = {_quoted(scene.formula)}" if scene.formula else f"law = {scene.law}"]
    lines += [f"{key} = {value!r}" for key, value in scene.fixed.items()]
    lines += [
        f"{name.removeprefix('friction.')} = {value!r}"
        for name, value in values.items()
        if name.startswith("friction.") and not name.startswith("friction.curve.")
    ]
    if curve:
        lines += ['contact = "ramp"'] if scene.ramp else []
        lines += ["# slip speed in m/s, friction in N" + (" per kg" if assumed else ""), "curve = ["]
        lines += [f"    [{s!r}, {F!r}]," for s, F in zip(scene.points.tolist(), curve, strict=True)]
        lines += ["]"]
    if "droop.fraction" in values:
        lines += ["", "[droop]", f"fraction = {max(values['droop.fraction'], 0.0)!r}"]
    if scene.scatter > 0:
        lines += ["", "[scatter]", f"Fs = {scene.scatter!r}"]
    lines += ["", "[fit]", f"verdict = {_quoted(ranking.verdict)}", f"cycles = {scene.cycles}"]
    lines += [f"mass_assumed = {str(assumed).lower()}"]
    lines += ["parameters = [" + ", ".join(_quoted(name) for name in scene.keys) + "]"]
    lines += [f"values = {scene.values.tolist()!r}", "covariance = ["]
    lines += [f"    {row!r}," for row in scene.covariance.tolist()]
    return "\n".join([*lines, "]"]) + "\n"


def _quoted(words: str) -> str:
    plain = words.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(letter if letter.isprintable() else " " for letter in plain) + '"'


def save(path: Path, ranking: Ranking, statistics: StickSlipStatistics, run: Path) -> None:
    """Write the scene of a ranking, in place of an older file: see `refuse_existing`."""
    content = text(of_ranking(ranking, statistics), ranking, run)
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(content, encoding="utf-8")


def refuse_existing(path: Path, files: list[Path], *, force: bool) -> None:
    """Raise InputError when ``path`` is a folder, a run, or a file that exists without ``force``."""
    atomic.refuse_existing(path, force, *files, kind="scene", flag="--save-scene")
