"""A fitted rig as a scene of the simulator: its keys, values and covariance, and the TOML file of them.

Without a mass or a stiffness a record determines forces per unit mass only.  The scene then has a mass of 1 kg: its
forces and dampings are per kilogram; times, positions and speeds are those of the rig.

Without a datum the level of a free or linear curve and the spring's rest position are confounded.  The rest position is
then that of the curve or the default of the fit, moved where friction would fall below `LEAST_FRICTION`, and fixed in
the covariance.

The section ``fit`` has the fitted keys of the scene with their values and covariance; ``friction.curve.3`` is the
friction of the fourth point of a measured curve.  The belt's ripple is not included.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fitting import noise_levels
from fitting.judge.curve import SCATTER_SHOWN, MeasuredCurve, covariances
from fitting.judge.parameters import DERIVATIVE_STEP, covariance, differences
from fitting.least_squares.normal_equations import eigen
from fitting.model.curves import FreeCurve, FrictionCurve
from fitting.model.problem import rest_calibration
from fitting.model.unknowns import PER_RUN, Global, PerCycle, Values, columns, values
from fitting.record.motion import MeasuredMotion
from fitting.result import Ranking
from fitting.search.fit import Fit
from processing.statistics import StickSlipStatistics
from stickslip.compute.arrays import Array
from stickslip.errors import DataError
from stickslip.output import atomic
from stickslip.text import storable
from stickslip.toml import quote
from stickslip.units import Measured

BREAK_AWAY_BLUR = 0.5  # how far smoothing moves a break-away found without a law, over its half-window
LEAST_FRICTION = 0.1  # least friction over a curve's fall: above 0, which changes no motion
# Keys of a scene's section of friction that no parameter of a formula can have (`rig_sim.scenes.checks`).
OWN_KEYS = ("law", "curve", "formula", "contact", "static", "d", "G_stick")


@dataclass(frozen=True, eq=False)
class FittedScene:
    """The contents of the file."""

    friction: Mapping[str, Any]  # of the section friction: law or formula, and fixed values
    keys: tuple[str, ...]  # ``section.key`` of each fitted value
    values: Array  # (n,)
    covariance: Array  # (n, n)
    cycles: int
    points: Array  # slip speeds (m/s) of a measured curve, whose frictions are the last keys
    scatter: float  # standard deviation of the levels, of Fs


@dataclass(frozen=True, eq=False)
class FittedRig:
    """A fit as a rig at ``unknowns`` (n,), its shared unknowns and those of its curve."""

    fit: Fit
    motion: MeasuredMotion

    @property
    def unknowns(self) -> Array:
        return self.fit.q[: sum(self.fit.task.widths[:2])].copy()

    @property
    def curve(self) -> FrictionCurve:
        return self.fit.task.curve

    @property
    def slots(self) -> list[int]:
        """The index of each shared unknown among the first run's, or -1."""
        return [int(slot) for slot in columns(self.fit.places, len(self.fit.problem.runs))[0]]

    @cached_property
    def points(self) -> Array:
        """The knots of a free curve, m/s, and, for a spline without a break next to its ends, two more speeds."""
        if not isinstance(self.curve, FreeCurve):
            return np.empty(0)
        knots = self.curve.spline.knots
        return np.sort(np.concatenate((knots, [0.5 * (knots[0] + knots[1]), 0.5 * (knots[-2] + knots[-1])])))

    @cached_property
    def keys(self) -> dict[str, str]:
        """The key of each parameter of the law in a scene, none of them reserved."""
        keys: dict[str, str] = {}
        law = self.curve.law
        parameters = law.parameters if law is not None else ()
        if law is not None and law.rate:
            return dict(zip(parameters, parameters, strict=True))
        for name in parameters:
            key = name
            while key in OWN_KEYS or (key != name and key in parameters):
                key += "_"
            keys[name] = key
        return keys

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(self.keys) if self.curve.kind else self.curve.free

    @property
    def sized(self) -> bool:
        """Whether the units of the law's parameters are known."""
        law = self.curve.law
        return law is None or bool(law.dimensions) or self.motion.per_mass

    def q(self, unknowns: Array) -> Array:
        return np.concatenate((unknowns, self.fit.q[unknowns.size :]))

    def values(self, unknowns: Array) -> Values:
        """Return the parameters of the first run."""
        return values(self.fit.task.split(self.q(unknowns))[0][:PER_RUN])

    def friction(self, unknowns: Array, s: Array) -> Array:
        """Return friction, m/s^2."""
        return self.fit.task.friction(self.q(unknowns), s)

    def at_rest(self, unknowns: Array) -> float:
        return float(self.friction(unknowns, np.zeros(1))[0])

    def mass(self, K: float, factor: float = 1.0) -> float:
        """Return the mass, kg, for k/m = K and ``factor`` on the calibration; 1 without one."""
        if self.motion.mass is not None:
            return self.motion.mass.value * factor
        return self.motion.stiffness.value * factor / K if self.motion.stiffness is not None else 1.0

    def scene(self, unknowns: Array, factor: float = 1.0, length: float = 1.0) -> dict[str, float]:
        """Return the values of a scene with ``factor`` on the mass or stiffness, and ``length`` on the metres."""
        p, law, sign = self.values(unknowns), self.curve.law, self.motion.sign
        m = self.mass(p.K, factor)
        scene = {
            "mass.m": m,
            "spring.k": p.K * m,
            "spring.x0": sign * p.datum * length,
            "belt.speed": sign * p.v_dr * length,
            "damper.c": p.damping * m,
            "droop.fraction": p.compliance * p.F / p.K / p.v_dr,
            # Speeds of the points are exact: an error of length is that of the belt's speed against them.
            "friction.d": p.d * (1.0 if law is None else length),
            "friction.static": p.static,
        }
        u, theta, _ = self.fit.task.split(self.q(unknowns))
        for name, value in self.curve.values(theta, u).items():
            force, speed = (0, 0) if law is None else law.dimensions.get(name, (0, 0))
            size = m ** (0 if law is None else law.mass_power(name)) if self.sized else 1.0
            scene[f"friction.{self.keys[name]}"] = value * size * length ** (force + speed)
        if self.points.size:
            forces = m * self.friction(unknowns, self.points)
            scene |= {f"friction.curve.{i}": float(force) for i, force in enumerate(forces)}
        return scene

    def names(self, *, static: bool) -> list[str]:
        names = [] if self.motion.per_mass else ["mass.m"]
        names += ["spring.k", "spring.x0", "belt.speed", "damper.c"]
        names += [f"friction.{self.keys[name]}" for name in self.free]
        names += ["friction.d"] if self.curve.ramp else []
        names += ["friction.static"] if static or Global.STATIC in self.slots else []
        names += ["droop.fraction"] if Global.COMPLIANCE in self.slots and self.curve.kind else []
        return names + [f"friction.curve.{i}" for i in range(self.points.size)]

    def unfitted(self) -> dict[str, Any]:
        law = self.curve.law
        if law is None:
            return {"law": 0} | ({"contact": "ramp"} if self.curve.ramp else {})
        if self.curve.kind:
            return {"law": law.number}
        text, scene = law.curve.renamed({a: b for a, b in self.keys.items() if a != b}).text, self.scene(self.unknowns)
        fixed = {key: scene[f"friction.{key}"] for name, key in self.keys.items() if name not in self.free}
        if law.rate:
            return {"law": law.name} | fixed
        return {"formula": text if self.sized else f"{scene['mass.m']!r}*({text})"} | fixed


