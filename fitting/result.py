"""The ranking, as `fitting.rank` returns it: a row for each law, the verdict with its warnings, tables and files."""

import math
import pickle
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.judge import friction, resampling
from fitting.judge.adequacy import Adequacy
from fitting.judge.breaks import motion_at
from fitting.judge.curve import BandExit, MeasuredCurve
from fitting.judge.parameters import (
    RUN_PARAMETERS,
    STATED_ERROR,
    BreakAway,
    Correlations,
    Parameter,
    correlations,
    friction_band,
    in_columns,
)
from fitting.laws import ABOUT, MEMORY, PUBLISHED
from fitting.record.cycles import CycleSegmentation
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from processing.record.kinematics import Kinematics
from processing.record.motion import Finding
from processing.statistics import StickSlipStatistics, from_kinematics, pooled
from stickslip.compute.arrays import Array
from stickslip.errors import DataError, InputError, in_python, nearest
from stickslip.output import atomic, notebook, suffix
from stickslip.version import VERSION

if TYPE_CHECKING:
    import os

    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike


# Imported by name: they import this module.
PAGE, SCENE, TEXTS = "fitting.report.page", "fitting.scene", "fitting.report.terminal"
SAVED = f"stickslip ranking {VERSION}\n".encode()
CURVE = ("k/m", "Fs/m", "v_dr", "gamma", "G_slip/m", "d")  # parameters in the short form of a ranking


def numbers(values: "ArrayLike", name: str) -> Array:
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError):
        do = f"pass numbers, as in {name}=np.linspace(0, 1, 101)"
        raise InputError(f"{name} is {values!r:.40}", name, do) from None


class _Row:
    """A law of the ranking, fitted or not."""

    law: int | str
    name: str
    misfit: float | None
    parameters: dict[str, Parameter]
    outside_band: BandExit | None
    formula: str | None
    rate: str  # of the state of a law with memory

    @property
    def title(self) -> str:
        """The law in a table."""
        if self.formula is None:
            return f"{self.law} {self.name}"
        return f"{self.law}: {self.formula}" + (f"; z' = {self.rate}" if self.rate and self.law not in MEMORY else "")

    def as_json(self) -> dict[str, Any]:
        of_formula = () if self.formula is None else ("formula", "asked")
        names = ("law", "name", *of_formula, "score", "weight", "in_set", "rms_m", "misfit", "cycles")
        document: dict[str, Any] = {name: getattr(self, name) for name in names}
        document["parameters"] = {name: item.as_json() for name, item in self.parameters.items()}
        document["outside_band"] = None if self.outside_band is None else vars(self.outside_band)
        more = {"orbit_distance": "orbit", "cpu_s": "cpu_s", "fitted": "fitted", "reason": "reason"}
        rate = {"rate": self.rate} if self.rate else {}
        return document | {key: getattr(self, name) for key, name in more.items()} | rate

    def as_form(self) -> dict[str, Any]:
        """Return a published law as a row of `Ranking.published`."""
        name, band = str(self.law), self.outside_band
        return {
            "name": name,
            "formula": self.formula,
            "source": ABOUT[name].source,
            "parameters": {own: self.parameters.get(own) for own in PUBLISHED[name].free},
            "chi": self.misfit,
            "inside_band": band is not None and band.half_widths <= 1,
        }


