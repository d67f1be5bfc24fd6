"""What the programs execute and give away: no foreign code, no page for others, no cache that others may write."""

import ast
from collections.abc import Iterator
from pathlib import Path

from . import campaign
from .campaign import Result, Size

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("daq", "processing", "fitting", "rig_sim")
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
# The work that a user sends to a dask scheduler of his own is pickled, here and by dask; nothing read from a file is.
ALLOWED = {("daq/compute/workers.py", "pickle")}


def security(size: Size, folder: Path) -> list[Result]:
    """Try what a page, a file or another user of the computer may do."""
    return [_sources()]


def _sources() -> Result:
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    faults = []
    for path in files:
        name = path.relative_to(ROOT).as_posix()
        places = executes(path.read_text(encoding="utf-8"))
        faults += [f"{name}:{line}: {what}" for line, what in places if (name, what) not in ALLOWED]
    return Result(
        "no input is executed or unpickled: no pickle, eval, exec or shell",
        "the syntax tree of every module of the four packages",
        f"{len(files)} modules, {len(faults)} such calls or imports",
        campaign.test_of("security"),
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
