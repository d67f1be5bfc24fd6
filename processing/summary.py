"""The summary of a smoothed run, as JSON and as sentences."""

import logging
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.record.kinematics import Kinematics, SmoothingSummary
from stickslip.output.lengths import shown_range, shown_speed

logger = logging.getLogger(__name__)
METHOD_NAMES = {
    "segment": "sticks and slips smoothed separately; transition times fitted",
    "rts": "fixed-interval smoother with maximum-likelihood noise levels",
    "sg": "Savitzky-Golay",
    "fd": "finite differences",
}
TIMES = {"recorded": "recorded time stamps used", "nominal": "even time stamps used"}
HEADER = (
    "method",
    "window",
    "order",
    "times",
    "belt_speed",
    "plateau_fraction",
    "lost_counts",
    "repaired",
    "noise",
    "cpu_s",
)


def as_json(motion: SmoothingSummary) -> dict[str, Any]:
    """Return what `process smooth --json` prints; the keys are fixed."""
    return {name: getattr(motion, name) for name in HEADER} | {
        "sticks": len(motion.sticks),
        "slips": len(motion.slips),
        "belt_channel": motion.belt_counted,
        "losses": [vars(loss) for loss in motion.losses],
        "kicks": [vars(step) for step in motion.kicks],
        "phases": [
            {name: getattr(phase, name) for name in ("kind", "start", "start_sd", "end", "end_sd")}
            for phase in motion.phases
        ],
        "samples": motion.samples,
        "findings": [vars(finding) for finding in motion.findings],
        "warnings": list_warnings(motion),
    }


def run_as_json(motion: Kinematics) -> dict[str, Any]:
    """Return the JSON of `process inspect`: the run and its motion."""
    recording = motion.recording
    return as_json(motion) | {
        "title": recording.title,
        "started": recording.started,
        "remarks": recording.remarks(),
        "duration_s": motion.span,
        "rate_hz": recording.rate_hz,
        "segments": len(set(recording.segment.tolist())),
        "unit": recording.unit,
        "position_range": [float(motion.position.min()), float(motion.position.max())],
        "velocity_range": [float(motion.velocity.min()), float(motion.velocity.max())],
        "model": _to_lists(motion.model),
        "events": {kind: recording.event_kind.count(kind) for kind in sorted(set(recording.event_kind))},
    }


def list_warnings(motion: SmoothingSummary) -> list[str]:
    """Return what a person should know before using the motion."""
    messages = []
    if motion.lost_counts:
        messages.append(
            f"counts went missing {_count(motion.lost_counts, 'time')} "
            f"({'restored' if motion.repaired else 'marked, not corrected'}); check for a bouncing encoder "
            "wheel or a slipping coupling"
        )
    if motion.kicks:
        messages.append(
            f"the velocity jumps {_count(len(motion.kicks), 'time')}, perhaps at a belt joint (first by "
            f"{motion.kicks[0].step:.2g} {shown_speed(motion.unit)}); marked"
        )
    if motion.phases and not motion.sticks and math.isfinite(motion.plateau_speed):
        messages.append(
            f"the mass never sticks at the stated belt speed of {motion.belt_speed:g}, but it sticks at "
            f"{motion.plateau_speed:.5g}; check --belt-speed and its sign, or use 'auto'"
        )
    if not motion.phases:
        messages.append("the mass never moves in this record")
    return messages + [finding.text for finding in motion.findings]


def format_sentences(motion: SmoothingSummary, *, chosen: bool = False) -> list[str]:
    """Return how the motion was computed and its findings; ``chosen``: the window was chosen automatically."""
    method_text = METHOD_NAMES[motion.method]
    if motion.method == "sg":
        span = 1e3 * (motion.window - 1) * motion.span / max(motion.samples - 1, 1)
        method_text += f", window {motion.window} samples ({span:.3g} ms), order {motion.order}"
        method_text += ", chosen from the record" if chosen else ""
    known = math.isfinite(motion.belt_speed)
    belt = f"belt speed {motion.belt_speed:.5g} {shown_speed(motion.unit)}" if known else "belt speed unknown"
    belt += " (from its own encoder)" if motion.belt_counted else ""
    lines = [
        f"{method_text}; {TIMES[motion.times]}",
        f"{_count(len(motion.sticks), 'stick')} and {_count(len(motion.slips), 'slip')}; {belt}; "
        f"the mass sticks for {100 * motion.plateau_fraction:.0f} % of the record",
    ]
    if motion.method == "segment" and motion.sticks:
        landing = _median_error([stick.start_sd for stick in motion.sticks])
        leaving = _median_error([stick.end_sd for stick in motion.sticks])
        lines.append(f"standard errors of transition times: {landing} (landings), {leaving} (break-aways)")
    lines.append(f"{motion.samples} samples in {motion.cpu_s:.2f} s of CPU time")
    return lines + [f"warning: {warning}" for warning in list_warnings(motion)]


def format_run_sentences(motion: Kinematics, file: Path) -> list[str]:
    """Return the run, its motion and its findings; the parameters of the method go to the log (--verbose)."""
    for name, numbers in _list_groups(motion.model):
        logger.info("model%s: %s", name, numbers)
    data = run_as_json(motion)
    unit = data["unit"]
    events = ", ".join(f"{count} × {kind}" for kind, count in data["events"].items()) or "none"
    segments = f" in {data['segments']} segments" if data["segments"] > 1 else ""
    (low, high), (slow, fast) = data["position_range"], data["velocity_range"]
    return [
        f"{file}: {data['title']}, {data['started']}",
        *(f"{name}: {text}" for name, text in motion.recording.remarks().items()),
        f"{data['samples']} samples at {data['rate_hz']:g} Hz, {data['duration_s']:.4g} s{segments}; events: {events}",
        f"position {shown_range(low, high, unit)}, velocity {slow:.4g} to {fast:.4g} {shown_speed(unit)}",
        *format_sentences(motion),
    ]


def _to_lists(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return a model as lists and plain numbers."""
    plain = {
        name: _to_lists(value) if isinstance(value, Mapping) else np.asarray(value) for name, value in model.items()
    }
    return {name: value if isinstance(value, dict) else value.tolist() for name, value in plain.items()}


def _list_groups(model: Mapping[str, Any], name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name of each part of a model and its numbers as text, without arrays by label of the motion."""
    plain_values = {key: np.asarray(value) for key, value in model.items() if not isinstance(value, Mapping)}
    numbers = [f"{key} {_format_numbers(value)}" for key, value in plain_values.items() if value.size <= 2]
    if numbers:
        yield name, ", ".join(numbers)
    for key, value in model.items():
        if isinstance(value, Mapping):
            yield from _list_groups(value, f"{name} {key}")


def _format_numbers(value: "NDArray[Any]") -> str:
    return " to ".join(
        f"{number:.4g}" if isinstance(number, float) else str(number) for number in np.atleast_1d(value).tolist()
    )


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' if number != 1 else ''}"


def _median_error(errors: list[float]) -> str:
    finite = sorted(error for error in errors if error < math.inf)
    return f"{1e3 * finite[len(finite) // 2]:.2g} ms" if finite else "unknown"
