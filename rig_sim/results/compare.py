"""The methods of integration compared: errors of event times, and CPU times."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from rig_sim.comparison import error_vs_time
from rig_sim.results.arguments import SceneLike, load_scene, parse_number
from rig_sim.results.result import UNIT, Result
from stickslip.compute.stages import Stages, silent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BELOW_ROUNDING = 1e-17  # drawn in place of an error of 0


@dataclass(frozen=True, repr=False)
class Comparison(Result, error_vs_time.Comparison):
    """Errors and CPU times of the methods of integration: what `rig_sim.compare` returns.

    Attributes
    ----------
    results : tuple of MethodResult
        method, setting, error (the largest of an event time; None where the events differ), cpu_s, us_per_cycle, note.
    reference : str
        What the errors are against.
    compile_s : float
        CPU time of compiling, or of loading what is compiled, s.
    cycles : int
        In the reference.
    """

    UNITS: ClassVar[Mapping[str, str]] = {"error": "s", "cpu_s": "s", "us_per_cycle": "us"}
    SIZE = (7.4, 5.0)

    def as_json(self) -> dict[str, Any]:
        return {"rows": self.rows(), **super().as_json()}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [asdict(row) for row in self.results]

    def lines(self) -> list[str]:
        errors = [row.note if row.error is None else f"{row.error:.1e}" for row in self.results]
        width = max(map(len, errors))
        lines = [f"{'method':11} {'setting':13} {'error':>{width}} {'CPU s':>9} {'us/cycle':>10}"]
        for row, error in zip(self.results, errors, strict=True):
            cycle = "" if row.us_per_cycle is None else f"{row.us_per_cycle:.3g}"
            lines.append(f"{row.method:11} {row.setting:13} {error:>{width}} {row.cpu_s:9.2g} {cycle:>10}")
        return [
            *lines,
            f"error: largest error of an event time, against {self.reference}; {self.cycles} cycles",
            f"compiling or loading compiled code: {self.compile_s:.1f} s of CPU time, which is not included",
        ]

    def draw(self, ax: "Axes") -> None:
        for method in dict.fromkeys(row.method for row in self.results):
            rows = [row for row in self.results if row.method == method and row.error is not None]
            rows.sort(key=lambda row: row.cpu_s)
            errors = [max(row.error or 0.0, BELOW_ROUNDING) for row in rows]
            ax.loglog([row.cpu_s for row in rows], errors, "o-", ms=4, lw=1.0, label=method)
        ax.set(xlabel="CPU time (s)", ylabel=f"largest error of an event time {UNIT}", title=self.name)
        ax.legend()


def compare(scene: SceneLike, until: float | str, *, progress: Stages = silent) -> Comparison:
    """Compare methods of integration by the largest error of an event time and by CPU time: ``rig-sim compare``.

    The exact method, interpreted and compiled, steps through every cycle.  Compilation time is reported separately.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene of one mass: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also what `rig_sim.scene`
        returns.
    until : float or str
        End of the motion, which begins at 0, in the scene's unit of time or with a unit ('5 min').
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If the scene does not exist, has two masses or has no events, or ``until`` is not positive or too long.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.compare("base", until=20)
    >>> table = found.to_dataframe()
    >>> bool(table[table["method"] == "exact"]["error"].max() < 1e-13)
    True
    """
    loaded, end = load_scene(scene), parse_number(until, "time", "--until")
    compared = error_vs_time.compare(loaded, end, progress=lambda done: progress("measuring", done, 100.0))
    return Comparison(**vars(compared), name=loaded.name)
