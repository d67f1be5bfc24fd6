"""`daq check` and `daq calibrate`: test a board, and measure its rig, before the first run."""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.cli import sentences
from daq.cli.record import rig_port
from daq.cli.settings import NO_FLAGS, BoardFlags, format_board, resolve
from daq.runfile.rig import Rig
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json
from stickslip.console.flags import Force
from stickslip.console.rig_flags import Mass
from stickslip.errors import EXIT_DATA, EXIT_DONE, DataError, InputError
from stickslip.units import QUANTITIES, Measured

if TYPE_CHECKING:
    from daq.calibration.ring_down import RingDown
    from daq.finalise.quality import RecordingQuality
    from daq.protocols.request import RecordRequest
    from daq.runfile.recording import Recording

PARKED_S, MOVED_S = 5.0, 5.0
SIMULATED_PARKED_S, SIMULATED_MOVED_S = 0.4, 2.0  # the belt of the scene `rig` starts after 0.5 s
RING_DOWN_S, DISTANCE_S = 20.0, 10.0
DISTANCE = "Known distance by which the mass is moved towards +x, such as '100 mm +- 0.1 mm'; negative towards -x."
# The simulated rig in a ring-down: belt at rest, mass nearly lifted off it, with an initial velocity at its mark.
STRUCK = ("belt.speed=0.0", "friction.Fs=0.05", "start.v=0.6")

Yes = Annotated[bool, Parameter(name=["--yes", "-y"], negative=(), help="Start without waiting for Enter.")]


def check(
    *,
    parked: Annotated[
        float | None, flags.quantity("--parked", "time", "Duration of the test at rest; default 5 s.")
    ] = None,
    move: Annotated[
        float | None,
        flags.quantity("--move", "time", "Duration of the test in which you move the mass towards +x; default 5 s."),
    ] = None,
    board: BoardFlags = NO_FLAGS,
    yes: Yes = False,
    json: Json = False,
) -> Answer:
    """Test a board: rate, losses, clock and drift with the mass at rest, then the direction of counting.

    The exit code is 4 if a check fails.  The simulated rig is tested for 0.4 s at rest and 2 s in motion.

    Example: daq check --port /dev/ttyACM0
    """
    from daq.calibration import board_test
    from daq.protocols.request import RecordRequest

    request = RecordRequest(**resolve(board))
    simulated = request.port.startswith("rig://")
    parked_s = parked if parked is not None else SIMULATED_PARKED_S if simulated else PARKED_S
    move_s = move if move is not None else SIMULATED_MOVED_S if simulated else MOVED_S
    for flag, value in (("--parked", parked_s), ("--move", move_s)):
        if not 0 <= value < float("inf"):
            raise InputError(f"{value:g} s", flag, "use 0 s or more")
    if parked_s + move_s == 0:
        raise InputError("there is nothing to check", "--parked and --move", "set one of them above 0 s")
    request = replace(request, duration_s=parked_s + move_s)
    _check_reachable(request)
    announced = False

    def progress(seconds: float) -> None:
        nonlocal announced
        if move_s and not announced and seconds >= parked_s:
            application.note(f"now move the mass by hand towards +x, within {move_s:g} s")
            announced = True

    if parked_s:
        _ask_to_act(f"do not touch the mass for {parked_s:g} s", not (yes or json or simulated))
    summary, run = _record_once(request, progress)
    checks = board_test.check_board(summary, run, parked_s)
    ok = all(finding.ok is not False for finding in checks)
    still = board_test.count_span(run, 0.0, parked_s)
    moved = board_test.count_span(run, parked_s, float("inf"))
    data: dict[str, Any] = {key: value for key, value in summary.as_json().items() if key != "file"}
    data |= {
        "ok": ok,
        "port": request.port,
        "decoder": run.rig.decoder,
        "parked": vars(still),
        "parked_drift": still.counts,
        "move": vars(moved),
        "hand_move": moved.counts,
        "checks": [vars(finding) for finding in checks],
    }
    marks = {True: "OK", False: "FAIL", None: "--"}
    lines = [f"{marks[finding.ok]:<4} {finding.name}: {finding.seen}" for finding in checks]
    lines += [f"     do: {finding.do}" for finding in checks if finding.ok is not True and finding.do]
    lines += sentences.format_warnings(summary.warnings)
    lines.append("next: daq calibrate" if ok else "see the lines marked FAIL")
    return Answer(data, "\n".join(lines), EXIT_DONE if ok else EXIT_DATA)