class BreakAwayLevel(NamedTuple):
    """Friction at the break-aways against that of the curve at rest."""

    excess: Callable[[Array], float]  # over friction at rest, m/s^2, at the unknowns
    sd: float  # beside that of the unknowns


def of_ranking(ranking: Ranking) -> FittedScene:
    """Return the scene of the best law or, where none describes the record, of the measured curve.

    Slips hardly constrain friction at rest.  Where the break-aways disagree with a law (finding ``break-away``), or no
    law describes the record, they decide: a higher level is written as ``friction.static``; else the curve passes
    through them, weighted by both errors.
    """
    fit, measured = _choose(ranking)
    rig = FittedRig(fit, ranking.motion)
    if measured is None:
        unknowns, spread = rig.unknowns, _held(covariance(fit), rig)
        level = _level_of_law(ranking, rig)
    else:
        unknowns, spread = rig.unknowns + _move_of_rest(rig), _held(_covariance_of_curve(measured), rig)
        level = _level_of_curve(measured, ranking.statistics[0], rig)
    static = None
    if level is not None:
        gap, slopes = level.excess(unknowns), _slopes(level.excess, unknowns, spread)
        along = np.einsum("ij,j->i", spread, slopes)
        variance = float(np.sum(along * slopes)) + level.sd**2
        rest = rig.at_rest(unknowns)
        if gap > noise_levels.SHOWN * math.sqrt(variance):
            static = Measured(1 + gap / rest, level.sd / rest)
        else:
            unknowns = unknowns - along * gap / variance
            spread = spread - np.outer(along, along) / variance
    names = rig.names(static=static is not None)
    numbers, spread = _propagated(rig, names, unknowns, spread)
    if static is not None:
        place = names.index("friction.static")
        numbers[place], spread[place], spread[:, place] = static.value, 0.0, 0.0
        spread[place, place] = static.sd**2
    best = ranking.best.fit
    return FittedScene(
        friction=rig.unfitted(),
        keys=tuple(names),
        values=numbers,
        covariance=_positive(spread),
        cycles=len(best.rows),
        points=rig.points,
        scatter=_scatter(best),
    )


