"""The ranking: one row per law, the break-aways, and the verdict with its warnings."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from daq.base.errors import DataError
from fitting.adequacy.result import Adequacy
from fitting.curve.result import BandExit
from fitting.data.cycles import CycleSegmentation
from fitting.data.frame import MeasuredMotion
from fitting.estimation.derived import RUNS_OWN, correlations
from fitting.estimation.fit import Fit
from fitting.estimation.result import BreakAway, Correlations, Parameter
from fitting.selection.rivals import RivalResult
from processing.record.finding import Finding

if TYPE_CHECKING:
    import pandas as pd

    from daq.base.output.plot import PngFigure

CURVE = ("k/m", "Fs/m", "v_dr", "gamma", "G_slip/m", "d")  # parameters in the short form of a ranking


@dataclass(frozen=True)
class LawResult:
    """One row of the ranking.

    Attributes
    ----------
    law : int
    name : str
    score : float
        Penalised log error of the record (smaller is better), minus the best law's.
    weight : float
        exp(-score/2), normalised over the laws fitted.
    in_set : bool
        Whether the record cannot distinguish this law from the best one.
    rms_m : float
        m, all windows together.
    cycles : int
        Cycles fitted.
    parameters : dict
        By name; per unit mass, and in newtons when the mass or the spring's stiffness is known.
    cpu_s : float
    behind : (float, float)
        Mean paired difference of log error to the best law, penalty included, and its standard error.
    orbit : float
        Distance of the law's orbit to the measured one, of the orbit's size (`fitting.selection.phase_distance`).
    fit : Fit
        The fit itself, for pictures.
    outside_band : BandExit or None
        Where its curve leaves the band of the measured one the furthest.
    """

    law: int
    name: str
    score: float
    weight: float
    in_set: bool
    rms_m: float
    cycles: int
    parameters: dict[str, Parameter]
    cpu_s: float
    behind: tuple[float, float]
    orbit: float
    fit: Fit = field(repr=False, compare=False)
    outside_band: BandExit | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the document's form."""
        document: dict[str, Any] = {
            name: getattr(self, name) for name in ("law", "name", "score", "weight", "in_set", "rms_m", "cycles")
        }
        document["parameters"] = {name: item.as_json() for name, item in self.parameters.items()}
        document["outside_band"] = None if self.outside_band is None else vars(self.outside_band)
        return document | {"orbit_distance": self.orbit, "cpu_s": self.cpu_s}


