"""Kernel: an oscillator on a moving base, followed as one pole in the complex plane."""

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array


def follow_pole(drive: Array, turn: complex, gain: complex, state: NDArray[np.complex128]) -> None:
    """Fill ``state`` (n,) from 0: each is ``turn`` times the one before plus ``gain`` times the drive (n,) then."""
    now = 0j
    for k in range(drive.size):
        state[k] = now
        now = turn * now + gain * drive[k]
