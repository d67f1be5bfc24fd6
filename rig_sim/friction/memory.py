"""Friction laws with memory: the force depends on a state of the contact, which follows the slip.

With the slip speed e = v_belt - x' (F > 0 along +x where the belt is faster), and the level factor L (wear, scatter):

``lugre``   F = s0 z + s1 z' + s2 e,   z' = e - s0 abs(e) z/(L g),   g = Fc + (Fs - Fc) exp(-(e/v_s)^2)
``dahl``    the same with Fs = Fc
``ageing``  F = L a asinh(e/(2 v0) exp((F0 + b z)/a)),   z' = v0/D exp(-z) - abs(e)/D
``slip``    the same force,   z' = -abs(e)/D (ln(abs(e)/v0) + z)

z is the mean deflection of the bristles (m), or z = ln(v0 theta/D) of the contact's age theta.  Steady sliding has
F = g(e) + s2 e, or about F0 + (a - b) ln(e/v0).

Sources: C. Canudas de Wit, H. Olsson, K. Astrom, P. Lischinsky, IEEE TAC 40 (1995) 419; P. Dahl, Aerospace Corp.
TOR-0158 (1968); J. Dieterich, JGR 84 (1979) 2161; A. Ruina, JGR 88 (1983) 10359; the asinh: J. Rice, N. Lapusta,
K. Ranjith, J. Mech. Phys. Solids 49 (2001) 1865.
"""

from dataclasses import dataclass

BRISTLE, AGEING, SLIP, PAIR = range(4)  # codes of the kernels; the last is a law of two formulas


@dataclass(frozen=True)
class MemoryParameter:
    dimension: str  # of `stickslip.units`
    default: float | None = None  # None where a scene must give it
    may_be_zero: bool = False


@dataclass(frozen=True)
class MemoryLaw:
    code: int
    title: str
    parameters: dict[str, MemoryParameter]


_DAMPING = MemoryParameter("damping", 0.0, may_be_zero=True)
_FORCE, _SPEED = MemoryParameter("force"), MemoryParameter("speed")
_DAHL = {"s0": MemoryParameter("stiffness"), "s1": _DAMPING, "s2": _DAMPING, "Fc": _FORCE}
_RATE_AND_STATE = {
    "F0": _FORCE,
    "a": _FORCE,
    "b": MemoryParameter("force", may_be_zero=True),
    "D": MemoryParameter("length"),
    "v0": _SPEED,
}
MEMORY_LAWS = {
    "lugre": MemoryLaw(BRISTLE, "LuGre", _DAHL | {"Fs": _FORCE, "v_s": _SPEED}),
    "dahl": MemoryLaw(BRISTLE, "Dahl", _DAHL),
    "ageing": MemoryLaw(AGEING, "rate and state, ageing law", _RATE_AND_STATE),
    "slip": MemoryLaw(SLIP, "rate and state, slip law", _RATE_AND_STATE),
}
