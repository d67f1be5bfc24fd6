"""`fitting.rank` and `fitting.rank_each`: runs, files, motions or arrays become loaded runs for `fitting.job`."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import daq
from daq.runfile import schema
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from fitting import batch, job
from fitting.job import LoadedRun
from fitting.laws import ALL_LAWS, Bound, Competitors, Law
from fitting.options import Options
from fitting.result import Ranking
from processing.record.kinematics import Kinematics
from stickslip import units
from stickslip.errors import InputError, StickslipError
from stickslip.output import suffix
from stickslip.units import Stated

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike


Run = Recording | Kinematics | str | os.PathLike[str]
RUNS = (Recording, Kinematics, str, os.PathLike)


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
    """Runs that were each fitted separately: a list of `RankedRun` in the order of the runs."""

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the runs as a pandas table, one row a run.

        Columns: ``file``, ``verdict``, ``adequacy``, ``law`` and ``name`` of the best law, ``rms_m``, ``error``, and
        for each parameter of that law NAME, "NAME stderr", "NAME lo" and "NAME hi": missing where the law has no such
        parameter, the interval is withheld, or the run was not fitted.  ``attrs["units"]`` has the parameters' units.
        """
        import pandas as pd

        parts = [pd.DataFrame([{"file": str(run.file)}]) for run in self]
        units: dict[str, str] = {}
        for number, run in enumerate(self):
            if run.ranking is not None:
                answer = run.ranking.summary()
                units |= answer.attrs["units"]
                parts[number] = parts[number].join(answer)
            parts[number]["error"] = None if run.error is None else str(run.error)
        names = ["file", "verdict", "adequacy", "law", "name", "rms_m", "error"]
        frame = pd.concat(parts, ignore_index=True)
        frame = frame.reindex(columns=[*names, *(name for name in frame if name not in names)])
        frame.attrs["units"] = units
        return frame


def rank(
    run_or_time: "Run | Sequence[Run] | ArrayLike",
    position: "ArrayLike | None" = None,
    laws: int | str | Law | Sequence[int | str | Law] | Competitors = ALL_LAWS,
    *,
    mass: Stated | None = None,
    stiffness: Stated | None = None,
    x0: Stated | None = None,
    damping: Stated | None = None,
    belt_speed: Stated | None = None,
    rig: Rig | Sequence[Rig] | None = None,
    fix: Mapping[str, float | str] | None = None,
    bounds: Mapping[str, Bound] | None = None,
    start: Mapping[str, float | str] | None = None,
    begin: float | str | None = None,
    end: float | str | None = None,
    excluded: int | Sequence[int] = (),
    alpha: float = 0.05,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
) -> Ranking:
    """Fit friction laws to a record, or to several records of one contact together, and rank them.

    A quantity is a number in SI, ``(value, sd)``, or text with a unit: ``"500 g +- 1 g"``.  Values given here
    override the run's calibration.  The numbers are those that `fit-friction` prints; no file is written.

    Parameters
    ----------
    run_or_time : Recording, Kinematics, path, sequence of them, or array_like of shape (n,)
        A run; a smoothed motion (`processing.smooth`); a run file or a table that `daq.load` reads; or times, s, of
        the ``position``.  Several runs are fitted as one contact: they share k/m, Fs/m, the curve, the ramp and the
        damping; each has its own belt speed, rest position, wear and belt compliance.
    position : array_like of shape (n,), optional
        Positions, m, at the times.
    laws : int, str, Law, or sequence of them
        Which laws compete: of the six by number or range (``"1-6"``), published ones by name (``"stribeck"``), and
        custom laws (`fitting.Law`).
    mass, stiffness, damping : quantity, optional
        Moving mass, kg, or stiffness of the spring, N/m: one of the two; viscous damping, N s/m.
    x0 : quantity, optional
        Reading at the spring's rest, m.
    belt_speed : quantity or "channel", optional
        Speed of the belt, m/s, signed.  By default belt counts are used if the run contains them; "channel" requires
        them.
    rig : Rig or sequence of Rig, optional
        The whole calibration instead of the run's: one for all, or one for each run.
    fix, bounds, start : mapping, optional
        Fixed values, bounds as (low, high), and start values of parameters, by the names and in the units of the
        results, or as text with a unit: ``{"gamma": 9.6}``; of one law ``{"mine.v_s": "50 mm/s"}``.
    begin, end : time, optional
        The part of a run file to fit, s or text with a unit.
    excluded : int or sequence of int
        Numbers of cycles to leave out (1 is the first break-away); for a single run only.
    alpha : float
        1 - confidence of the intervals and of the set rule.
    jobs : int
        Processes to fit in: up to three are of use, one for each curve.  The result is the same to the last bit.
    progress : callable, optional
        Called with the number of laws done.
    scheduler : str, optional
        Address of a dask scheduler, ``tcp://host:8786``, whose workers fit instead of processes on this machine.

    Returns
    -------
    Ranking

    Raises
    ------
    InputError
        If the input is not a run; for unknown laws or parameters, or impossible values; a formula without the slip
        speed; a record in counts; a belt speed of zero; missing belt counts that were required; alpha outside (0, 1);
        fewer than one job; an unusable scheduler; a speed or excluded cycles with several runs.
    DataError
        If a record shows no stick-slip, a slip has fewer than eight samples, there are fewer than four complete cycles,
        only some of the runs stick, or frames were lost or doubled among even times.

    Notes
    -----
    A belt that slows under load looks like a ramp.  With belt counts its compliance is measured and part of the model;
    without them, a ramp narrow enough to be such a belt brings its jump law into the set.  A ripple of the belt speed
    at one frequency is detected in the sticks and fitted.

    Not modelled: a ripple of several frequencies, friction with memory, a mass or spring that changes between runs.

    Examples
    --------
    >>> import daq, fitting
    >>> run = daq.load("data_samples/law5.h5")
    >>> ranking = fitting.rank(run, laws=(5, 6), mass="300 g +- 1 g")
    >>> ranking.laws_in_set
    (5,)
    >>> fitting.rank(run.time, run.position, laws=5, fix={"gamma": 9.6}).best.parameters["gamma"]
    Parameter(value=9.6, stderr=0.0, lo=9.6, hi=9.6, unit='s/m', trusted=True, fixed=True)
    """
    if isinstance(position, Rig) or (isinstance(position, list | tuple) and _are(position, Rig)):
        rig, position = position, None
    options = _read_options(
        laws,
        fix,
        bounds,
        start,
        mass=mass,
        stiffness=stiffness,
        x0=x0,
        damping=damping,
        belt_speed=belt_speed,
        begin=begin,
        end=end,
        excluded=excluded,
        alpha=alpha,
        jobs=jobs,
        scheduler=scheduler,
    )
    given = _runs(run_or_time, position)
    runs = [_loaded(run, own, options) for run, own in zip(given, _rigs(rig, len(given)), strict=True)]
    return job.fit_runs(runs, options, progress)