def calibrate(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File to write.")] = Path("rig.toml"),
    distance: Annotated[Measured | None, flags.measured("--distance", "length", DISTANCE)] = None,
    ring_down: Annotated[bool, Parameter(name="--ring-down", help="Record and fit a ring-down.")] = True,
    mass: Mass = None,
    duration: Annotated[
        float, flags.quantity("--duration", "time", "Duration of the ring-down, in s or with a unit.")
    ] = RING_DOWN_S,
    move: Annotated[
        float, flags.quantity("--move", "time", "Time in which the mass is moved by the distance, in s or with a unit.")
    ] = DISTANCE_S,
    board: BoardFlags = NO_FLAGS,
    yes: Yes = False,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Calibrate a rig: metres per count from a known distance; datum, omega0 and damping from a ring-down.

    Place the mass at the mark from which every recording will start.  The belt must be at rest.  Values from --rig or
    from the board are kept unless they are measured again.  Without a port, the simulated rig is used.  Its mass is
    nearly lifted off the belt, receives an initial velocity and rings down.  It does not need --distance, because its
    board sends the metres per count.

    Example: daq calibrate --port /dev/ttyACM0 --distance "100 mm +- 0.1 mm" --mass "300 g +- 1 g"

    Example: daq calibrate --mass "300 g +- 1 g"
    """
    from daq.calibration import rig_constants as measure
    from daq.protocols.request import RecordRequest
    from stickslip.output import atomic, suffix

    if not ring_down and distance is None:
        raise InputError("there is nothing to measure", "command line", "add --distance, or omit --no-ring-down")
    settings = resolve(board)
    request = RecordRequest(**settings)
    suffix.check(output, suffix.TOML)
    atomic.refuse_existing(output, force)
    if distance is not None and distance.value == 0:
        raise InputError("the distance is zero", "--distance", "use, for example, '100 mm'")
    if "port" not in settings:
        if distance is not None:
            what = "the simulated rig cannot be moved by hand, so --distance does not apply"
            raise InputError(what, "--distance", "add the --port of a board, or omit --distance")
        request = replace(request, port=rig_port(None, list(STRUCK), realtime=False))
    for flag, seconds, needed in (("--move", move, distance is not None), ("--duration", duration, ring_down)):
        if needed and not 0 < seconds < float("inf"):
            raise InputError(f"{seconds:g} s", flag, "use more than 0 s")
    _check_reachable(replace(request, duration_s=duration if ring_down else move))
    wait = not (yes or json or request.port.startswith("rig://"))
    pitch = ring = None
    recording = None
    warnings: list[str] = []
    if distance is not None:
        far = f"{1e3 * distance.value:g} mm"
        _ask_to_act(f"let the mass rest; move it by {far} within {move:g} s, and let it rest again", wait)
        summary, recording = _record_once(replace(request, duration_s=move))
        pitch = measure.measure_pitch(recording, distance)
        warnings += summary.warnings
        if not measure.stands_at_first(recording):
            warnings.append("the mass moved from the first sample on: the distance was counted from there")
    if ring_down:
        _ask_to_act(f"displace the mass, release it, and do not touch it for {duration:g} s", wait)
        summary, recording = _record_once(replace(request, duration_s=duration))
        ring = measure.fit_ring_down(recording)
        warnings += summary.warnings
        if ring.poor:
            raise DataError(
                "the motion is not that of a mass on a spring with friction; it leaves residuals of "
                f"{ring.rms:.3g} counts (rms) of {ring.amplitude:.4g}",
                "ring-down",
                "stop the belt, displace the mass, release it and do not touch it, or use --no-ring-down",
            )
    if recording is None:
        raise ValueError("neither measurement was made")
    rig = measure.calibrate_rig(recording.rig, pitch, ring, mass)
    if ring is not None and rig.mass is None:
        warnings.append(
            "without --mass, only omega0 and the damping ratio are determined, not the stiffness and the damping"
        )
    if rig.metres_per_count is None:
        warnings.append("without --distance, lengths are in counts")
    warnings = [w for w in dict.fromkeys(warnings) if pitch is None or "metres per count" not in w]
    left_out = ["belt_speed"] if measure.belt_stands(recording.rig) else []
    text = (
        sentences.comment_on_ring_down(ring)
        + sentences.comment_on_left_out(left_out)
        + rig.to_toml()
        + format_board(settings)
    )
    with atomic.replacing(output, force) as temporary:
        temporary.write_text(text, encoding="utf-8")
    data = _format_ring_down(rig.metres_per_count, ring) | {
        "file": output,
        "rig": _list_values(rig),
        "left_out": left_out,
    }
    return Answer(data | {"warnings": warnings}, sentences.format_calibration(rig, ring, left_out, warnings, output))


def _check_reachable(request: "RecordRequest") -> None:
    """Refuse what cannot be recorded, and a port that cannot be opened, before the user has to do anything."""
    from daq import protocols
    from daq.recorder import ports
    from daq.recorder.record import check_request

    with tempfile.TemporaryDirectory(prefix="daq-") as folder:
        check_request(replace(request, output=Path(folder) / "run.h5"))
    ports.open_port(request.port, request.baud or protocols.load(request.protocol).BAUD).close()


def _record_once(
    request: "RecordRequest", progress: Callable[[float], None] = lambda seconds: None
) -> "tuple[RecordingQuality, Recording]":
    """Record into a temporary folder, and return the quality and the run."""
    from daq.recorder.record import RecordingInterruptedError, record
    from daq.runfile import store
    from stickslip.output import disk

    with tempfile.TemporaryDirectory(prefix="daq-") as folder:
        output = Path(folder) / "run.h5"
        with application.progress("recording", request.duration_s, "s") as show:

            def both(seconds: float) -> None:
                show(seconds)
                progress(seconds)

            try:
                summary = record(
                    replace(request, output=output), progress=both, status=show.status, say=application.note
                )
            except RecordingInterruptedError as error:  # its journal is deleted with the folder
                raise KeyboardInterrupt from error
            except disk.RefusedError as error:
                do = "free some space there, or set TMPDIR to a folder on another disk"
                raise disk.RefusedError(error.what.partition(";")[0], folder, do) from error
        return summary, store.load(output)


def _ask_to_act(line: str, wait: bool) -> None:
    """Print what to do, and wait for Enter on a terminal."""
    if wait and sys.stdin.isatty():
        application.ask(f"{line}; press Enter to begin ")
    else:
        application.note(line)


def _format_ring_down(pitch: Measured | None, ring: "RingDown | None") -> dict[str, Any]:
    if ring is None:
        return {}
    metres = abs(pitch.value) if pitch is not None else None
    weakening = ring.velocity_weakening
    return {
        **_format_pair("omega0", ring.omega0),
        **_format_pair("damping_ratio", ring.zeta),
        **_format_pair("friction_counts", ring.friction),
        "friction_length": None if metres is None else ring.friction.value * metres,
        "weakening": None if weakening is None or metres is None else weakening.value / metres,
        **_format_pair("rest_counts", ring.equilibrium),
        "rms_counts": ring.rms,
        "swings": ring.swings,
        "samples": ring.samples,
        "poor": ring.poor,
    }


def _format_pair(key: str, measured: Measured) -> dict[str, float]:
    return {key: measured.value, f"{key}_sd": measured.sd}


def _list_values(rig: Rig) -> dict[str, Any]:
    values: dict[str, Any] = {"decoder": rig.decoder, "counter_bits": rig.counter_bits}
    for key in QUANTITIES:
        if (measured := getattr(rig, key)) is not None:
            values |= _format_pair(key, measured)
    return values
