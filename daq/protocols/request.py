"""What to record: the one value that carries a person's request from the flags to the board."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stickslip.units import Measured


@dataclass(frozen=True)
class RecordRequest:
    """What to record, from which board, into which file; None where the protocol or the board may choose.

    Attributes
    ----------
    port : str
        A device or URL.
    output : Path
        The run file.
    rate_hz : int or None
        Samples per second; None for the protocol's own rate (1000 Hz in our own).
    duration_s : float
        How long.
    force : bool
        Replace an existing file.
    baud : int or None
        Bits per second of a serial line; None for the protocol's usual.
    protocol : str
        One of `daq.protocols.PROTOCOLS`.
    columns : str or None
        The columns of text lines; None for labelled ones.
    decoder : str or None
        The decoder that the board is to use, one of `daq.wire.frames.DECODERS`.
    calibration : str or None
        TOML text of a ``rig.toml`` that replaces the calibration that the board sends.
    stated : mapping
        Quantities of the rig, by the attributes of `daq.runfile.rig.Rig`, that replace those of the calibration, given
        or sent.
    notes : mapping
        Title, operator and the other notes on the run, by the attributes of `daq.runfile.recording.Recording`.
    """

    port: str = "rig://rig"
    output: Path = Path("run.h5")
    rate_hz: int | None = None
    duration_s: float = 20.0
    force: bool = False
    baud: int | None = None
    protocol: str = "frames"
    columns: str | None = None
    decoder: str | None = None
    calibration: str | None = None
    stated: Mapping[str, Measured | int] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def part(self) -> Path:
        """Where the journal is kept while the recording runs."""
        return self.output.with_name(self.output.name + ".part")
