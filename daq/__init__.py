"""Recording: the board's wire, decoders, the recorder and the run file.

``daq.load(path)`` reads a run or a table, ``daq.Recording.from_arrays(time, position)`` takes arrays, and
``daq.record(source, path, rate_hz=...)`` records from a port or from blocks of samples.
"""

from stickslip.lazy import lazy_names

TYPE_CHECKING = False  # not from typing: until its entry point guards it, a command must import as little as can be
if TYPE_CHECKING:
    from daq.finalise.quality import RecordingQuality as RecordingQuality
    from daq.imports.load import load as load
    from daq.recorder.source import record as record
    from daq.recorder.source import recover as recover
    from daq.runfile.recording import Recording as Recording

    __version__: str

__all__ = ["Recording", "RecordingQuality", "__version__", "load", "record", "recover"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Recording": "daq.runfile.recording",
        "RecordingQuality": "daq.finalise.quality",
        "load": "daq.imports.load",
        "record": "daq.recorder.source",
        "recover": "daq.recorder.source",
    },
)