@dataclass(frozen=True)
class LawResult(_Row):
    """One row of the ranking.

    Attributes
    ----------
    law : int or str
        The number of one of the six, the name of a law given as a formula.
    name : str
        In words.
    score : float or None
        Penalised log error (smaller is better) minus the best law's; None where no law describes the record.
    weight : float or None
        exp(-score/2), normalised over the laws; None as ``score``.
    in_set : bool
        Whether the law is compatible with the data: indistinguishable from the best one.
    rms_m : float
        Rms residual of all windows, m.
    misfit : float
        Rms residual of the usual cycles over the noise of a position.
    cycles : int
        Number of fitted cycles.
    parameters : dict
        By name; per unit mass, and in newtons when the mass or the spring's stiffness is known.
    cpu_s : float
        CPU time, s.
    behind : (float, float) or None
        Mean paired difference of log error to the best law, penalty included, and its standard error.
    orbit : float
        Distance of the law's orbit to the measured one, over the orbit's size (`fitting.judge.friction`).
    fit : Fit
        The fit in its frame: per unit mass, with a belt that runs towards +x.
    motion : MeasuredMotion
        Of the run; of the first of several.
    outside_band : BandExit or None
        Where its curve is furthest outside the band of the measured one.
    formula : str or None
        Of a law given as a formula.
    asked : bool
        Whether the law was requested; every published law competes too.
    alpha : float
        1 - confidence of the intervals.
    """

    law: int | str
    name: str
    score: float | None
    weight: float | None
    in_set: bool
    rms_m: float
    misfit: float
    cycles: int
    parameters: dict[str, Parameter]
    cpu_s: float
    behind: tuple[float, float] | None
    orbit: float
    fit: Fit = field(repr=False, compare=False)
    motion: MeasuredMotion = field(repr=False, compare=False)
    outside_band: BandExit | None = None
    formula: str | None = None
    asked: bool = True
    alpha: float = 0.05

    fitted = True
    reason = None

    @property
    def rate(self) -> str:  # type: ignore[override]
        """The rate of the state of a law with memory; empty for others."""
        return self.fit.law.rate

    @property
    def label(self) -> str:
        """The law in a picture."""
        return f"law {self.law}"

    @property
    def called(self) -> str:
        """The law in a sentence."""
        if self.formula is None:
            return f"law {self.law} ({self.name})"
        if self.law in MEMORY:
            return f"{self.name} ({self.label})"
        about = ABOUT.get(str(self.law))
        return self.label if about is None else f"{about.title} ({self.label})"

    @property
    def shown(self) -> str:
        """Those parameters of the curve that are determined alone, in newtons where known, in words."""
        determined = [
            name
            for name, item in self.parameters.items()
            if self.is_own(name) and (item.stderr < STATED_ERROR * abs(item.value) or not item.trusted)
        ]
        known = (name.removesuffix("/m") if name.removesuffix("/m") in self.parameters else name for name in determined)
        return ", ".join(f"{name} = {self.parameters[name].brief}" for name in known)

    def is_own(self, name: str) -> bool:
        """Return whether a parameter is the curve's, and not the same one in other units."""
        if self.fit.task.curve.kind:
            return name in CURVE and name not in ("k/m", "v_dr")
        own = name.removesuffix("/m")
        return name.startswith("(") or (own in self.fit.law.free and f"{name}/m" not in self.parameters)

    def position(self, t: "ArrayLike") -> Array:
        """Return the fitted position in the record's frame.

        Parameters
        ----------
        t : array_like
            Times of the record, s.

        Returns
        -------
        array of the same shape
            m, without lost counts that smoothing found; NaN outside the fitted cycles.

        Raises
        ------
        InputError
            For the row of several runs together.
        """
        return self.motion.sign * self._motion_at(t)[0]

    def velocity(self, t: "ArrayLike") -> Array:
        """Return the fitted velocity, m/s, positive towards +x; arguments as of `position`."""
        return self.motion.sign * self._motion_at(t)[1]

    def friction(self, s: "ArrayLike", *, band: bool = False) -> "Array | tuple[Array, Array, Array]":
        """Return friction at slip speeds, positive where it opposes the slip.

        Parameters
        ----------
        s : array_like
            Slip speeds, m/s; at 0 friction as slip begins, of a ramp 0.  Friction is odd in them.
        band : bool
            Also return the ends of the interval of confidence 1 - `alpha` at each speed: that of the fitted law.

        Returns
        -------
        array of the same shape, or three of them
            N where the mass or the spring's stiffness is known, else N/kg; at the mean friction level of the record.
            With ``band``: friction, its lower and its upper end.
        """
        speed = numbers(s, "s")
        if not self.fit.problem.ramp:
            speed = np.where(speed == 0, np.finfo(float).tiny, speed)
        value = -friction.friction_at(self.fit, self.motion, speed)
        if not band:
            return value
        half = friction_band(self.fit, self.motion, speed.ravel(), self.alpha).reshape(speed.shape)
        return value, value - half, value + half

    @property
    def aic(self) -> float:
        """Akaike's information criterion, n ln(sum of squared residuals / n) + 2 k, as in lmfit; k counts all unknowns.

        It takes residuals as independent, which those of a record are not: `weight` compares laws cycle by cycle.
        """
        return self._deviance + 2 * self._unknowns

    @property
    def bic(self) -> float:
        """Bayesian information criterion, n ln(sum of squared residuals / n) + k ln(n); as `aic`."""
        return self._deviance + math.log(self.fit.residual.size) * self._unknowns

    @property
    def _deviance(self) -> float:
        return self.fit.residual.size * math.log(float(np.mean(np.square(self.fit.residual))))

    @property
    def _unknowns(self) -> int:
        return self.fit.q.size + self.fit.local.size

    @property
    def residuals(self) -> "pd.DataFrame":
        """The residuals, one row for each fitted sample.

        Columns: ``time_s``, ``cycle`` (1 is the first break-away), ``phase`` ("stick" or "slip"), ``position_m`` as
        measured, ``fitted_m``, and ``residual_m``, the fitted position minus the measured one.

        Raises
        ------
        InputError
            For the row of several runs together.
        """
        import pandas as pd

        self._refuse_several("residuals")
        windows, sign = self.fit.windows, self.motion.sign
        row = np.repeat(np.arange(windows.table.shape[0]), windows.table[:, 3])
        measured, left = sign * windows.position, sign * self.fit.residual
        number = np.array([cycle.number for cycle in self.fit.cycles])
        return pd.DataFrame(
            {
                "time_s": self.motion.begin + windows.time,
                "cycle": number[windows.table[row, 0]],
                "phase": np.where(windows.table[row, 1] == 1, "stick", "slip"),
                "position_m": measured,
                "fitted_m": measured + left,
                "residual_m": left,
            }
        )

    def profile(self, name: str) -> "pd.DataFrame":
        """Hold a parameter at values around the fitted one, and fit all others again.

        The deviance is twice the rise of the objective: of a nearly linear problem the squared distance in standard
        errors, 3.84 at the ends of a 95 % interval; it rises faster towards a bound, as of a damping, which cannot be
        negative.  Errors of the metres per count and of the mass only scale the result, and are not included.

        Parameters
        ----------
        name : str
            A name in ``parameters`` that follows from no others.

        Returns
        -------
        DataFrame
            ``value`` (``attrs["unit"]`` has its unit), ``deviance``, and ``rms_m``, the rms residual in m.

        Raises
        ------
        InputError
            For a parameter that is unknown, fixed or follows from others, and for one run among several.
        """
        import pandas as pd

        if self.fit.run is not None:
            do = "call ranking.best.profile(name), which covers all runs"
            raise InputError("a single run of a joint fit has no profile", "profile", do)
        found = pd.DataFrame(resampling.profile(self.fit, self.motion, self.parameters, name))
        found.attrs["unit"] = self.parameters[name].unit
        return found

    def _motion_at(self, t: "ArrayLike") -> tuple[Array, Array]:
        self._refuse_several("position and velocity")
        return motion_at(self.fit, numbers(t, "t") - self.motion.begin)

    def _refuse_several(self, what: str) -> None:
        if self.fit.runs > 1:
            do = f"use those of one run: ranking.runs[0].row({self.law!r})"
            raise InputError(f"a joint fit of {self.fit.runs} runs has no common time", what, do)


