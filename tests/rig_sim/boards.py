"""What a simulated board sent, read back."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.wire.frames import FrameReader, SampleBlock
from rig_sim.board.board import SimulatedBoard

DELTA = 0.12566 / 4096 / 4  # metres per count of the scene rig


@dataclass
class Record:
    """The samples of a list of frames, joined: device ticks, counters, levels, sequence numbers."""

    ticks: np.ndarray
    up: np.ndarray
    down: np.ndarray
    levels: np.ndarray
    seq: np.ndarray

    @classmethod
    def of(cls, frames: list[Any]) -> "Record":
        blocks = [frame for frame in frames if isinstance(frame, SampleBlock)]
        ticks = np.concatenate([block.time + np.cumsum(block.dt) for block in blocks])
        up, down, levels = (
            np.concatenate([np.asarray(getattr(block, name), dtype=np.int64) for block in blocks])
            for name in ("up", "down", "status")
        )
        return cls(ticks, up, down, levels, np.concatenate([block.seq + np.arange(len(block.up)) for block in blocks]))

    @property
    def net(self) -> np.ndarray:
        """Up minus down, unwrapped."""
        up, down = (
            counter[0] + np.cumsum(np.diff(counter, prepend=counter[0]) & 0xFFFF) for counter in (self.up, self.down)
        )
        net: np.ndarray = up - down
        return net


def frames_in(data: bytes) -> list[Any]:
    reader = FrameReader()
    frames = reader.feed(data)
    assert reader.crc_errors == 0
    return frames


def frames_of(board: SimulatedBoard, samples: int, commands: bytes = b"S\n", at_once: int = 1000) -> list[Any]:
    """Return the frames that a board sends from its commands to the end of its samples."""
    data = board.write(commands)
    for first in range(0, samples, at_once):
        data += board.samples(min(at_once, samples - first))
    return frames_in(data + board.write(b"X\n"))


def record(board: SimulatedBoard, samples: int, commands: bytes = b"S\n") -> Record:
    return Record.of(frames_of(board, samples, commands))
