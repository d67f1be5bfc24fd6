"""The ranking: one row per law, the break-aways, and the verdict with its warnings."""

from dataclasses import dataclass, field
from typing import Any

from fitting.adequacy.result import Adequacy
from fitting.curve.result import BandExit
from fitting.data.cycles import CycleSegmentation
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit
from fitting.estimation.result import BreakAway, Parameter
from processing.record.finding import Finding


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
        Mean paired difference of log error to the best law, penalty included, and half its t-interval.
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

    @property
    def best(self) -> LawResult:
        """The first row; there is none where no law came near the record."""
        return self.rows[0]

    def row(self, law: int) -> LawResult:
        """Return the row of one law; KeyError when it was not fitted."""
        for row in self.rows:
            if row.law == law:
                return row
        raise KeyError(law)

    def as_json(self) -> dict[str, Any]:
        """Return the command's JSON document."""
        document = {
            "verdict": self.verdict,
            "set": list(self.laws_in_set),
            "ranking": [row.as_json() for row in self.rows],
            "cycles": [event.as_json() for event in self.events],
            "warnings": list(self.warnings),
            "findings": [vars(finding) for finding in self.findings],
            "adequacy": self.adequacy.as_json(),
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
