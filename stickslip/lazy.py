"""Public names of a package that are imported on first use: `import daq` alone loads nothing."""

TYPE_CHECKING = False  # not from typing: until its entry point guards it, a command must import as little as can be
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")


def lazy_names(package: str, homes: "Mapping[str, str]") -> "tuple[Callable[[str], Any], Callable[[], list[str]]]":
    """Return ``__getattr__`` and ``__dir__`` of a package: its public names, and the module that has each."""

    def import_name(name: str) -> "Any":
        if name == "__version__":
            from stickslip.version import VERSION

            return VERSION
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        from importlib import import_module

        check_not_hidden()
        return getattr(import_module(homes[name]), name)

    return import_name, lambda: sorted(["__version__", *homes])


def check_not_hidden() -> None:
    """Raise InputError, which names the file, where Python finds another module in place of one of our packages."""
    from importlib.util import find_spec
    from pathlib import Path

    folder = Path(__file__).resolve().parents[1]
    for package in PACKAGES:
        spec = find_spec(package)
        if spec is None or spec.origin is None or Path(spec.origin).resolve().parents[1] == folder:
            continue
        from stickslip.errors import InputError

        do = "rename it, or start Python in another folder"
        raise InputError(f"this file hides the package {package!r} of stickslip", spec.origin, do)