@dataclass(frozen=True, eq=False)
class Ranking:
    """The laws in order, with the verdict, the break-aways and the warnings.

    Attributes
    ----------
    verdict : str
        A sentence; the laws it names are `laws_in_set`, unless it says that none describes the record.
    laws_in_set : tuple of int
        Model confidence set: laws that the record cannot distinguish, best first.  It compares the laws with each
        other; whether any of them describes the record is said by ``adequacy``.
    rows : tuple of LawResult
        Best first, those in the set before all others; none where the record is stick-slip that no law comes near.
    events : tuple of BreakAway
    warnings : tuple of str
        The texts of the findings among them.
    findings : tuple of Finding
        Contradictions between calibration and record, and the faults that smoothing found.
    motion, cut
        What was fitted, in the fit's frame; the first run's where there are several.
    adequacy : Adequacy
        Of all runs together.
    cpu_s : float
    rivals : tuple of RivalResult
        Curves besides the six that were fitted, best first (`fitting.selection.rivals`).
    runs : tuple of Ranking
        Of several runs fitted together each run's own side: its parameters, residuals, cycles and motion.
    """

    verdict: str
    laws_in_set: tuple[int, ...]
    rows: tuple[LawResult, ...]
    events: tuple[BreakAway, ...]
    warnings: tuple[str, ...]
    motion: MeasuredMotion = field(repr=False)
    cut: CycleSegmentation = field(repr=False)
    adequacy: Adequacy
    cpu_s: float = 0.0
    findings: tuple[Finding, ...] = ()
    runs: "tuple[Ranking, ...]" = ()
    rivals: tuple[RivalResult, ...] = ()

    @property
    def best(self) -> LawResult:
        """The best row of the six; there is none where no law came near the record."""
        return self.rows[0]

    @property
    def sides(self) -> "tuple[Ranking, ...]":
        """Each run's own side; of a single run the ranking itself."""
        return self.runs or (self,)

    def row(self, law: int) -> LawResult:
        """Return the row of one law; KeyError when it was not fitted."""
        for row in self.rows:
            if row.law == law:
                return row
        raise KeyError(law)

    @property
    def candidates(self) -> "list[LawResult | RivalResult]":
        """The rows of the six and of their rivals, best first: members of the set before all others."""
        six = iter(self.rows)  # a law that is a limit of the best one may stand before it
        found: list[LawResult | RivalResult] = [*self.rows, *self.rivals]
        found.sort(key=lambda row: (not row.in_set, row.score))
        return [row if isinstance(row, RivalResult) else next(six) for row in found]

    def as_json(self) -> dict[str, Any]:
        """Return the command's JSON document."""
        document = {
            "verdict": self.verdict,
            "set": list(self.laws_in_set),
            "rivals": [row.law for row in self.rivals if row.in_set],
            "ranking": [row.as_json() for row in self.candidates],
            "cycles": [event.as_json() for event in self.events],
            "warnings": list(self.warnings),
            "findings": [vars(finding) for finding in self.findings],
            "adequacy": self.adequacy.as_json(),
            "correlations": None if (found := self.correlations()) is None else found.as_json(),
            "cpu_s": self.cpu_s,
        }
        if self.runs:
            document["cycles"] = [
                {"run": number} | event.as_json()
                for number, run in enumerate(self.runs, start=1)
                for event in run.events
            ]
            document["runs"] = [run.as_run() for run in self.runs]
        return document

    def as_run(self) -> dict[str, Any]:
        """Return the best law's view of one run among several."""
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
        """Return how the errors of the best law's parameters go together, of several runs those of the first.

        None where their intervals are withheld.
        """
        if not self.rows or not all(item.trusted for item in self.best.parameters.values()):
            return None
        found = correlations(self.best.fit, self.sides[0].motion)
        if not self.runs:
            return found
        return replace(found, names=tuple(f"{name} (1)" if name in RUNS_OWN else name for name in found.names))

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the laws as a pandas table, one row a law, best first.

        Columns: what `as_json` says of a law, but for ``outside_band``; then of each parameter its value under its
        name, and "NAME stderr", "NAME lo" and "NAME hi": missing where the law has no such parameter, or the interval
        is withheld.  ``attrs["units"]`` has the unit of each parameter.
        """
        import pandas as pd

        table, units = [], {}
        for row in self.candidates:
            flat = row.as_json()
            del flat["outside_band"]
            for name, item in flat.pop("parameters").items():
                units[name] = item["unit"]
                flat[name] = item["value"]
                flat |= {f"{name} {part}": item[part] for part in ("stderr", "lo", "hi")}
            table.append(flat)
        frame = pd.DataFrame(table)
        frame.attrs["units"] = units
        return frame

    def plot(self) -> "PngFigure":
        """Draw friction against relative speed: the measured curve with its band, and the laws of the set over it.

        Where no curve was measured, the force balance of the best law at each sample is drawn instead.

        Returns
        -------
        matplotlib Figure
            Two axes: all speeds, and the low ones.  ``figure.savefig(path)`` writes it, a notebook shows it.

        Raises
        ------
        DataError
            For a ranking without laws: nothing is known of the friction.
        """
        if not self.rows:
            raise DataError("no law came near this record", "ranking", "plot the kinematics instead")
        from fitting.drawing import plot

        fits = [row.fit for row in self.rows if row.in_set] or [self.best.fit]
        return plot.friction(fits, self.motion, self.adequacy.curve, self.verdict)

    def __repr__(self) -> str:
        if not self.rows:
            return f"<Ranking: {self.verdict}>"
        best = self.best
        shown = (f"{name} = {item}" for name, item in best.parameters.items() if name.split(" (")[0] in CURVE)
        return f"<Ranking: {self.verdict}\n law {best.law}: {', '.join(shown)}>"

    def _repr_html_(self) -> str:
        from daq.base.output import notebook

        about = [("verdict", self.verdict), *(("warning", text) for text in self.warnings)]
        parts = [notebook.table("Ranking", about)]
        if self.rows:
            header = ("law", "", "rms (um)", "weight", "in the set")
            laws = (
                (str(row.law), row.name, f"{1e6 * row.rms_m:.4g}", f"{row.weight:.2f}", "yes" if row.in_set else "no")
                for row in self.rows
            )
            parts.append(notebook.table("Laws, best first", laws, header))
            values = ((name, str(item)) for name, item in self.best.parameters.items())
            parts.append(notebook.table(f"Parameters of law {self.best.law}", values))
        return "\n".join(parts)
