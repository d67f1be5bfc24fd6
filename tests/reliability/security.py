"""What the programs execute and give away: no foreign code, no page for others, no cache that others may write."""

import ast
import contextlib
import http.client
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

import numpy as np

import daq.cli.app
import fitting.cli
from stickslip.console import application
from stickslip.errors import EXIT_DONE, EXIT_NO_LAW, EXIT_UNDECIDED

from ..conftest import no_other_law
from .result import Result, Size

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
# What executes or unpacks whatever it is given.  numpy.load unpacks objects only with allow_pickle.
FORBIDDEN_MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_METHODS = {
    "os.system",
    "os.popen",
    "subprocess.getoutput",
    "subprocess.getstatusoutput",
    "pandas.read_pickle",
}
FORBIDDEN_KEYWORDS = {"shell", "allow_pickle"}
# The work that a user sends to a dask scheduler of his own is pickled, here and by dask.  `Ranking.load` unpickles what
# `Ranking.save` of the same release wrote, as its page says; no command reads such a file.
ALLOWED = {("stickslip/compute/cluster.py", "pickle"), ("fitting/result.py", "pickle")}

# What a title, a note or a marker may hold.  Executed, each would set window.hacked.
PAYLOADS = (
    "<script>window.hacked=1</script>",
    '"><img src=x onerror="window.hacked=1">',
    "'><svg onload=window.hacked=1>",
    "</title></style></script><script>window.hacked=1</script>",
    "<iframe srcdoc='<script>parent.hacked=1</script>'></iframe>",
    "${window.hacked=1} {{constructor.constructor('window.hacked=1')()}}",
    "<a href='javascript:window.hacked=1'>x</a><details open ontoggle=window.hacked=1>",
)
HOSTS = (
    "example.org",
    "127.0.0.1.example.org:{port}",
    "127.0.0.1",
    "",
    "[::1]:{port}",
    "0.0.0.0:{port}",
    "{host}@example.org",
)
ORIGINS = ("http://example.org", "null", "https://{host}", "http://127.0.0.1", "file://")
PATHS = ("/", "/{token}x/", "/x{token}/", "/{TOKEN}/", "//{token}/", "/{half}/", "/{token}/../../etc/passwd")
PATHS += (
    "/{token}/..%2f..%2fserver.py",
    "/{token}/%2e%2e/{token}/",
    "/{token}/server.py",
    "/{token}/\\..\\server.py",
    "/./",
)
METHODS = ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE")


def security(size: Size, folder: Path) -> list[Result]:
    """Try what a page, a file or another user of the computer may do; ``size.amount`` requests to the live server."""
    return [_sources(), _dependencies(), _cache(folder), _server(size, folder / "server"), _pages(folder / "pages")]


def _sources() -> Result:
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    faults = []
    for path in files:
        name = path.relative_to(ROOT).as_posix()
        places = executes(path.read_text(encoding="utf-8"))
        faults += [f"{name}:{line}: {what}" for line, what in places if (name, what) not in ALLOWED]
    return Result(
        "no input is executed or unpickled: no pickle, eval, exec or shell",
        "the syntax tree of every module of the packages",
        f"{len(files)} modules, {len(faults)} such calls or imports",
        tuple(faults),
    )


