"""The suffix of an output file names its format: a name that promises another format is refused.

A suffix that is of no known format promises nothing and is accepted, as is a name without one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from stickslip.errors import InputError


@dataclass(frozen=True)
class Format:
    """A format of files: what it is called, and its suffixes, the usual one first."""

    name: str
    suffixes: tuple[str, ...]


RUN = Format("a run file (HDF5)", (".h5", ".hdf5", ".hdf", ".he5", ".nxs"))
CSV = Format("a CSV table", (".csv", ".txt"))
PARQUET = Format("a Parquet table", (".parquet", ".pq"))
PAGE = Format("an HTML page", (".html", ".htm", ".xhtml"))
TOML = Format("a TOML file", (".toml", ".txt"))
TEXT = Format("a text file", (".txt",))
PDF = Format("a PDF document", (".pdf",))
# Written by other programs, or by other commands; what a suffix says to everybody.
OTHERS = (
    Format("a picture", (".png", ".svg", ".jpg", ".jpeg", ".gif", ".tif", ".tiff", ".eps", ".ps")),
    Format("a table with tabs", (".tsv",)),
    Format("a text document", (".md", ".rst", ".tex", ".doc", ".docx", ".odt", ".rtf")),
    Format("a spreadsheet", (".xlsx", ".xls", ".ods")),
    Format("a MATLAB file", (".mat",)),
    Format("a numpy file", (".npy", ".npz")),
    Format("a JSON document", (".json", ".jsonl")),
    Format("an XML document", (".xml",)),
    Format("a TDMS file", (".tdms",)),
    Format("a LabVIEW measurement", (".lvm",)),
    Format("a logic capture", (".sr",)),
    Format("a journal", (".part",)),
    Format("an archive", (".zip", ".gz", ".tar", ".7z")),
)
NAMED = {suffix: form for form in (RUN, CSV, PARQUET, PAGE, TOML, PDF, TEXT, *OTHERS) for suffix in form.suffixes}


def check(path: Path, form: Format, flag: str = "-o", do: Mapping[Format, str] | None = None) -> None:
    """Raise InputError for a suffix of another format than ``form``; ``do`` says what writes a file of that format."""
    promised = NAMED.get(path.suffix.lower())
    if promised is None or path.suffix.lower() in form.suffixes:
        return
    advice = f"name it {path.with_suffix(form.suffixes[0]).name} ({flag})"
    other = (do or {}).get(promised)
    what = f"{path.suffix} is the suffix of {promised.name}, but the output is {form.name}"
    raise InputError(what, str(path), f"{advice}; {other}" if other else advice)


def check_run(path: Path, flag: str = "-o") -> None:
    """Raise InputError as `check` for a run file; for a table it names the command that writes one."""
    run = path.with_suffix(RUN.suffixes[0]).name
    export = f"to obtain a table, then run: daq export {run} -o {path.name}"
    check(path, RUN, flag, {CSV: export, TEXT: export, PARQUET: export})


def choose_form(path: Path, forms: Mapping[str, Format], flag: str = "-o") -> str:
    """Return the key of the format that the suffix of an output names, of those that can be written."""
    for key, form in forms.items():
        if path.suffix.lower() in form.suffixes:
            return key
    usual = " or ".join(form.suffixes[0] for form in forms.values())
    promised = NAMED.get(path.suffix.lower())
    is_of = f"{path.suffix} is the suffix of {promised.name}" if promised else "the suffix does not indicate a format"
    raise InputError(
        f"{is_of}, and only {usual} can be written", str(path), f"choose a name that ends in {usual} ({flag})"
    )