def _choose(ranking: Ranking) -> tuple[Fit, MeasuredCurve | None]:
    """Return the fit that describes the record, and the measured curve if the fit is that one's."""
    adequacy = ranking.adequacy
    if ranking.rows and not adequacy.rejected:
        fit = ranking.best.fit
        if Global.COMPLIANCE in fit.places and not fit.task.curve.kind:
            what = "no scene: a belt that slows under load is not modelled beside a formula"
            raise DataError(what, "--save-scene", "leave it out")
        if fit.law.own_memory:
            what = f"no scene can be written, because rig-sim cannot simulate the custom memory of law {fit.law.name}"
            raise DataError(what, "--save-scene", "omit it, or fit a published law with memory")
        return fit, None
    if adequacy.curve is None or not adequacy.of_speed or not ranking.rows:
        raise DataError(
            f"no scene can be written, because no friction curve describes the record ({adequacy.verdict})",
            "--save-scene",
            "omit it; the departures in the report may show what is missing",
        )
    return adequacy.curve.spline_fit, adequacy.curve


def _level_of_law(ranking: Ranking, rig: FittedRig) -> BreakAwayLevel | None:
    """Return the level of the break-aways if they disagree with the law; None for a belt that slows under load."""
    finding = next((each for each in ranking.sides[0].findings if each.code == "break-away"), None)
    if finding is None or Global.COMPLIANCE in rig.fit.places:
        return None
    rest = rig.at_rest(rig.unknowns)
    level = rest * finding.value / finding.expected
    return BreakAwayLevel(lambda q: level - rig.at_rest(q), abs(level - rest) / finding.sigmas)


def _level_of_curve(curve: MeasuredCurve, statistics: StickSlipStatistics, rig: FittedRig) -> BreakAwayLevel | None:
    """Return the level of the break-aways by their positions; None on a ramp or with too few."""
    place = None if curve.ramp else _break_away_position(statistics, rig.motion)
    if place is None:
        return None

    def excess(unknowns: Array) -> float:
        p = rig.values(unknowns)
        return p.K * (place.value - p.datum) + p.damping * p.v_dr - rig.at_rest(unknowns)

    return BreakAwayLevel(excess, curve.spline_fit.values.K * place.sd)


def _held(spread: Array, rig: FittedRig) -> Array:
    """Return the covariance with the rest position fixed where it is assumed only."""
    fit, curve = rig.fit, rig.curve
    assumed = curve.law is None or fit.assumed_rest is not None or curve.kind in ("constant", "linear")
    if rig.motion.datum_prior is not None or not assumed:
        return spread
    place = rig.slots.index(Global.DATUM)
    if not spread[place, place] > 0:
        return spread
    return np.asarray(spread - np.outer(spread[place], spread[place]) / spread[place, place])


def _covariance_of_curve(curve: MeasuredCurve) -> Array:
    """Return the covariance by the scatter between cycles, no variance below that by noise."""
    noise, scattered = covariances(curve.linear)
    wider = np.sqrt(np.maximum(np.diag(noise) / np.maximum(np.diag(scattered), 1e-300), 1.0))
    return np.asarray(scattered * wider[:, None] * wider)


def _move_of_rest(rig: FittedRig) -> Array:
    """Return the move of the unknowns to the rest position of a measured curve: see the module."""
    moved = np.zeros(rig.unknowns.size)
    if rig.motion.datum_prior is not None:
        return moved
    place = rig.slots.index(Global.DATUM)
    default = rig.fit.assumed_rest or rest_calibration(rig.fit.problem.runs[0])
    moved[place] = default.value - rig.unknowns[place]
    knots = rig.fit.spline.knots
    friction = rig.friction(rig.unknowns + moved, np.linspace(0.0, knots[-1], 20 * knots.size))
    missing = max(0.0, LEAST_FRICTION * float(np.ptp(friction)) - float(friction.min()))
    moved[place] -= missing / rig.fit.values.K
    return moved


