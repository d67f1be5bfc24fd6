"""Recording: the board's wire, decoders, the recorder and the run file.

``daq.load(path)`` reads a run or a table, ``daq.Recording.from_arrays(time, position)`` takes arrays, and
``daq.record(source, path, rate_hz=...)`` records from a port or from blocks of samples.
"""

TYPE_CHECKING = False  # not from typing: until its entry point guards it, a command must import as little as can be
if TYPE_CHECKING:
    from typing import Any

    from daq.finalise.quality import RecordingQuality as RecordingQuality
    from daq.imports.load import load as load
    from daq.recorder.source import record as record
    from daq.recorder.source import recover as recover
    from daq.runfile.recording import Recording as Recording

    __version__: str

__all__ = ["Recording", "RecordingQuality", "__version__", "load", "record", "recover"]

_HOME = {
    "Recording": "daq.runfile.recording",
    "RecordingQuality": "daq.finalise.quality",
    "load": "daq.imports.load",
    "record": "daq.recorder.source",
    "recover": "daq.recorder.source",
}


def __getattr__(name: str) -> "Any":
    """Import what is asked for when it is first asked for: ``import daq`` alone loads nothing."""
    if name == "__version__":
        from stickslip.version import VERSION

        return VERSION
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'daq' has no attribute {name!r}")
