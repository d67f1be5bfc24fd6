"""What tests of every package share."""

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

# A shared machine may stall any example; where every check is run (.ci/run) the examples are the same each time.
EVERY_CHECK = "CI" in os.environ or "STICKSLIP_REQUIRE_TOOLS" in os.environ
hypothesis.settings.register_profile("stickslip", deadline=None, derandomize=EVERY_CHECK)
hypothesis.settings.load_profile("stickslip")

# A shell ignores SIGINT for what it runs in the background, and the commands under test would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# A file is run by one process: a long one that begins last would be waited for.
LONGEST = (
    "reliability/test_campaigns.py",
    "docs/test_examples.py",
    "fitting/test_processors.py",
    "contract/test_recording_survives.py",
    "browser/test_live_page.py",
    "fitting/test_batch.py",
    "fitting/model/test_memory.py",
    "fitting/judge/test_joint.py",
    "fitting/judge/test_own_laws.py",
    "contract/test_protocols.py",
    "test_notebook.py",
    "test_demo.py",
    "test_pipe.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that take longest first."""
    here = Path(__file__).parent
    place = {here / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))


def need(there: object, what: str) -> None:
    """Skip where a tool is missing, or fail where every tool must be there."""
    if not there:
        assert "STICKSLIP_REQUIRE_TOOLS" not in os.environ, what
        pytest.skip(what, allow_module_level=True)


@pytest.fixture(scope="session")
def smoothing_kernels() -> None:
    """Compile what smoothing needs, which is announced on stderr the first time, before a test reads stderr."""
    import daq
    from processing import compare

    compare.compare_methods(daq.load(Path(__file__).resolve().parent.parent / "data_samples" / "law5.h5"), None)


@contextmanager
def empty_pictures() -> Iterator[None]:
    """Leave the pictures of reports empty: to draw them costs several times the fit of two laws."""
    from fitting.report import pictures

    names = [picture.__name__ for picture in (*pictures.PICTURES, pictures.break_aways)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "draw", lambda ranking: dict.fromkeys(names, "<svg></svg>"))
        yield


@pytest.fixture(scope="module")
def undrawn_reports() -> Iterator[None]:
    """Leave the pictures of a module's reports empty."""
    with empty_pictures():
        yield


@pytest.fixture
def undrawn_report() -> Iterator[None]:
    """Leave the pictures of one test's reports empty."""
    with empty_pictures():
        yield


def compete_alone(patch: pytest.MonkeyPatch) -> None:
    """Let no published law compete that was not named."""
    for published in ("PUBLISHED", "MEMORY"):
        patch.setattr(f"fitting.judge.formulas.{published}", {})


@pytest.fixture
def no_rivals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the six compete alone: to reject one published formula may cost several times the fit of a law."""
    compete_alone(monkeypatch)


@contextmanager
def no_other_law() -> Iterator[None]:
    """Fit no law beside those asked for, where a test is not about which law is found: that takes most of a rank."""
    from fitting.judge import law_fits
    from fitting.laws import SIX, Competitors

    fit = law_fits._fit_laws
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(law_fits, "_fit_laws", lambda laws, runs, among=None, **how: fit(laws, runs, laws, **how))
        patch.setattr(Competitors, "searched", property(lambda asked: asked.six or tuple(SIX.values())))
        compete_alone(patch)
        yield


@pytest.fixture(scope="module")
def asked_laws_alone() -> Iterator[None]:
    """Fit no law in a module beside those asked for."""
    with no_other_law():
        yield


@pytest.fixture
def asked_law_alone() -> Iterator[None]:
    """Fit no law in one test beside those asked for."""
    with no_other_law():
        yield


@pytest.fixture(scope="module")
def unmeasured_curve() -> Iterator[None]:
    """Measure no curve without a law in a module that is not about it: that takes as long as the fit of two laws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fitting.judge.adequacy.measure_curve", lambda *_: None)
        yield