def _propagated(rig: FittedRig, names: list[str], unknowns: Array, spread: Array) -> tuple[Array, Array]:
    """Return values and covariance of a scene's keys, the errors of mass, stiffness and metres included."""
    n, known = unknowns.size, rig.motion.mass or rig.motion.stiffness
    start, whole = np.concatenate((unknowns, [1.0, 1.0])), np.zeros((n + 2, n + 2))
    whole[:n, :n] = spread
    whole[n, n], whole[n + 1, n + 1] = (known.sd / known.value if known else 0.0) ** 2, rig.motion.length_error**2

    def row(u: Array) -> Array:
        scene = rig.scene(u[:n], float(u[n]), float(u[n + 1]))
        return np.array([scene[name] for name in names])

    slopes = _slopes(row, start, whole)
    return row(start), np.asarray(np.einsum("ik,kl,jl->ij", slopes, whole, slopes))


def _slopes(function: Callable[[Array], Array | float], u: Array, spread: Array) -> Array:
    """Return the derivatives by u, whose errors have the covariance ``spread``, along the last axis."""
    size = np.maximum(np.abs(u), np.sqrt(np.maximum(np.diag(spread), 0.0)))
    return differences(function, u, DERIVATIVE_STEP * np.where(size > 0, size, 1.0))


def _positive(spread: Array) -> Array:
    """Return the positive semidefinite part of a covariance."""
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    size, axes = eigen(0.5 * (spread + spread.T) / scale[:, None] / scale)
    root = scale[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
    positive = np.asarray(np.einsum("ik,jk->ij", root, root))
    return np.asarray(0.5 * (positive + positive.T))


def _break_away_position(statistics: StickSlipStatistics, motion: MeasuredMotion) -> Measured | None:
    """Return the break-away position in the fit's frame, m; None with too few."""
    seen = statistics.column("break_away_m")
    seen = seen[np.isfinite(seen)]
    if seen.size < noise_levels.FEWEST:
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
    if level.size <= noise_levels.FEWEST:
        return 0.0
    centred = time - time.mean()
    left = level - level.mean() - centred * float(np.sum(centred * level) / np.sum(centred**2))
    square = float(np.sum(left**2)) / (level.size - 2)
    blocks = fit.solution.blocks
    noise = float(np.median(np.linalg.inv(blocks.Hl)[:, PerCycle.LEVEL, PerCycle.LEVEL]))
    return math.sqrt(square - noise) if square > SCATTER_SHOWN * noise else 0.0


def text(scene: FittedScene, ranking: Ranking, run: Path) -> str:
    values = dict(zip(scene.keys, scene.values.tolist(), strict=True))
    assumed = "mass.m" not in values
    kind = "measured curve" if scene.points.size else ranking.best.label
    per_kg = ["# No mass or stiffness is known: mass 1 kg is assumed, so that N here are N per kg of the rig's mass."]
    friction = dict(scene.friction) | {
        name.removeprefix("friction."): value
        for name, value in values.items()
        if name.startswith("friction.") and not name.startswith("friction.curve.")
    }
    if scene.points.size:
        forces = [values[f"friction.curve.{i}"] for i in range(scene.points.size)]
        friction["curve"] = [list(pair) for pair in zip(scene.points.tolist(), forces, strict=True)]
    sections: dict[str, dict[str, Any]] = {
        "mass": {"m": values.get("mass.m", 1.0)},
        "spring": {"k": values["spring.k"], "x0": values["spring.x0"]},
        "belt": {"speed": values["belt.speed"]},
        "damper": {"c": max(values["damper.c"], 0.0)},
        "start": {"x": values["spring.x0"]},
        "friction": friction,
    }
    if "droop.fraction" in values:
        sections["droop"] = {"fraction": max(values["droop.fraction"], 0.0)}
    if scene.scatter > 0:
        sections["scatter"] = {"Fs": scene.scatter}
    sections["fit"] = {"verdict": ranking.verdict, "cycles": scene.cycles, "mass_assumed": assumed}
    sections["fit"] |= {"parameters": list(scene.keys), "values": scene.values.tolist()}
    sections["fit"] |= {"covariance": scene.covariance.tolist()}
    lines = [f"# Fitted rig, written by fit-friction from {_toml(run.name)}.", *(per_kg if assumed else [])]
    lines += [f"title = {_toml(f'fitted to {run.name}: {kind}')}"]
    for section, content in sections.items():
        lines += ["", f"[{section}]", *(f"{key} = {_toml(value)}" for key, value in content.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return quote(storable(value))
    if isinstance(value, bool):
        return str(value).lower()
    if not isinstance(value, list):
        return repr(value)
    if value and isinstance(value[0], list):
        return "[\n" + "".join(f"    {_toml(row)},\n" for row in value) + "]"
    return f"[{', '.join(map(_toml, value))}]"


def save(path: Path, ranking: Ranking, run: Path) -> None:
    content = text(of_ranking(ranking), ranking, run)
    with atomic.replacing(path, force=True) as temporary:
        temporary.write_text(content, encoding="utf-8")
