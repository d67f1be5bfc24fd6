"""What the commands of daq print for people, and the keys of JSON that several of them share."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stickslip.output.lengths import shown_range

if TYPE_CHECKING:
    from daq.calibration.ring_down import RingDown
    from daq.finalise.quality import RecordingQuality
    from daq.imports.capture import Totals
    from daq.imports.table_to_run import Imported
    from daq.runfile.recording import Recording
    from daq.runfile.rig import Rig

UNITS = {"metres_per_count": "m", "stiffness": "N/m", "damping": "N s/m", "datum": "m", "mass": "kg"}


# What a table is that is no text of delimiters, by `daq.imports.table.Table.kind`.
KINDS = {
    "MATLAB": "vectors of a MATLAB file",
    "TDMS": "channels of a TDMS file",
    "LabVIEW": "a LabVIEW measurement",
    "workbook": "a sheet of a workbook",
}


def format_warnings(texts: Sequence[str]) -> list[str]:
    return [f"warning: {warning}" for warning in texts]


def describe_run(run: "Recording", target: Path, warned: Sequence[str]) -> dict[str, Any]:
    """Return the JSON of a run that was written, with the ``warned`` sentences as its warnings."""
    return {
        "samples": int(run.time.size),
        "segments": len(set(run.segment.tolist())),
        "rate_hz": run.rate_hz,
        "duration_s": float(run.time[-1] - run.time[0]) + 1 / run.rate_hz,  # to one period after the last sample
        "file": target,
        "warnings": list(warned),
    }


def format_run(done: str, run: "Recording", data: dict[str, Any], *lines: str) -> str:
    printed = [
        f"{done} {data['samples']} samples in {data['duration_s']:.4g} s at {run.rate_hz:.6g} Hz",
        *lines,
        format_travel(float(run.position.min()), float(run.position.max()), run.unit),
        *format_warnings(data["warnings"]),
        *format_written(data["file"]),
    ]
    return "\n".join(printed)


def format_travel(low: float, high: float, unit: str) -> str:
    """Return the line about the range of positions, in m or counts."""
    return f"the mass moved from {shown_range(low, high, unit)}"


def format_written(file: Path | None) -> list[str]:
    """Return the last two lines: the run file, and the command to type next."""
    return [f"-> {file}", f"next: fit-friction {shlex.quote(str(file))}"]


def format_recording(done: str, quality: "RecordingQuality") -> str:
    lost = f"{quality.lost} samples lost" if quality.lost else "no sample lost"
    lost += " while the port was open" if quality.port_lost else ""
    clock = quality.clock_drift
    lines = [
        f"{done} {quality.samples} samples in {quality.duration_s:.1f} s at {quality.rate_hz:g} Hz, {lost}"
        + (f"; {clock}" if clock else ""),
        f"{format_travel(*quality.travel, quality.unit)}, at most {quality.peak_edge_rate_hz:.0f} edges/s",
        *format_warnings(quality.warnings),
        *format_written(quality.file),
    ]
    return "\n".join(lines)


def format_columns(imported: "Imported") -> str:
    form = KINDS.get(imported.delimiter, f"delimiter {imported.delimiter}, decimal {imported.decimal!r}")
    line = f"read as: {form}, time from {imported.columns['time']}"
    line += f", position from {imported.columns['position']}"
    line += f", belt from {imported.columns['belt']}" if "belt" in imported.columns else ""
    line += "" if imported.even else "; unevenly sampled"
    if imported.assumed:
        line += f"\nno units found; assuming {' and in '.join(imported.assumed)}"
    return line


def format_counts(totals: "Totals") -> str:
    return ", ".join(f"{key} {value}" for key, value in vars(totals).items())


def warn_of_counts(totals: "Totals") -> list[str]:
    if totals.illegal:
        return [
            f"{totals.illegal} illegal transitions, in which A and B changed at once; the count is uncertain by "
            "this number"
        ]
    return [] if totals.edges else ["no edges were found; check that these are the right probes"]


def comment_on_ring_down(ring: "RingDown | None") -> str:
    """Return the first line of a rig.toml."""
    if ring is None:
        return ""
    line = f"omega0 = {ring.omega0.value:.8g} +- {ring.omega0.sd:.2g} rad/s"
    line += f", damping ratio {ring.zeta.value:.4g} +- {ring.zeta.sd:.2g}, friction {ring.friction.value:.4g} counts"
    return f"# ring-down of {ring.swings} half-swings: {line}\n"


def comment_on_left_out(names: Sequence[str]) -> str:
    """Return the lines of a rig.toml about constants that a calibration leaves out."""
    return "".join(
        f"# {name} is omitted because the belt did not move (0 m/s); set it to the speed of the runs\n"
        for name in names
    )


def format_calibration(
    rig: "Rig", ring: "RingDown | None", left_out: Sequence[str], warned: Sequence[str], output: Path
) -> str:
    lines = []
    if ring is not None:
        lines.append(f"omega0 {ring.omega0.value:.6g} +- {ring.omega0.sd:.2g} rad/s, from {ring.swings} half-swings")
        lines.append(f"damping ratio {ring.zeta.value:.4g} +- {ring.zeta.sd:.2g}, in addition to friction")
    values = {key: getattr(rig, key) for key in UNITS}
    lines += [f"{key} {v.value:.6g} +- {v.sd:.2g} {UNITS[key]}" for key, v in values.items() if v is not None]
    lines += comment_on_left_out(left_out).removeprefix("# ").splitlines()
    return "\n".join([*lines, *format_warnings(warned), f"-> {output}", f"next: daq record --rig {output}"])
