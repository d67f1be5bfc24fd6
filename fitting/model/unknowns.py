"""Parameters of a fit: those shared by all cycles of a run, and each cycle's own.

For several runs of one contact the thirteen shared parameters of each run are concatenated.  `SHARED_BY_RUNS` are
common to all runs, and copied from the first run.  A *place* is an index through all runs; a *slot* is an index within
a run.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from rig_sim.friction.law import Law
from stickslip.compute.arrays import Array, Integers


class Global(IntEnum):
    """Slot of each parameter that all cycles of a run share; per unit mass, in the fit's frame."""

    K = 0  # k/m, 1/s^2
    LOG_F = 1  # log of Fs/m, which is in m/s^2
    V_DR = 2  # belt speed, m/s
    SHAPE = 3  # gamma, or G_slip/Fs, s/m
    D = 4  # half-width of the ramp, m/s
    DATUM = 5  # the spring's rest position, m
    DAMPING = 6  # c/m, 1/s
    FADE = 7  # fraction of the first friction level lost per second within the cycles, 1/s
    COMPLIANCE = 8  # belt speed lost per metre of spring stretch, 1/s
    COSINE = 9  # of the belt's ripple, m/s
    SINE = 10  # of the belt's ripple, m/s
    OMEGA = 11  # of the belt's ripple, rad/s; 0 without one
    STATIC = 12  # break-away level over Fs, of a ramp


class PerCycle(IntEnum):
    X_SLIP = 0  # position where the slip window starts, m
    V_SLIP = 1  # velocity there, m/s
    LEVEL = 2  # log of the kinetic friction level over Fs
    NEXT_LEVEL = 3  # the same after the next landing
    X_STICK = 4  # position where the stick window starts, m
    V_STICK = 5  # velocity there, m/s


class Values(NamedTuple):
    """One run's parameters by name; units as in `Global`, F = Fs/m in m/s^2."""

    K: float
    F: float
    v_dr: float
    shape: float = 0.0
    d: float = 0.0
    datum: float = 0.0
    damping: float = 0.0
    fade: float = 0.0
    compliance: float = 0.0
    cosine: float = 0.0
    sine: float = 0.0
    omega: float = 0.0
    static: float = 1.0


PER_RUN, PER_CYCLE = len(Global), len(PerCycle)
RIPPLE = (Global.COSINE, Global.SINE, Global.OMEGA)
SHARED_BY_RUNS = (Global.K, Global.LOG_F, Global.SHAPE, Global.D, Global.DAMPING, Global.STATIC)
NUISANCE = (Global.DATUM, Global.DAMPING, Global.FADE, Global.COMPLIANCE, *RIPPLE)  # common to all laws: not penalised


def active_places(kind: Law, compliant: Sequence[bool], rippled: Sequence[bool]) -> tuple[int, ...]:
    """Return the places of a law's parameters; a ramp on a compliant belt breaks away at the level of slip."""
    shape = () if kind.curve == "constant" else (Global.SHAPE,)
    ramp = () if kind.contact == "jump" else (Global.D,) if any(compliant) else (Global.D, Global.STATIC)
    places = [int(slot) for slot in (Global.K, Global.LOG_F, *shape, *ramp, Global.DAMPING)]
    for run, (slows, ripples) in enumerate(zip(compliant, rippled, strict=True)):
        belt = (*((Global.COMPLIANCE,) if slows else ()), *(RIPPLE if ripples else ()))
        of_run = (Global.V_DR, Global.DATUM, Global.FADE, *belt)
        places += [PER_RUN * run + slot for slot in of_run]
    return tuple(sorted(places))


def values(u: Array) -> Values:
    K, log_F, *rest = (float(value) for value in u)
    return Values(K, math.exp(log_F), *rest)


def to_array(p: Values) -> Array:
    return np.array([p.K, math.log(p.F), *p[2:]])


def columns(places: Sequence[int], runs: int) -> Integers:
    """Return the slot of each place in each run, shape (runs, places), or -1."""
    table = np.full((runs, len(places)), -1, np.int64)
    for j, place in enumerate(places):
        run, slot = divmod(place, PER_RUN)
        table[slice(None) if slot in SHARED_BY_RUNS else run, j] = slot
    return table


def copy_shared(u: Array) -> Array:
    """Return the parameters of all runs (13 runs,) with the shared ones copied from the first."""
    by_run = u.reshape(-1, PER_RUN).copy()
    by_run[:, SHARED_BY_RUNS] = by_run[0, SHARED_BY_RUNS]
    return by_run.ravel()
