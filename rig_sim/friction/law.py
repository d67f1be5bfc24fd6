"""The six friction laws: a slip curve (how friction falls with slip speed) times a contact (jump or ramp at rest).

===  ===========  =======  ==============  ==============================================
law  curve        contact  parameters      thesis
===  ===========  =======  ==============  ==============================================
1    constant     jump     Fs              2.4 classic Coulomb
2    constant     ramp     Fs, d           2.5 continuous Coulomb
3    linear       jump     Fs, G_slip      2.6 discontinuous, sloping slip
4    linear       ramp     Fs, G_slip, d   2.7 continuous, sloping slip
5    hyperbolic   jump     Fs, gamma       2.8 discontinuous, non-linear slip
6    hyperbolic   ramp     Fs, gamma, d    2.9 continuous, non-linear slip
===  ===========  =======  ==============  ==============================================
"""

from dataclasses import dataclass

from rig_sim.friction.curve import CURVES


@dataclass(frozen=True)
class Law:
    number: int  # 1 to 6; 0 for a measured curve
    name: str
    curve: str  # 'constant', 'linear', 'hyperbolic': `rig_sim.friction.curve`; 'measured': `rig_sim.friction.spline`
    contact: str  # 'jump' (set-valued at rest) or 'ramp' (F proportional to w): `rig_sim.friction.contact`
    parameters: tuple[str, ...]  # of Fs (N), G_slip (N s/m), gamma (s/m), d (m/s)

    @property
    def curve_code(self) -> int:
        return CURVES[self.curve]

    @property
    def ramp(self) -> int:
        """1 for a ramp contact, 0 for a jump: the kernels' integer."""
        return int(self.contact == "ramp")


LAWS = {
    law.number: law
    for law in (
        Law(1, "constant", "constant", "jump", ("Fs",)),
        Law(2, "constant + ramp", "constant", "ramp", ("Fs", "d")),
        Law(3, "linear", "linear", "jump", ("Fs", "G_slip")),
        Law(4, "linear + ramp", "linear", "ramp", ("Fs", "G_slip", "d")),
        Law(5, "hyperbolic", "hyperbolic", "jump", ("Fs", "gamma")),
        Law(6, "hyperbolic + ramp", "hyperbolic", "ramp", ("Fs", "gamma", "d")),
    )
}


def find_limits(law: Law) -> tuple[int, ...]:
    """Return the laws that this one becomes in a limit: without its fall, with a ramp of no width, or both."""
    others = [
        other
        for other in LAWS.values()
        if other is not law and other.curve in (law.curve, "constant") and other.contact in (law.contact, "jump")
    ]
    return tuple(sorted((other.number for other in others), reverse=True))


NESTED = {law.number: find_limits(law) for law in LAWS.values()}  # the laws that are a limit of each

MEASURED_CURVE = Law(0, "measured curve", "measured", "jump", ("curve",))  # the points of a scene


def law_or_curve(number: int) -> Law:
    return MEASURED_CURVE if number == 0 else LAWS[number]
