"""What a recording found: the numbers behind ``daq record``'s answer, and the warnings that follow from them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Summary:
    """The findings of one recording.

    Attributes
    ----------
    file : Path or None
        The run file.
    samples, lost : int
        Samples in the file; samples missing between them (gaps of a lost port are not counted, they are timed).
    crc_errors, illegal, phase_errors, both_moved, dropped_bytes : int
        Damaged frames; illegal double transitions the board counted; samples whose count disagrees with its levels;
        samples in which both counters moved; bytes the recorder could not keep.
    segments : int
        1 for an uninterrupted run.
    rate_hz, measured_rate_hz : float
        Commanded, and by the device's clock.
    clock_ppm : float or None
        Drift of the device's clock against the host's, positive when fast; None where it cannot be known.
    duration_s : float
        From the first sample to one period after the last.
    peak_edge_rate_hz : float
        Fastest edge rate between two neighbouring samples.
    travel : tuple of float
        Least and largest position.
    unit : str
        "m", or "count" for a rig that was not calibrated.
    warnings : tuple of str
        What a careful user should know about the data.
    clock_ppm_error : float or None
        How far off the drift may be, ppm.
    port_lost : int
        How often the port was lost: what was missed then is no lost sample, and a warning tells how long it was.
    """

    samples: int
    lost: int
    crc_errors: int
    illegal: int
    phase_errors: int
    both_moved: int
    dropped_bytes: int
    segments: int
    rate_hz: float
    measured_rate_hz: float
    clock_ppm: float | None
    duration_s: float
    peak_edge_rate_hz: float
    travel: tuple[float, float]
    unit: str
    warnings: tuple[str, ...]
    file: Path | None = None
    port_lost: int = 0
    clock_ppm_error: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON document of ``daq record`` and ``daq recover``."""
        return {
            "samples": self.samples,
            "lost": self.lost,
            "crc_errors": self.crc_errors,
            "illegal": self.illegal,
            "phase_errors": self.phase_errors,
            "segments": self.segments,
            "rate_hz": self.rate_hz,
            "measured_rate_hz": self.measured_rate_hz,
            "clock_ppm": self.clock_ppm,
            "clock_ppm_error": self.clock_ppm_error,
            "duration_s": self.duration_s,
            "peak_edge_rate_hz": self.peak_edge_rate_hz,
            "both_moved": self.both_moved,
            "dropped_bytes": self.dropped_bytes,
            "file": self.file,
            "warnings": list(self.warnings),
        }

    def as_text(self, done: str, next_command: str) -> str:
        """Return the few lines a person reads, the command to type next at their end."""
        size = "mm" if self.unit == "m" else "counts"
        scale = 1e3 if self.unit == "m" else 1.0
        low, high = (scale * edge for edge in self.travel)
        lost = f"{self.lost} samples lost" if self.lost else "no sample lost"
        lost += " while the port was there" if self.port_lost else ""
        clock = "" if self.clock_ppm is None else f"; the board's clock is off by {self.clock_ppm:+.0f} ppm"
        if clock and self.clock_ppm_error is not None:
            clock += f" (+- {self.clock_ppm_error:.0f})"
        lines = [
            f"{done} {self.samples} samples in {self.duration_s:.1f} s at {self.rate_hz:g} Hz, {lost}{clock}",
            f"the mass moved between {low:.4g} and {high:.4g} {size}, at most {self.peak_edge_rate_hz:.0f} edges/s",
            *(f"warning: {warning}" for warning in self.warnings),
            f"-> {self.file}",
            f"next: {next_command}",
        ]
        return "\n".join(lines)