def rank_each(
    runs: "Iterable[Run]",
    laws: int | str | Law | Sequence[int | str | Law] | Competitors = ALL_LAWS,
    *,
    rig: Rig | Sequence[Rig] | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
    **options: Any,
) -> RankedRuns:
    """Fit every run separately, and rank its laws: as `fit-friction --each`, without writing a file.

    If one run fails, the rest continue and its row has the error.

    Parameters
    ----------
    runs : iterable of paths, Recording or Kinematics
        As for `fitting.rank`, such as ``Path("monday").glob("*.h5")``.
    laws, rig, scheduler
        As for `fitting.rank`.
    jobs : int
        Processes to fit in, each one run at a time.
    progress : callable, optional
        Called with the number of runs done.
    **options
        Further keywords of `fitting.rank`, the same for every run: ``mass``, ``stiffness``, ``x0``, ``damping``,
        ``belt_speed``, ``fix``, ``bounds``, ``start``, ``begin``, ``end``, ``excluded`` and ``alpha``.

    Returns
    -------
    RankedRuns
        A list of `RankedRun` in the order of the runs; ``to_dataframe()`` has one row a run.

    Raises
    ------
    InputError
        If there is no run, or an item is not a run; for options that `fitting.rank` rejects for any run.
    DeviceError
        If all processes, or the scheduler, were lost before the first run was finished.

    Examples
    --------
    >>> import fitting
    >>> ranked = fitting.rank_each(["data_samples/law5.h5", "none.h5"], laws=(5, 6))
    >>> ranked[0].ranking.laws_in_set
    (5,)
    >>> print(ranked[1].error)
    none.h5: no such file; check the path
    >>> ranked.to_dataframe()[["law", "gamma", "error"]].round(3)
       law  gamma                                  error
    0  5.0  9.613                                   None
    1  NaN    NaN  none.h5: no such file; check the path
    """
    call = "fitting.rank_each"
    if isinstance(runs, RUNS):
        raise InputError("one run", call, "pass a list of runs, as in fitting.rank_each([run]), or call fitting.rank")
    given, read = list(runs), _read_options(laws, **options, jobs=jobs, scheduler=scheduler)
    if not given or not _are(given, RUNS):
        raise InputError(
            "no run" if not given else "some of the arguments are not runs", call, "pass files, recordings or motions"
        )
    rigs = _rigs(rig, len(given))
    files = [Path(run) if isinstance(run, str | os.PathLike) else _recording(run).source for run in given]

    loads = [partial(_loaded, run, own, read) for run, own in zip(given, rigs, strict=True)]
    ranked = RankedRuns()
    for file, outcome in zip(files, batch.fit_each(files, loads, read), strict=True):
        if isinstance(outcome, StickslipError):
            ranked.append(RankedRun(file, None, outcome))
        else:
            ranked.append(RankedRun(file, outcome[0], None))
        if progress is not None:
            progress(float(len(ranked)))
    return ranked


