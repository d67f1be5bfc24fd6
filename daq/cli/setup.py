"""`daq doctor`: checks of the installation; `daq demo`: from pulses to a law, in a new folder."""

import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TextIO

from stickslip.compute.interpreter import start_python
from stickslip.console.application import Answer, Json
from stickslip.errors import EXIT_DEVICE, EXIT_DONE, EXIT_UNDECIDED, StickslipError

PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
DEMO_FOLDER = "stickslip-demo"


@dataclass(frozen=True)
class Check:
    """One check of the installation: its name, whether it passed, the details, what to do."""

    name: str
    ok: bool
    detail: str
    do: str = ""


def doctor(*, json: Json = False) -> Answer:
    """Check the installation: packages, dependencies, ports, the simulated rig and a browser.

    Example: daq doctor
    """
    checks = [
        _check_python(),
        *_check_packages(),
        _check_requirements(),
        _check_commands(),
        _check_rig(),
        _check_ports(),
        _check_browser(),
        _check_folder(),
    ]
    ok = all(check.ok for check in checks)
    lines = [f"{'ok  ' if check.ok else 'FAIL'} {check.name}: {check.detail}" for check in checks]
    lines += [f"     do: {check.do}" for check in checks if not check.ok]
    lines.append(
        "this computer is ready; try 'daq record --rate 1000'"
        if ok
        else "this computer is not ready; see the lines marked FAIL"
    )
    data = {"ok": ok, "checks": [vars(check) | {"do": "" if check.ok else check.do} for check in checks]}
    return Answer(data, "\n".join(lines), EXIT_DONE if ok else EXIT_DEVICE)


def _check_python() -> Check:
    version = ".".join(str(part) for part in sys.version_info[:3])
    return Check(
        "python",
        sys.version_info >= (3, 11),
        f"{version} at {sys.executable}",
        "install Python 3.11 or later",
    )


def _check_packages() -> list[Check]:
    """Check that each package is that of stickslip: the package index has another `daq` and `fitting`."""
    from importlib.metadata import packages_distributions
    from importlib.util import find_spec

    home = Path(__file__).resolve().parents[2]
    owners = packages_distributions()
    checks = []
    for package in PACKAGES:
        spec = find_spec(package)
        origin = Path(spec.origin).resolve() if spec and spec.origin else None
        others = sorted({owner for owner in owners.get(package, []) if owner != "stickslip"})
        passed = origin is not None and origin.parent.parent == home and not others
        seen = str(origin.parent) if origin else "not found"
        remedy = "install stickslip again"
        if others:
            seen += f"; also installed by {', '.join(others)}"
            remedy = f"python -m pip uninstall {' '.join(others)}; then {remedy}"
        checks.append(Check(f"package {package}", passed, seen, remedy))
    return checks


def _check_requirements() -> Check:
    from importlib.metadata import PackageNotFoundError, requires, version

    seen, missing = [], []
    for line in requires("stickslip") or []:
        if "extra ==" in line:
            continue
        name = line.split(";")[0].strip()
        for mark in "<>=!~[ (":
            name = name.split(mark)[0]
        try:
            seen.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    detail = f"missing {', '.join(missing)}" if missing else ", ".join(seen)
    return Check(
        "needed packages", not missing, detail, f"python -m pip install {' '.join(missing)}" if missing else ""
    )


def _check_commands() -> Check:
    scripts = Path(sys.executable).parent
    elsewhere = []
    for command in ("stickslip", "daq", "process", "fit-friction", "rig-sim"):
        path = shutil.which(command)
        if path is not None and Path(path).parent.resolve() != scripts.resolve():
            elsewhere.append(f"{command} is {path}")
    detail = "; ".join(elsewhere) if elsewhere else f"in {scripts}"
    return Check("commands", not elsewhere, detail, f"put {scripts} first on PATH, or activate its environment")


def _check_rig() -> Check:
    """Ask the simulated rig for its name over the same port layer as a real board."""
    from daq.recorder import ports
    from daq.wire import frames as wire

    try:
        with ports.open_port("rig://rig") as port:
            port.write(b"I\n")
            frames = wire.FrameReader().feed(port.read(4096))
    except (StickslipError, OSError) as error:
        detail = error.as_line() if isinstance(error, StickslipError) else str(error)
        return Check("simulated rig", False, detail, "install stickslip again")
    names = [frame.name for frame in frames if isinstance(frame, wire.Ident)]
    return Check("simulated rig", bool(names), names[0] if names else "no answer", "install stickslip again")


def _check_ports() -> Check:
    from serial.tools.list_ports import comports

    devices = [port.device for port in comports()]
    return Check(
        "serial ports",
        True,
        ", ".join(devices) if devices else "no port is connected; the simulated rig does not need one",
    )


