"""The user's request for a recording, from the flags to the board."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stickslip.units import Measured


@dataclass(frozen=True)
class RecordRequest:
    """What to record, from which board, into which file; None where the protocol or the board may choose."""

    port: str = "rig://rig"
    output: Path = Path("run.h5")
    rate_hz: int | None = None
    duration_s: float = 20.0
    force: bool = False
    baud: int | None = None
    protocol: str = "frames"
    columns: str | None = None
    decoder: str | None = None
    calibration: str | None = None  # text of a rig.toml that replaces the calibration sent by the board
    stated: Mapping[str, Measured | int] = field(default_factory=dict)  # fields of `Rig` that replace the calibration's
    notes: Mapping[str, Any] = field(default_factory=dict)  # by the attributes of `daq.runfile.recording.Recording`

    @property
    def part(self) -> Path:
        """Path of the journal while the recording runs."""
        return self.output.with_name(self.output.name + ".part")