@pytest.fixture(scope="session")
def captures() -> Path:
    """Return the folder of real logic-analyser captures, which are not part of the project."""
    root = Path(__file__).resolve().parent.parent
    folder = Path(os.environ.get("STICKSLIP_SHARED", root.parent / "shared")) / "captures"
    if not folder.is_dir():
        pytest.skip(f"no captures at {folder}; set STICKSLIP_SHARED to the folder that holds captures/")
    return folder


@pytest.fixture(scope="session")
def published() -> Callable[[str], Any]:
    """Give a function that imports a published record of paper on paper by its name."""
    from daq.imports import table_to_run
    from daq.imports.options import ImportOptions

    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("STICKSLIP_SHARED", root.parent / "shared")) / "records/paper-on-paper"
    if not folder.is_dir():
        pytest.skip(f"no records at {folder}; set STICKSLIP_SHARED to the folder that holds records/")

    def of(name: str) -> Any:
        return table_to_run.read(folder / f"{name}.mat", ImportOptions(time="t", position="Fnorm")).run

    return of


@pytest.fixture(scope="session")
def write_capture() -> Callable[..., Path]:
    """Return a function that writes a logic-analyser capture as sigrok does."""
    return _capture


def _capture(
    path: Path,
    samples: Any,
    probes: dict[int, str],
    *,
    unitsize: int = 1,
    rate: str | None = "1 MHz",
    chunk: int | None = None,
) -> Path:
    """Write integer samples, bit n for probe n + 1, as one entry or as numbered chunks of so many bytes."""
    data = np.asarray(samples, "<u8").view(np.uint8).reshape(-1, 8)[:, :unitsize].tobytes()
    lines = ["[global]", "sigrok version=0.5.2", "", "[device 1]", "capturefile=logic-1"]
    lines += [f"total probes={8 * unitsize}", f"unitsize={unitsize}"]
    lines += [f"samplerate={rate}"] if rate else []
    lines += [f"probe{bit + 1}={name}" for bit, name in probes.items()]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        archive.writestr("metadata", "\n".join(lines) + "\n")
        if chunk is None:
            archive.writestr("logic-1", data)
        else:
            pieces = [data[start : start + chunk] for start in range(0, len(data), chunk)]
            numbered = [(f"logic-1-{number}", piece) for number, piece in enumerate(pieces, start=1)]
            for name, piece in sorted(numbered):  # by name: 1, 10, 11, 2 ...
                archive.writestr(name, piece)
    return path


@pytest.fixture(scope="session")
def dask() -> None:
    """Need dask.distributed."""
    need(find_spec("distributed"), "dask.distributed is not installed")


@pytest.fixture(scope="session")
def cluster(dask: None) -> Iterator[str]:
    """Start a scheduler and two workers of one thread, in processes of their own; give the address."""
    script = (
        "from distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:\n"
        "        print(cluster.scheduler_address, flush=True)\n"
        "        input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as run:
        yield run.stdout.readline().strip()
        run.stdin.write("\n")


@pytest.fixture
def own_scheduler(dask: None, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start a scheduler that a test may kill; give the process and the address."""
    contact = tmp_path / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    with subprocess.Popen([*command, "--scheduler-file", str(contact)], stderr=subprocess.DEVNULL) as run:
        deadline = time.monotonic() + 600
        while not (contact.exists() and contact.read_text().endswith("}")) and time.monotonic() < deadline:
            time.sleep(0.05)
        yield run, json.loads(contact.read_text())["address"]
        run.kill()


@pytest.fixture
def worker(tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Give what starts a worker of a scheduler, with other folders before its import path."""
    started: list[subprocess.Popen[bytes]] = []

    def start(address: str, *path: str) -> None:
        command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([*path, os.environ.get("PYTHONPATH", "")])}
        started.append(
            subprocess.Popen(
                [*command, "--no-dashboard"],
                env=environment,
                cwd=tmp_path,  # which comes before PYTHONPATH
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )

    yield start
    for process in started:
        process.kill()
        process.wait()
