"""What a run is to its user: read from a file, made of arrays, looked at and written."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from daq.runfile.run_data import OF_FILE, RunData, count_lost
from stickslip.output.lengths import shown_length, shown_range
from stickslip.text import storable

if TYPE_CHECKING:
    import os

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from stickslip.units import Stated


@dataclass(frozen=True)
class Recording(RunData):
    """A run: times and positions, the samples as sent, and what is known of the rig.

    `daq.load` reads one from a file, `from_arrays` makes one of arrays, `save` writes one.

    Attributes
    ----------
    title : str
    started, ended : str
        Time of the first and of the last sample, ISO 8601 with zone.
    rate_hz : float
        Nominal sample rate.
    rig : Rig
        Calibration.
    time : (n,) f8
        Seconds since the first sample by the device's clock, increasing.
    position : (n,) f8
        Metres from the spring's rest position, positive towards +x; counts when `unit` is "count".
    count : (n,) i8 or None
        Unwrapped count; None for an import.
    raw : Raw or None
        The samples as sent; None for an import.
    segment : (n,) u2, or u4 where there may be more than 65,536
        A new one after every unplug and restart of the board; not given: 0 throughout.
    config_toml : str
        The configuration the run was made with, verbatim.
    clock_sample, clock_offset : (c,) u4, (c,) f8
        Host clock minus device clock, s, at these indices.
    clock_ppm : float or None
        Drift of the device's clock, positive when fast; None where it could not be known.
    clock_ppm_error, clock_offset_error : float or None, (c,) f8
        Standard deviations of the drift (ppm) and of each offset (s); None, or empty, where they are not known.
    event_sample, event_kind, event_note
        Index into the run, (e,) u4; name of the kind (a key of `EVENTS`); words where there are any.
    belt_velocity : (n,) f8 or None
        m/s, signed, only with a belt channel: differences of its counts (`daq.runfile.belt_counter`), not smoothed.
    belt_count : (n,) i8 or None
        Unwrapped count of the belt's encoder, only with a belt channel; metres of it are in `rig`.
    truth : Truth or None
        The exact motion, on the way into a file only: `store.load` leaves it out, so that nobody reads it by accident
        (`store.truth` reads it).
    sent_as : SentAs or None
        The identifications that the samples were sent under; None where there was one.
    operator, sample_name, note : str
        Who recorded, what was measured, remarks; "" where nobody wrote any.
    tags : mapping of str to str
        Named values that a person gave the run.
    provenance : mapping
        Software, versions, command line.
    source, default, digest
        Of a run that was loaded: its file; its last stage, "data", "smooth" or "fit"; the sha256 of its raw data (of
        time and position for an import).
    """

    @classmethod
    def from_arrays(
        cls,
        time: "ArrayLike",
        position: "ArrayLike",
        *,
        mass: "Stated | None" = None,
        stiffness: "Stated | None" = None,
        belt_speed: "Stated | None" = None,
        x0: "Stated | None" = None,
        damping: "Stated | None" = None,
        metres_per_count: "Stated | None" = None,
        belt_position: "ArrayLike | None" = None,
        title: str = "",
    ) -> "Recording":
        """Make a run of arrays.

        A quantity is a number in SI, ``(value, sd)``, or text with a unit: ``"5 cm/s"``, ``"500 g +- 1 g"``.  What is
        not known is left out.

        Parameters
        ----------
        time : array_like of shape (n,)
            Times of the samples, s, increasing; they need not be even.  Those of the run begin with 0.
        position : array_like of shape (n,)
            Positions, m, positive towards +x.  Integers are counts: in metres with ``metres_per_count``, else the run
            is in counts.
        mass, stiffness, damping : quantity, optional
            Moving mass, kg; stiffness of the spring, N/m; viscous damping, N s/m.
        belt_speed : quantity, optional
            Speed of the belt, m/s, positive towards +x.
        x0 : quantity, optional
            Reading at the spring's rest, m, with the sign of the positions.
        metres_per_count : quantity, optional
            Travel in a count, m; negative where counting up means towards -x.
        belt_position : array_like of shape (n,), optional
            Positions of the belt at the same times, m, positive towards +x, where they were measured.
        title : str
            Title of the run.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            For arrays that are no columns of numbers of one length, a value that is not finite, times that do not
            increase (naming the sample), and a quantity that cannot be.

        Examples
        --------
        >>> import numpy as np
        >>> import daq
        >>> t = np.arange(2000) / 1000
        >>> run = daq.Recording.from_arrays(t, 0.01 * np.sin(6 * t), mass="500 g +- 1 g", x0=(0, 1e-4))
        >>> run
        <Recording a run in memory: 'arrays'
         2000 samples, 1.999 s at 1000 Hz>
        >>> run.rig.mass
        Measured(value=0.5, sd=0.001)
        """
        from daq.runfile.in_memory import from_arrays

        stated = {
            "mass": mass,
            "stiffness": stiffness,
            "belt_speed": belt_speed,
            "x0": x0,
            "damping": damping,
            "metres_per_count": metres_per_count,
        }
        return from_arrays(cls, time, position, stated, belt_position, title)

    def save(self, path: "str | os.PathLike[str]", *, force: bool = False) -> Path:
        """Write the run into a run file (.h5), which `daq.load` and every command read.

        Parameters
        ----------
        path : path
            The file.
        force : bool
            Replace an existing file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            The file exists and ``force`` is not given, its folder does not exist, or its name has the suffix of
            another format.
        """
        from daq.runfile.write import write
        from stickslip.output import suffix

        target = Path(path)
        suffix.check_run(target)
        write(target, self, force=force)
        return target

    @property
    def name(self) -> str:
        """Name of its file; "a run in memory" when it was not loaded from one."""
        return storable(self.source.name) or "a run in memory"

    @property
    def where(self) -> str:
        """Its file for an error: the path, or the `name` of a run in memory."""
        return str(self.source) if self.source.name else self.name

    @property
    def when(self) -> str:
        """Time of the first sample, ISO 8601; "file of ..." where it is that at which an imported file was changed."""
        return ("file of " if self.provenance.get("start_time_from") == OF_FILE else "") + self.started

    def remarks(self) -> dict[str, str]:
        """Return what people wrote about the run, by name: operator, sample, note, then the tags."""
        written = {"operator": self.operator, "sample": self.sample_name, "note": self.note} | dict(self.tags)
        return {name: text for name, text in written.items() if text}

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the run as a pandas table, one row a sample.

        Columns: ``time_s``, ``position_m`` (``position_count`` for a rig without metres per count), then what the run
        has of ``count``, ``segment``, ``belt_velocity_m_per_s`` and the raw columns as sent.
        """
        import pandas as pd

        columns: dict[str, NDArray[np.generic]] = {"time_s": self.time, f"position_{self.unit}": self.position}
        if self.count is not None:
            columns["count"] = self.count
        if self.raw is not None:
            columns["segment"] = self.segment
        if self.belt_velocity is not None:
            columns["belt_velocity_m_per_s"] = self.belt_velocity
        if self.raw is not None:
            units = {"device_time": "device_time_us", "edge_time": "edge_time_us"}
            for name, values in vars(self.raw).items():
                if values is not None:
                    columns[units.get(name, name)] = values
        return pd.DataFrame(columns)

    @property
    def markers(self) -> tuple[tuple[float, str], ...]:
        """The markers that a person set: time, s, and words."""
        return self.list_markers(self.time)

    def list_markers(self, time: NDArray[np.float64]) -> tuple[tuple[float, str], ...]:
        """Return `markers` by the times of all samples, of a run of which some were loaded."""
        events = zip(self.event_sample, self.event_kind, self.event_note, strict=True)
        marks = ((int(sample), words) for sample, kind, words in events if kind == "marker")
        return tuple((float(time[sample]), words) for sample, words in marks if sample < time.size)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw position against time, with the markers that a person set.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; by default a new figure.

        Returns
        -------
        matplotlib Figure
            ``figure.savefig(path)`` writes it, a notebook shows it.
        """
        from stickslip.compute.arrays import pieces
        from stickslip.output.plot import draw_over_time

        factor, unit = shown_length(self.unit)
        parts = pieces(self.time, self.segment, 1 / self.rate_hz) if self.time.size > 1 else (slice(None),)
        return draw_over_time(
            [(self.time[part], factor * self.position[part]) for part in parts],
            f"position ({unit})",
            self.markers,
            f"{self.name}: {self.title}",
            ax,
        )

    def facts(self) -> dict[str, str]:
        """Return what a person wants to see first, in words, by name; notes included."""
        span = float(self.time[-1] - self.time[0]) if self.time.size else 0.0
        segments = len(set(self.segment.tolist()))
        facts = {
            "samples": str(self.time.size),
            "duration": f"{span:.4g} s",
            "rate": f"{self.rate_hz:g} Hz",
            "segments": str(segments) if segments > 1 else "",
            "samples lost": "" if self.raw is None else str(count_lost(self.raw.sample, self.segment)),
            "position": shown_range(self.position.min(), self.position.max(), self.unit) if self.time.size else "",
            "belt": "with its own encoder" if self.belt_velocity is not None else "",
            "events": ", ".join(f"{self.event_kind.count(kind)} {kind}" for kind in sorted(set(self.event_kind))),
            "started": self.when,
        }
        return {name: text for name, text in facts.items() if text} | self.remarks()

    def __repr__(self) -> str:
        facts = self.facts()
        lost = f", {facts['samples lost']} samples lost" if facts.get("samples lost", "0") != "0" else ""
        return (
            f"<Recording {self.name}: {self.title!r}\n"
            f" {facts['samples']} samples, {facts['duration']} at {facts['rate']}{lost}>"
        )

    def _repr_html_(self) -> str:
        from stickslip.output import notebook

        return notebook.table(f"Recording {self.name}: {self.title}", self.facts().items())