def _read_options(
    laws: int | str | Law | Sequence[int | str | Law] | Competitors,
    fix: Mapping[str, float | str] | None = None,
    bounds: Mapping[str, Bound] | None = None,
    start: Mapping[str, float | str] | None = None,
    **values: Any,
) -> Options:
    competitors = laws if isinstance(laws, Competitors) else Competitors.of(laws, fix, bounds, start)
    return Options(competitors, **{name: _read_option(value, name) for name, value in values.items()})


def _read_option(value: Any, name: str) -> Any:
    if name in ("begin", "end"):
        return units.exact_in_si(value, "time", name)
    if name in ("mass", "stiffness", "x0", "damping") or (name == "belt_speed" and value != "channel"):
        return units.read_stated(value, name)
    if name == "excluded":
        return (value,) if isinstance(value, int) else tuple(value)
    return value


def _rigs(rig: Rig | Sequence[Rig] | None, count: int) -> Sequence[Rig | None]:
    """Return the calibration of each run; None for the run's own."""
    rigs = [rig] * count if rig is None or isinstance(rig, Rig) else list(rig)
    if len(rigs) != count:
        raise InputError(f"{len(rigs)} rigs for {count} runs", "rig", "pass one rig for all runs, or one for each run")
    return rigs


def _runs(run_or_time: Any, position: Any) -> list[Run]:
    call = "fitting.rank"
    if isinstance(run_or_time, RUNS):
        if position is not None:
            raise InputError("a position was passed in addition to a run", call, "pass only the run")
        return [run_or_time]
    if position is not None:
        return [Recording.from_arrays(run_or_time, position)]
    if isinstance(run_or_time, Ranking):
        raise InputError("a ranking has already been fitted", call, "pass a run: fitting.rank(daq.load(path))")
    if isinstance(run_or_time, list | tuple) and _are(run_or_time, RUNS):
        if not run_or_time:
            raise InputError("no run", call, "pass at least one")
        return list(run_or_time)
    do = "pass a run, a file, a smoothed motion, or two arrays: fitting.rank(time, position)"
    raise InputError(f"{type(run_or_time).__name__} is not a run, and no position was passed", call, do)


def _are(values: Sequence[Any], kind: Any) -> bool:
    return all(isinstance(one, kind) for one in values)


def _loaded(run: Run, rig: Rig | None, options: Options) -> LoadedRun:
    """Return a run with its calibration; a run file is read as by the command, smoothed where it has that stage."""
    if isinstance(run, str | os.PathLike) and Path(run).suffix.lower() in suffix.RUN.suffixes:
        return job.load_run(Path(run), options, rig)
    if options.begin is not None or options.end is not None:
        do = "pass the file, as in fitting.rank('run.h5', begin=5), or slice the arrays"
        raise InputError("begin and end require a run file", "fitting.rank", do)
    motion = run if isinstance(run, Kinematics) else None
    if isinstance(run, str | os.PathLike):
        run = daq.load(run)
    recording = _recording(run)
    if not recording.digest:  # by which a report knows its runs
        recording = replace(recording, digest=schema.compute_digest(recording))
        motion = None if motion is None else replace(motion, recording=recording)
    ends = float(recording.time[0]), float(recording.time[-1])
    return LoadedRun(recording, motion, options.calibrate(recording.rig if rig is None else rig), "", ends)


def _recording(run: Recording | Kinematics) -> Recording:
    return run if isinstance(run, Recording) else run.recording