def executes(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of what could execute or unpickle the input of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
            yield from ((node.lineno, name) for name in names if name.split(".")[0] in FORBIDDEN_MODULES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in FORBIDDEN_MODULES:
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in FORBIDDEN_CALLS | FORBIDDEN_METHODS:
                yield node.lineno, name
            on = [word.arg for word in node.keywords if ast.unparse(word.value) != "False"]
            yield from ((node.lineno, f"{name}({word}=...)") for word in on if word in FORBIDDEN_KEYWORDS)


def _dependencies() -> Result:
    """Look whether constraints.txt names a version of every dependency, and no place to get it from."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [
        *project["dependencies"],
        *(text for texts in project["optional-dependencies"].values() for text in texts),
    ]
    names = {re.split(r"[\[<>=;]", text)[0].strip().lower() for text in wanted}
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    fixed = {line.partition("==")[0] for line in rows}
    faults = [f"{name} is not in constraints.txt" for name in sorted(names - fixed)]
    faults += [f"constraints.txt: {line}" for line in rows if not re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*", line)]
    return Result(
        "the versions that were tested are named",
        f"{len(names)} dependencies of pyproject.toml, extras included, and theirs",
        f"{len(rows)} versions in constraints.txt",
        tuple(faults),
    )


def _cache(folder: Path) -> Result:
    script = "from stickslip.compute.compile import cache_folder; print(cache_folder(('stickslip.errors',)))"
    faults, said = [], []
    for name, mode, own in (("private", 0o700, True), ("shared", 0o777, False), ("sticky", 0o1777, True)):
        place = folder / f"cache-{name}"
        (place / "stickslip").mkdir(parents=True)
        (place / "stickslip").chmod(0o777)
        place.chmod(mode)
        line = [sys.executable, "-c", script]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(place)}
        used = subprocess.run(
            line, capture_output=True, text=True, env=environment, cwd=ROOT, check=True
        ).stdout.strip()
        open_to_others = used != "None" and any(p.stat().st_mode & 0o022 for p in (Path(used), Path(used).parent))
        if open_to_others or (used != "None") != own:
            faults.append(f"machine code in a {name} folder (mode {mode:o}): {used}")
        said.append(f"{name} {'not used' if used == 'None' else 'used, closed to others'}")
    return Result(
        "machine code is kept only where no other user can write",
        "its folder open to all, in a private, a shared and a sticky folder",
        ", ".join(said),
        tuple(faults),
        test="tests/stickslip/compute/test_compile.py",
    )


@contextlib.contextmanager
def _live(folder: Path, *notes: str) -> Iterator[SplitResult]:
    """Record with the live view; yield its page's URL."""
    folder.mkdir()
    line = [sys.executable, "-m", "daq.cli.app", "record", "--live", "--no-browser", "--duration", "600", *notes]
    with subprocess.Popen(line, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            yield urlsplit(next(text.strip() for text in process.stderr if text.startswith("http")))
        finally:
            process.terminate()
            process.communicate()


def _server(size: Size, folder: Path) -> Result:
    chance = np.random.default_rng(size.seed)
    faults = []
    with _live(folder) as url:
        token = url.path.strip("/")
        words = {"port": url.port, "host": url.netloc, "token": token, "TOKEN": token.swapcase(), "half": token[:9]}
        own, _, _ = _asked(url, "GET", url.path, {"Host": url.netloc})
        if own != 200:
            faults.append(f"the page itself is answered with {own}")
        for k in range(size.amount):
            method, path, headers, body = "GET", url.path, {"Host": url.netloc}, b""
            match k % 5:
                case 0:
                    headers["Host"] = str(chance.choice(HOSTS)).format(**words)
                case 1:
                    headers["Origin"] = str(chance.choice(ORIGINS)).format(**words)
                case 2:
                    path = str(chance.choice(PATHS)).format(**words)
                case 3:
                    method = str(chance.choice(METHODS))
                    path += str(chance.choice(["", "marker", "events", "stop"]))
                case 4:
                    method, body = "POST", bytes(int(chance.integers(1025, 1 << 20)))
                    path += str(chance.choice(["marker", "stop"]))
            status, found, answer = _asked(url, method, path, headers, body)
            where = f"request {k} of seed {size.seed}, {method} {path} {headers}, {len(body)} bytes"
            if status is not None and status < 400:
                faults.append(f"{where}: answered with {status}")
            if "access-control-allow-origin" in found or (token in answer and token not in path):
                faults.append(f"{where}: gives away {found} {answer}")
        listening = _listening(int(url.port or 0))
        if listening != {"0100007F"}:
            faults.append(f"the server listens on {listening}")
    return Result(
        "the live server answers its own page on this computer alone",
        f"{size.amount} requests with another host, origin, token, path or method, or too long a marker",
        f"{size.amount - len(faults)} refused; it listens on 127.0.0.1 only",
        tuple(faults),
        test="tests/daq/live/test_server.py",
    )


def _asked(
    url: SplitResult, method: str, path: str, headers: dict[str, str], body: bytes = b""
) -> tuple[int | None, set[str], str]:
    """Return status (None: the connection was closed), names of headers and body of an answer."""
    link = http.client.HTTPConnection("127.0.0.1", url.port, timeout=20)
    try:
        link.putrequest(method, path, skip_host=True)
        for name, value in headers.items():
            link.putheader(name, value)
        if body:
            link.putheader("Content-Type", "text/plain")
            link.putheader("Content-Length", str(len(body)))
        link.endheaders(body or None)
        answer = link.getresponse()
        return answer.status, {name.lower() for name, _ in answer.getheaders()}, answer.read(10_000).decode("latin-1")
    except (ConnectionError, http.client.HTTPException):
        return None, set(), ""
    finally:
        link.close()


def _listening(port: int) -> set[str]:
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for row in Path(table).read_text().splitlines()[1:]:
            address, _, number = row.split()[1].partition(":")
            if int(number, 16) == port and row.split()[3] == "0A":
                found.add(address)
    return found


def _pages(folder: Path) -> Result:
    promise = "no text of a run, a journal or a marker is executed in a page, and no page asks the network for anything"
    test = {"test": "tests/browser/test_report_page.py"}
    chromium = shutil.which("chromium")
    if chromium is None or find_spec("playwright") is None:
        missing = ("chromium and playwright are needed",) if "STICKSLIP_REQUIRE_TOOLS" in os.environ else ()
        return Result(promise, "not tried: chromium or playwright is not installed", "-", missing, **test)
    from playwright.sync_api import sync_playwright

    folder.mkdir()
    everything = " ".join(PAYLOADS)
    notes = [f"--{name}={everything}" for name in ("title", "operator", "sample", "note")]
    notes += [f"--tag={name}={text}" for name, text in zip(("x", "y", "z"), PAYLOADS, strict=False)]
    runs = ["run.h5", "<img src=x onerror=window.hacked=1>.h5"]
    with contextlib.chdir(folder), no_other_law():
        for run in runs:
            shutil.copy(ROOT / "data_samples/law5.h5", run)
            _run(daq.cli.app.app, "note", run, *notes, "--mark", "1", everything)
        _run(fitting.cli.app, "--each", "--laws", "5", *runs)
    pages = sorted(folder.glob("*.html"))
    faults: list[str] = []
    with sync_playwright() as start:
        browser = start.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for page in pages:
            faults += [f"{page.name}: {what}" for what in _opened(browser, page.as_uri(), page.as_uri())]
        with _live(folder / "live", *notes) as url:
            _asked(url, "POST", f"{url.path}marker", {"Host": url.netloc}, PAYLOADS[0].encode())
            faults += [f"live view: {what}" for what in _opened(browser, url.geturl(), f"http://{url.netloc}/")]
        browser.close()
    if len(pages) != 3:
        faults.append(f"{len(pages)} pages were written")
    return Result(
        promise,
        f"{len(PAYLOADS)} scripts as title, operator, sample, note, tag, marker and file name, in {len(pages)} reports "
        "and the live view, in chromium",
        f"{len(pages) + 1 - len(faults)} pages executed nothing and asked for nothing",
        tuple(faults),
        **test,
    )


def _run(app: Any, *arguments: str) -> None:
    code = application.run(app, list(arguments))
    if code not in (EXIT_DONE, EXIT_UNDECIDED, EXIT_NO_LAW):
        raise RuntimeError(f"{arguments[0]} ended with {code}")


def _opened(browser: Any, address: str, own: str) -> list[str]:
    """Open a page; return what it executed, or asked for elsewhere."""
    found: list[str] = []
    page = browser.new_page()
    page.on("dialog", lambda dialog: (found.append(f"dialog {dialog.message}"), dialog.dismiss()))
    page.on("request", lambda asked: asked.url.startswith((own, "data:")) or found.append(f"asked for {asked.url}"))
    page.goto(address)
    page.wait_for_timeout(1500)
    if page.evaluate("'hacked' in window"):
        found.append("executed a script")
    strange = page.evaluate(
        "document.querySelectorAll('[onerror],[onload],[ontoggle],iframe,[href^=javascript]').length"
    )
    if strange:
        found.append(f"{strange} elements of a payload")
    if "window.hacked=1" not in page.evaluate("document.documentElement.textContent + document.title"):
        found.append("shows no payload: nothing was tried")
    page.close()
    return found
