"""`Ranking`, as `fitting.rank` returns it: the laws in order, as tables, errors without a covariance, and files."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting import rig_scene
from fitting.adequacy.result import Adequacy
from fitting.curve.result import MeasuredCurve
from fitting.estimation.result import Correlations, in_columns
from fitting.report import page
from fitting.selection import resampling, result
from processing.statistics import from_kinematics
from stickslip.compute.arrays import Array
from stickslip.errors import DataError, InputError, StickslipError
from stickslip.output import suffix

if TYPE_CHECKING:
    import os

    import pandas as pd
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class Ranking(result.RankedLaws):
    """The laws in order, with the verdict, the break-aways and the warnings.

    Attributes
    ----------
    verdict : str
        A sentence; the laws it names are `members`, unless it says that none describes the record.
    members : tuple of int or str
        Model confidence set: laws that the record cannot distinguish, best first.
    rows : tuple of LawResult
        Best first, those in the set before all others; none where the record is stick-slip that no law comes near.
    events : tuple of BreakAway
        The break-aways.
    warnings : tuple of str
        The texts of the findings among them.
    findings : tuple of Finding
        Contradictions between calibration and record, and the faults that smoothing found.
    adequacy : Adequacy
        Whether the best law describes the record, and what is known without a law.
    runs : tuple of Ranking
        Of several runs fitted together each run's own side.
    records : tuple of Kinematics
        The smoothed runs.
    alpha : float
        1 - confidence of the intervals.
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

    @classmethod
    def of(cls, ranking: result.RankedLaws) -> "Ranking":
        """Return a ranking as a `Ranking`."""
        values = {field.name: getattr(ranking, field.name) for field in fields(ranking)}
        return cls(**(values | {"runs": tuple(map(cls.of, ranking.runs))}))

    @property
    def correlation(self) -> "pd.DataFrame":
        """Correlations of the errors of the best law's parameters, -1 to 1, as a pandas table.

        The parameters are those that are fitted and follow from no others, per unit mass; of several runs v_dr and x0
        are those of the first, ``v_dr (1)``.

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
        """Covariance of the best law's parameters, a pandas table.

        It is `correlation` times the standard errors of ``best.parameters``, whose units ``attrs["units"]`` has.

        Raises
        ------
        DataError
            No law describes the record: the intervals are withheld.
        """
        self._correlations("covariance")
        error = np.array([self.best.parameters[name].stderr for name in self._names])
        return self._square(self.correlation.to_numpy() * np.outer(error, error))

    @property
    def residuals(self) -> "pd.DataFrame":
        """The residuals of the best law, one row a sample that was fitted.

        Columns as of `LawResult.residuals`; of several runs a column ``run`` before them, 1 for the first.
        """
        import pandas as pd

        law = self._best("residuals").law
        if not self.runs:
            return self.best.residuals
        parts = {number: side.row(law).residuals for number, side in enumerate(self.runs, start=1)}
        return pd.concat(parts, names=["run", None]).reset_index(level=0).reset_index(drop=True)

    @property
    def curve(self) -> "pd.DataFrame":
        """Friction against slip speed, measured without a law, a pandas table with one row a speed.

        Columns: ``speed``, m/s, ``friction``, and ``lo`` and ``hi``, a band that holds the whole curve with the
        confidence 1 - `alpha`; ``attrs["units"]``.  In N where the mass or the spring's stiffness is known, else per
        kilogram.

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
        """The published laws as they were fitted to the record, a pandas table with one row a law, nearest first.

        Columns: ``name``, ``formula``, ``source``, ``chi`` (rms residual over the noise of a position),
        ``inside_band`` (whether its curve stays inside the band of `curve`), and of each parameter its value,
        "NAME stderr", "NAME lo" and "NAME hi"; missing where the law was not fitted; levels in the unit of
        `curve`.

        Raises
        ------
        DataError
            No curve could be measured.
        """
        import pandas as pd

        self._measured("forms")
        forms = self.adequacy.forms
        columns = ("name", "formula", "source", "chi", "inside_band")
        fitted = [{name: item for name, item in form.parameters.items() if item is not None} for form in forms]
        table = pd.DataFrame(
            [
                {name: getattr(form, name) for name in columns} | in_columns(parameters)
                for form, parameters in zip(forms, fitted, strict=True)
            ],
            columns=None if forms else columns,
        )
        table.attrs["units"] = {name: item.unit for parameters in fitted for name, item in parameters.items()}
        return table

    def bootstrap(self, n: int = 200, seed: int | None = None) -> "pd.DataFrame":
        """Fit the best law again to drawn cycles, and return its parameters: a pandas table, one row a draw.

        The standard deviation of a column is a standard error that assumes neither a normal distribution nor a linear
        problem.  Cycles are drawn by exponential weights (Rubin, 1981), calibrations from their errors.
        With few cycles the spread is too small, as that of every bootstrap: by 10 to 20 % with twenty cycles, by a
        fourth with five.

        Parameters
        ----------
        n : int
            Draws; each costs about as much CPU time as 1/30 of `fitting.rank`.
        seed : int, optional
            The same draws for the same seed.

        Returns
        -------
        DataFrame
            Columns as of `covariance`; ``attrs["units"]``.

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
            do = "install it: pip install xarray; or take residuals, curve and to_dataframe()"
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

    def report(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the report that `fit-friction` writes, an HTML page.

        Parameters
        ----------
        path : path
            The page.
        force : bool
            Replace a file that is no report of these runs.

        Returns
        -------
        Path
            The page.

        Raises
        ------
        InputError
            The name has the suffix of another format, its folder does not exist, or what stands there is something
            else and ``force`` is not given.
        """
        target, recordings = Path(path), [record.recording for record in self.records]
        suffix.check(target, suffix.PAGE, "--report", {suffix.PDF: "then print the page from a browser"})
        digests, files = [recording.digest for recording in recordings], self._files
        page.refuse_foreign_file(target, digests, files=files, force=force)
        counted = [from_kinematics(record) for record in self.records]
        text = page.render(self, self.records, counted, self.alpha)
        page.write(text, target, digests, files=files, force=force)
        return target

    def save_scene(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the fitted rig as a scene (.toml), which `rig_sim.scene` and every command of `rig-sim` take.

        It has the best law or, where no law describes the record, the measured curve; and the covariance, for the
        draws of `rig_sim.continue_`.

        Parameters
        ----------
        path : path
            The scene.
        force : bool
            Replace an existing file.

        Returns
        -------
        Path
            The scene.

        Raises
        ------
        InputError
            The name has the suffix of another format, or the file exists and ``force`` is not given.
        DataError
            Neither a law nor a friction curve describes the record.
        """
        target = Path(path)
        suffix.check(target, suffix.TOML, "--save-scene", {})
        rig_scene.refuse_existing(target, self._files, force=force)
        rig_scene.save(target, self, from_kinematics(self.records[0]), Path(self.records[0].recording.name))
        return target

    @property
    def _files(self) -> list[Path]:
        """The files of the runs; empty for a run in memory."""
        return [record.recording.source for record in self.records if record.recording.source.name]

    @property
    def _names(self) -> list[str]:
        """The fitted parameters of the best law that follow from no others."""
        return [name for name in self._correlations("names").names if not self.best.parameters[name].fixed]

    def _square(self, matrix: Array) -> "pd.DataFrame":
        import pandas as pd

        return self._with_units(pd.DataFrame(matrix, self._names, self._names))

    def _with_units(self, table: "pd.DataFrame") -> "pd.DataFrame":
        table.attrs["units"] = {name: self.best.parameters[name].unit for name in self._names}
        return table

    def _best(self, what: str) -> result.LawResult:
        if not self.rows:
            raise DataError("no law came near this record", what, "plot the kinematics: ranking.records[0].plot()")
        return self.best

    def _correlations(self, what: str) -> Correlations:
        self._best(what)
        correlations = self.correlations()
        if correlations is None:
            do = "take ranking.curve, which needs no law; ranking.adequacy.departures says what may be missing"
            raise DataError("no law describes the record, and the intervals are withheld", what, do)
        return correlations

    def _measured(self, what: str) -> MeasuredCurve:
        adequacy: Adequacy = self.adequacy
        if adequacy.curve is None:
            raise DataError("no friction curve could be measured", what, "record more cycles of stick-slip")
        return adequacy.curve


@dataclass(frozen=True, eq=False)
class RankedRun:
    """One run of `fitting.rank_each`.

    Attributes
    ----------
    file : Path
        The run's file; of a run in memory its name.
    ranking : Ranking or None
        None where the run could not be fitted.
    error : StickslipError or None
        Why it could not: what was wrong, where, and what to do.
    """

    file: Path
    ranking: Ranking | None
    error: StickslipError | None


class RankedRuns(list[RankedRun]):
    """Runs that were each fitted by themselves, in their order: a list of `RankedRun`."""

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the runs as a pandas table, one row a run.

        Columns: ``file``, ``verdict``, ``adequacy``, ``law`` and ``name`` of the best law, ``rms_m``, ``error``, and of
        each parameter of that law its value under its name, and "NAME stderr", "NAME lo" and "NAME hi": missing where
        the law has no such parameter, the interval is withheld, or the run could not be fitted.  ``attrs["units"]`` has
        the unit of each parameter.
        """
        import pandas as pd

        names = ("file", "verdict", "adequacy", "law", "name", "rms_m", "error")
        table: list[dict[str, Any]] = []
        units: dict[str, str] = {}
        for run in self:
            row: dict[str, Any] = dict.fromkeys(names) | {"file": str(run.file)}
            if run.error is not None:
                row["error"] = str(run.error)
            if run.ranking is not None:
                row |= {"verdict": run.ranking.verdict, "adequacy": run.ranking.adequacy.verdict}
                if run.ranking.rows:
                    best = run.ranking.best
                    row |= {"law": best.law, "name": best.name, "rms_m": best.rms_m} | in_columns(best.parameters)
                    units |= {name: item.unit for name, item in best.parameters.items()}
            table.append(row)
        frame = pd.DataFrame(table)
        frame.attrs["units"] = units
        return frame