@dataclass(frozen=True)
class UnfittedLaw(_Row):
    """The row of a law without a valid fit: it has no numbers."""

    law: int | str
    name: str
    reason: str
    formula: str | None = None
    asked: bool = True
    rate: str = ""
    parameters: dict[str, Parameter] = field(default_factory=dict, init=False)

    fitted = in_set = False
    score = weight = rms_m = misfit = cycles = outside_band = orbit = cpu_s = None


@dataclass(frozen=True, eq=False, repr=False)
class Ranking:
    """The laws, best first, with the verdict, the break-aways and the warnings.

    Attributes
    ----------
    verdict : str
        A sentence; it names the `members`, unless no law describes the record.
    members : tuple of int or str
        Model confidence set, best first: laws that the record cannot distinguish.  Whether any of them describes the
        record is in ``adequacy``.
    rows : tuple of LawResult
        Best first, the set before all others; empty where no law comes near the record.
    events : tuple of BreakAway
        The break-aways.
    warnings : tuple of str
        In words, those of the findings included.
    motion : MeasuredMotion
        The fitted motion in the fit's frame; of the first of several runs.
    cut : CycleSegmentation
        Its cycles.
    adequacy : Adequacy
        Whether the best law describes all runs together, and the results without a law.
    findings : tuple of Finding
        Contradictions between calibration and record, and the faults that smoothing found.
    runs : tuple of Ranking
        For several runs fitted together, the parameters, residuals, cycles and motion of each.
    records : tuple of Kinematics
        The smoothed runs.
    alpha : float
        1 - confidence of the intervals.
    unfitted : tuple of UnfittedLaw
        The laws that were not fitted, with the reasons.
    sustained : bool
        Whether the mass sticks in the long run; else only the start-up shows friction.
    not_excluded : tuple of int or str
        Laws outside the set whose residual equals the best law's within the noise of the comparison.
    part : str
        The fitted part in words; "" for all.
    stages : tuple of str
        Sha256 of the smoothed velocity in each run's file, or "".
    cpu_s : float
        CPU time, s.

    Examples
    --------
    >>> import fitting
    >>> ranking = fitting.rank("data_samples/law5.h5", laws=5)
    >>> print(ranking.best.parameters["gamma"])
    9.613 [9.562, 9.664] s/m
    >>> float(ranking.correlation.loc["gamma", "c/m"].round(2))
    -0.93
    >>> float((1e6 * ranking.residuals.residual_m.std()).round(2))  # um
    2.22
    """

    verdict: str
    members: tuple[int | str, ...]
    rows: tuple[LawResult, ...]
    events: tuple[BreakAway, ...]
    warnings: tuple[str, ...]
    motion: MeasuredMotion
    cut: CycleSegmentation
    adequacy: Adequacy
    findings: tuple[Finding, ...] = ()
    runs: "tuple[Ranking, ...]" = ()
    records: tuple[Kinematics, ...] = ()
    alpha: float = 0.05
    unfitted: tuple[UnfittedLaw, ...] = ()
    not_excluded: tuple[int | str, ...] = ()
    sustained: bool = True
    part: str = ""
    stages: tuple[str, ...] = ()
    cpu_s: float = 0.0

    @property
    def laws_in_set(self) -> tuple[int, ...]:
        """The members of the set that are of the six."""
        return tuple(law for law in self.members if isinstance(law, int))

    @property
    def best(self) -> LawResult:
        """The first row; IndexError where no law came near the record."""
        return self.rows[0]

    @property
    def table(self) -> "tuple[LawResult | UnfittedLaw, ...]":
        """The rows, then those of the laws that could not be fitted."""
        return (*self.rows, *self.unfitted)

    @property
    def rivals(self) -> tuple[LawResult, ...]:
        """The rows of laws given as formulas, best first."""
        return tuple(row for row in self.rows if isinstance(row.law, str))

    @property
    def published(self) -> list[dict[str, Any]]:
        """The published laws as `forms` has them."""
        nearest: list[_Row] = sorted(self.rows, key=attrgetter("misfit"))
        return [row.as_form() for row in (*nearest, *self.unfitted) if row.law in PUBLISHED]

    @property
    def sides(self) -> "tuple[Ranking, ...]":
        """The ranking of each run; of a single run this one."""
        return self.runs or (self,)

    @property
    def aic(self) -> float:
        """`LawResult.aic` of the best law."""
        return self._best("aic").aic

    @property
    def bic(self) -> float:
        """`LawResult.bic` of the best law."""
        return self._best("bic").bic

    def __getitem__(self, name: str) -> Parameter:
        """Return a parameter of the best law; KeyError for others."""
        parameters = self._best("parameters").parameters
        if name not in parameters:
            raise KeyError(f"no parameter {name!r}; {nearest(str(name), list(parameters))}")
        return parameters[name]

    def summary(self) -> "pd.DataFrame":
        """Return the answer as a pandas table of one row, so that the rows of many runs can be joined.

        Columns: ``verdict``, ``adequacy``, ``law`` and ``name`` of the best law, ``rms_m``, and those of its parameters
        as in `to_dataframe`.  ``attrs["units"]`` has the parameters' units.
        """
        import pandas as pd

        row: dict[str, Any] = {"verdict": self.verdict, "adequacy": self.adequacy.verdict}
        units = {}
        if self.rows:
            best = self.best
            row |= {"law": best.law, "name": best.name, "rms_m": best.rms_m} | in_columns(best.parameters)
            units = {name: item.unit for name, item in best.parameters.items()}
        frame = pd.DataFrame([row])
        frame.attrs["units"] = units
        return frame

    def fit_report(self) -> str:
        """Return the fit of the best law as text in the form of lmfit: statistics, parameters, correlations."""
        return str(import_module(TEXTS).fit_report(self))

    def ci_report(self) -> str:
        """Return the confidence intervals of the best law's parameters as text: lower end, value, upper end."""
        return str(import_module(TEXTS).ci_report(self))

    def save(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the ranking, with records and fits, into a file for `load`.

        Parameters
        ----------
        path : path
            The file, about a kilobyte for each sample.
        force : bool
            Replace an existing file.

        Raises
        ------
        InputError
            The file exists and ``force`` is not given, or its folder does not exist.
        """
        target = Path(path)
        atomic.refuse_existing(target, force)
        with atomic.replacing(target, force) as temporary:
            temporary.write_bytes(SAVED + pickle.dumps(self))
        return target

    @staticmethod
    def load(path: "str | os.PathLike[str]") -> "Ranking":
        """Return a ranking that `save` wrote.

        It is a pickle, which may run any code: load only files that you trust.  Another release may not read it; the
        run file and ``to_dataframe()`` last longer.

        Raises
        ------
        InputError
            The file was written by another program or release.
        """
        if not Path(path).is_file():
            raise InputError("no such file", str(path), "check the path")
        content = Path(path).read_bytes()
        if not content.startswith(SAVED):
            do = "rank the run again, or load the file with the version that saved it"
            raise InputError(f"was not saved by stickslip {VERSION} as a ranking", str(path), do)
        return pickle.loads(content[len(SAVED) :])  # type: ignore[no-any-return]

    def row(self, law: int | str) -> LawResult:
        """Return the row of a fitted law, by its number or name; KeyError for others."""
        for row in self.rows:
            if row.law == law:
                return row
        why = next((f": {row.reason}" for row in self.unfitted if row.law == law), "")
        raise KeyError(f"law {law} was not fitted{why}; fitted: {', '.join(str(row.law) for row in self.rows)}")

    @cached_property
    def statistics(self) -> tuple[StickSlipStatistics, ...]:
        """Sticks and slips of each run."""
        return tuple(map(from_kinematics, self.records))

    def as_json(self) -> dict[str, Any]:
        """Return the command's JSON document."""
        document: dict[str, Any] = {
            "verdict": self.verdict,
            "set": list(self.laws_in_set),
            "rivals": [row.law for row in self.rivals if row.in_set],
            "not_excluded": list(self.not_excluded),
            "ranking": [row.as_json() for row in self.table],
            "cycles": [event.as_json() for event in self.events],
            "warnings": list(self.warnings),
            "findings": [vars(finding) for finding in self.findings],
            "adequacy": self.adequacy.as_json(),
            "correlations": None if (found := self.correlations()) is None else found.as_json(),
            "cpu_s": self.cpu_s,
        }
        if self.adequacy.curve is not None:
            document["adequacy"]["curve"]["forms"] = [
                form | {"parameters": {name: item and item.as_json() for name, item in form["parameters"].items()}}
                for form in self.published
            ]
        if self.runs:
            document["cycles"] = [
                {"run": number} | event.as_json()
                for number, run in enumerate(self.runs, start=1)
                for event in run.events
            ]
            document["runs"] = [
                run.as_run() | {"statistics": counted.as_json()}
                for run, counted in zip(self.runs, self.statistics, strict=True)
            ]
        return document | {"statistics": pooled(self.statistics).as_json()}

    def as_run(self) -> dict[str, Any]:
        """Return the JSON document of one run among several."""
        if not self.rows:
            return {"adequacy": self.adequacy.as_json()}
        return {
            "rms_m": self.best.rms_m,
            "cycles": self.best.cycles,
            "parameters": {name: item.as_json() for name, item in self.best.parameters.items()},
            "adequacy": self.adequacy.as_json(),
            "rms_by_law": {str(row.law): row.rms_m for row in self.rows},
        }

    def correlations(self) -> Correlations | None:
        """Return the correlations of the first run's best parameters; None where intervals are withheld."""
        if not self.rows or not all(item.trusted for item in self.best.parameters.values()):
            return None
        fit, motion = self.best.fit, self.sides[0].motion
        found = correlations(fit, motion)
        if not self.runs:
            return found
        return replace(found, names=tuple(f"{name} (1)" if name in RUN_PARAMETERS else name for name in found.names))

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the laws as a pandas table, best first.

        Columns: those of `as_json` without ``outside_band``; then for each parameter "NAME", "NAME stderr", "NAME lo"
        and "NAME hi": missing where the law has no such parameter or the interval is withheld.  ``attrs["units"]`` has
        the unit of each parameter.
        """
        import pandas as pd

        table: list[dict[str, Any]] = []
        units: dict[str, str] = {}
        for row in self.table:
            flat = row.as_json()
            del flat["outside_band"], flat["parameters"]
            table.append(flat | in_columns(row.parameters))
            units |= {name: item.unit for name, item in row.parameters.items()}
        frame = pd.DataFrame(table)
        frame.attrs["units"] = units
        return frame

    @property
    def correlation(self) -> "pd.DataFrame":
        """Correlations of the errors of the best law's parameters, as a pandas table.

        Parameters are per unit mass, without fixed ones and those that follow from others; of several runs v_dr and x0
        are the first run's, ``v_dr (1)``.

        Raises
        ------
        DataError
            No law describes the record: the intervals are withheld.
        """
        errors = self._correlations("correlation")
        place = [errors.names.index(name) for name in self._names]
        return self._square(errors.matrix[np.ix_(place, place)])

    @property
    def covariance(self) -> "pd.DataFrame":
        """`correlation` times the standard errors of ``best.parameters``; their units in ``attrs["units"]``."""
        self._correlations("covariance")
        error = np.array([self.best.parameters[name].stderr for name in self._names])
        return self._square(self.correlation.to_numpy() * np.outer(error, error))

    @property
    def residuals(self) -> "pd.DataFrame":
        """The best law's `LawResult.residuals`; of several runs with a first column ``run``, from 1."""
        import pandas as pd

        law = self._best("residuals").law
        if not self.runs:
            return self.best.residuals
        parts = {number: side.row(law).residuals for number, side in enumerate(self.runs, start=1)}
        return pd.concat(parts, names=["run", None]).reset_index(level=0).reset_index(drop=True)

    @property
    def curve(self) -> "pd.DataFrame":
        """Friction against slip speed, measured without a law, as a pandas table.

        Columns: ``speed``, m/s, ``friction``, and ``lo`` and ``hi``, a simultaneous band of the confidence
        1 - `alpha`.  ``attrs["units"]``: N where the mass or the spring's stiffness is known, else N/kg.

        Raises
        ------
        DataError
            No curve could be measured.
        """
        import pandas as pd

        measured = self._measured("curve")
        table = pd.DataFrame({name: getattr(measured, name) for name in ("speed", "friction", "lo", "hi")})
        table.attrs["units"] = {"speed": "m/s"} | dict.fromkeys(("friction", "lo", "hi"), self.adequacy.unit)
        return table

    @property
    def forms(self) -> "pd.DataFrame":
        """The fits of the published laws, as a pandas table with the smallest residual first.

        Columns: ``name``, ``formula``, ``source``, ``chi`` (rms residual over the noise of a position),
        ``inside_band`` (whether the curve stays inside the band of `curve`), and those of the parameters as in
        `to_dataframe`, missing where the law was not fitted; levels in the unit of `curve`.

        Raises
        ------
        DataError
            No curve could be measured.
        """
        import pandas as pd

        self._measured("forms")
        columns = ("name", "formula", "source", "chi", "inside_band")
        fitted = [{name: item for name, item in form["parameters"].items() if item} for form in self.published]
        rows = [
            {name: form[name] for name in columns} | in_columns(parameters)
            for form, parameters in zip(self.published, fitted, strict=True)
        ]
        table = pd.DataFrame(rows, columns=None if rows else columns)
        table.attrs["units"] = {name: item.unit for parameters in fitted for name, item in parameters.items()}
        return table

    def bootstrap(self, n: int = 200, seed: int | None = None) -> "pd.DataFrame":
        """Fit the best law again to resampled cycles (Bayesian bootstrap: Rubin, 1981).

        The standard deviation of a column is a standard error that assumes neither a normal distribution nor a linear
        problem.  Calibrations are drawn from their errors.  With few cycles the spread is too small, as of every
        bootstrap: by 10 to 20 % with twenty cycles, by a fourth with five.

        Parameters
        ----------
        n : int
            Draws; each costs about as much CPU time as 1/30 of `fitting.rank`.
        seed : int, optional
            The same draws for the same seed.

        Returns
        -------
        DataFrame
            One row for each draw, columns and units as of `covariance`.

        Raises
        ------
        DataError
            No law describes the record, or more than a tenth of the draws cannot be fitted.
        InputError
            For fewer than two draws.
        """
        import pandas as pd

        self._correlations("bootstrap")
        draws = resampling.bootstrap(self.best.fit, self.sides[0].motion, n, seed)
        names = {name.removesuffix(" (1)"): name for name in self._names}
        return self._with_units(pd.DataFrame({shown: draws[name] for name, shown in names.items()}))

    def to_xarray(self) -> "xr.Dataset":
        """Return samples, parameters and measured curve as an xarray data set, with units as attributes.

        Dimensions: ``sample`` (``time``, ``cycle``, ``phase``, ``position``, ``fitted``, ``residual``; of several runs
        ``run``), ``law`` and ``parameter`` (``value``, ``stderr``, ``lo``, ``hi``, NaN where a law has no such
        parameter or the interval is withheld), and ``speed`` (``friction``, ``friction_lo``, ``friction_hi``).

        Raises
        ------
        InputError
            xarray is not installed.
        DataError
            No law came near the record.
        """
        try:
            import xarray as xr
        except ImportError:
            do = "install it: pip install 'stickslip[xarray]'; or use residuals, curve and to_dataframe()"
            raise InputError("xarray is not installed", "to_xarray", do) from None
        samples, law_rows = self.residuals, [in_columns(row.parameters) for row in self.rows]
        units = dict(self.to_dataframe().attrs["units"])
        data: dict[str, tuple[str | tuple[str, str], Any]] = {
            str(name).removesuffix("_s").removesuffix("_m"): ("sample", samples[name].to_numpy()) for name in samples
        }
        for part in ("value", "stderr", "lo", "hi"):
            keys = [name if part == "value" else f"{name} {part}" for name in units]
            cells = [[np.nan if row.get(key) is None else row[key] for key in keys] for row in law_rows]
            data[part] = ("law", "parameter"), cells
        in_units = {"time": "s", "position": "m", "fitted": "m", "residual": "m"}
        if self.adequacy.curve is not None:
            curve = self.curve
            for name, column in {"friction": "friction", "friction_lo": "lo", "friction_hi": "hi"}.items():
                data[name], in_units[name] = ("speed", curve[column].to_numpy()), self.adequacy.unit
            data["speed"], in_units["speed"] = ("speed", curve["speed"].to_numpy()), "m/s"
        data["law"] = "law", [str(row.law) for row in self.rows]
        data["parameter"], data["unit"] = ("parameter", list(units)), ("parameter", list(units.values()))
        made = xr.Dataset(data).set_coords([name for name in ("time", "cycle", "phase", "run", "unit") if name in data])
        for name, unit in in_units.items():
            made[name].attrs["units"] = unit
        return made.assign_attrs(verdict=self.verdict, adequacy=self.adequacy.said)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw friction against relative speed: the measured curve with its band, and the laws of the set.

        Without a measured curve the force balance of the best law at each sample is drawn.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw all speeds; by default a new figure, with a second picture of the low ones.

        Returns
        -------
        matplotlib Figure
            It can be saved by ``figure.savefig(path)``.

        Raises
        ------
        DataError
            No law came near the record.
        """
        from fitting import drawing

        best = self._best("ranking")
        rows = [row for row in self.rows if row.in_set] or [best]
        shown = [(row.fit, row.called) for row in rows]
        return drawing.friction(shown, self.motion, self.adequacy.curve, self.verdict, ax)

    def report(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the report that `fit-friction` writes, an HTML page.

        Parameters
        ----------
        path : path
            The page.
        force : bool
            Replace a file that is no report of these runs.

        Raises
        ------
        InputError
            The name has the suffix of another format, its folder does not exist, or it is another file and ``force``
            is not given.
        """
        target = Path(path)
        suffix.check(target, suffix.PAGE, "--report", {suffix.PDF: "then print the page from a browser"})
        import_module(PAGE).write(self, target, force=force)
        return target

    def save_scene(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the fitted rig as a scene (.toml) for `rig_sim.scene` and every command of `rig-sim`.

        It contains the best law or, where no law describes the record, the measured curve; and the covariance, for the
        draws of `rig_sim.continue_`.

        Parameters
        ----------
        path : path
            The scene.
        force : bool
            Replace an existing file.

        Raises
        ------
        InputError
            The name has the suffix of another format, or the file exists and ``force`` is not given.
        DataError
            Neither a law nor a friction curve describes the record.
        """
        target = Path(path)
        suffix.check(target, suffix.TOML, "--save-scene", {})
        recordings = [record.recording for record in self.records]
        runs = (one.source for one in recordings if one.source.name)
        atomic.refuse_existing(target, force, *runs, kind="scene", flag="--save-scene")
        import_module(SCENE).save(target, self, Path(recordings[0].name))
        return target

    @property
    def _names(self) -> list[str]:
        return [name for name in self._correlations("names").names if not self.best.parameters[name].fixed]

    def _square(self, matrix: Array) -> "pd.DataFrame":
        import pandas as pd

        return self._with_units(pd.DataFrame(matrix, self._names, self._names))

    def _with_units(self, table: "pd.DataFrame") -> "pd.DataFrame":
        table.attrs["units"] = {name: self.best.parameters[name].unit for name in self._names}
        return table

    def _best(self, what: str) -> LawResult:
        if not self.rows:
            raise DataError(
                "no law fits this record even roughly", what, "plot the kinematics: ranking.records[0].plot()"
            )
        return self.best

    def _correlations(self, what: str) -> Correlations:
        self._best(what)
        correlations = self.correlations()
        if correlations is None:
            do = "use ranking.curve, which needs no law; ranking.adequacy.departures lists what may be missing"
            raise DataError("no law describes the record, so the intervals are withheld", what, do)
        return correlations

    def _measured(self, what: str) -> MeasuredCurve:
        if self.adequacy.curve is None:
            raise DataError("no friction curve could be measured", what, "record more cycles of stick-slip")
        return self.adequacy.curve

    def __repr__(self) -> str:
        if not self.rows:
            return f"<Ranking: {self.verdict}>"
        best = self.best
        kept = (name for name in best.parameters if name.split(" (")[0] in CURVE or best.is_own(name))
        shown = (f"{name} = {best.parameters[name]}" for name in kept)
        return f"<Ranking: {self.verdict}\n {best.label}: {', '.join(shown)}>"

    def _repr_html_(self) -> str:
        about = [("verdict", self.verdict), *(("warning", in_python(text)) for text in self.warnings)]
        parts = [notebook.table("Ranking", about)]
        if self.rows:
            header = ("law", "", "rms (um)", "weight", "in the set")
            laws = (
                (
                    str(row.law),
                    row.formula or row.name,
                    f"{1e6 * row.rms_m:.4g}",
                    "" if row.weight is None else f"{row.weight:.2f}",
                    "yes" if row.in_set else "no",
                )
                for row in self.rows
            )
            unfitted = ((str(row.law), row.formula or row.name, "not fitted", "", "") for row in self.unfitted)
            parts.append(notebook.table("Laws, best first", (*laws, *unfitted), header))
            values = ((name, str(item)) for name, item in self.best.parameters.items())
            parts.append(notebook.table(f"Parameters of {self.best.label}", values))
        return "\n".join(parts)
