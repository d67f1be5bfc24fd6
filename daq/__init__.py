"""Recording: the board's wire, decoders, the recorder and the run file.  ``daq.load(path)`` reads a run."""

TYPE_CHECKING = False  # not from typing: until its entry point guards it, a command must import as little as can be
if TYPE_CHECKING:
    from typing import Any

    from daq.runfile.recording import Recording as Recording
    from daq.runfile.store import load as load

    __version__: str

__all__ = ["Recording", "__version__", "load"]


def __getattr__(name: str) -> "Any":
    """Import the run-file reader when it is first asked for: ``import daq`` alone loads nothing."""
    if name == "__version__":
        from daq.base.version import VERSION

        return VERSION
    if name in __all__:
        from daq.runfile import store

        return getattr(store, name)
    raise AttributeError(f"module 'daq' has no attribute {name!r}")
