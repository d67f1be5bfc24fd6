"""Libraries of the extra ``formats``, which read files of other programs."""

from importlib.util import find_spec
from pathlib import Path

from stickslip.errors import InputError


def needed(library: str, path: Path) -> None:
    """Raise InputError, which says how to install it, where a library is missing that a file needs."""
    if find_spec(library) is None:
        what = f"{library} is not installed, which reads {path.suffix} files"
        do = "install the extra 'formats': pip install 'stickslip[formats]'; or export the table as CSV"
        raise InputError(what, str(path), do)