def _check_browser() -> Check:
    import webbrowser

    names = ("chromium", "chromium-browser", "google-chrome", "firefox")
    browser = next((path for path in map(shutil.which, names) if path), None)
    if browser is None:
        try:
            browser = webbrowser.get().__class__.__name__
        except webbrowser.Error:
            browser = None
    return Check(
        "browser", True, browser or "no browser was found; reports can be opened with a browser on another computer"
    )


def _check_folder() -> Check:
    import os

    folder = Path.cwd()
    free = shutil.disk_usage(folder).free
    writable = os.access(folder, os.W_OK)
    detail = f"{folder}: {free / 1e9:.1f} GB free" + ("" if writable else ", not writable")
    return Check(
        "this folder", writable and free > 100e6, detail, "change to a folder with write permission and free space"
    )


def demo(*, json: Json = False) -> Answer:
    """Record the simulated rig, compute its velocity and rank the six laws, in ./stickslip-demo/.

    After an installation, the first demo also compiles numerical kernels on a second core.

    Example: daq demo
    """
    folder = Path.cwd() / DEMO_FOLDER
    folder.mkdir(exist_ok=True)
    began = time.monotonic()
    with _KernelsOfAFit() as kernels:
        steps, verdict = _demo_steps(folder, sys.stderr if json else sys.stdout, kernels)
    run, report = folder / "run.h5", folder / "run.report.html"
    wall_s = time.monotonic() - began
    data = {
        "folder": folder,
        "file": run,
        "report": report,
        "verdict": verdict,
        "steps": steps,
        "wall_s": wall_s,
    }
    text = [
        f"\ndone in {wall_s:.0f} s; report: {report}",
        "next: open the report in a browser, or import your own table of times and positions:",
        f"  {_locate_command('daq')} import TABLE.csv -o mine.h5",
        f"  {_locate_command('fit-friction')} mine.h5",
        verdict,
    ]
    return Answer(data, "\n".join(text))


def _locate_command(command: str) -> str:
    """Return a command of this installation as it is typed here: its name where that finds it, else its path."""
    script = Path(sys.executable).parent / command
    path = shutil.which(command)
    if path is not None and Path(path).resolve() == script.resolve():
        return command
    return str(script.relative_to(Path.cwd())) if script.is_relative_to(Path.cwd()) else str(script)


class _KernelsOfAFit:
    """Compiles kernels of the fit in other processes, which end with this block."""

    def __init__(self) -> None:
        self._compilers = [self._start_compiler()]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._compilers:
            process.terminate()
            process.wait()

    def fit_waits(self) -> None:
        """Compile the others too, if the first ones are still being compiled: the fit is about to wait for them."""
        if self._compilers[0].poll() is None:
            self._compilers.append(self._start_compiler("motion"))

    @staticmethod
    def _start_compiler(*which: str) -> subprocess.Popen[bytes]:
        quiet = subprocess.DEVNULL
        return start_python("fitting.compile_ahead", *which, stdin=quiet, stdout=quiet, stderr=quiet)


def _demo_steps(folder: Path, out: TextIO, kernels: _KernelsOfAFit) -> tuple[list[dict[str, object]], str]:
    """Run the three commands in a folder; return each with its exit code, and the line of the verdict."""
    steps: list[dict[str, object]] = []
    verdict = ""
    for module, typed in (
        ("daq.cli.app", ["daq", "record", "--rate", "1000", "-o", "run.h5", "--force"]),
        ("processing.cli", ["process", "smooth", "run.h5"]),
        ("fitting.cli", ["fit-friction", "run.h5"]),
    ):
        out.write(f"\n$ {' '.join(typed)}\n")
        out.flush()
        if module == "fitting.cli":
            kernels.fit_waits()
        code, lines = _echo(module, typed[1:], folder, out)
        steps.append({"command": " ".join(typed), "exit_code": code})
        if code not in (EXIT_DONE, EXIT_UNDECIDED):
            raise StepError(f"'{' '.join(typed)}' ended with exit code {code}", str(folder), "run 'daq doctor'")
        verdict = next((line for line in reversed(lines) if line.startswith("verdict: ")), verdict)
    return steps, verdict


class StepError(StickslipError):
    """A step of the demo failed: its own message was printed before."""

    exit_code = EXIT_DEVICE


def _echo(module: str, words: list[str], folder: Path, out: TextIO) -> tuple[int, list[str]]:
    """Run a command in a folder, pass its stdout through as it comes, return its exit code and lines."""
    lines = []
    streams = {"stdout": subprocess.PIPE, "text": True, "encoding": out.encoding}
    with start_python(module, *words, cwd=folder, **streams) as process:
        if process.stdout is not None:
            for line in process.stdout:
                out.write(line)
                out.flush()
                lines.append(line.rstrip("\n"))
    return process.returncode, lines
