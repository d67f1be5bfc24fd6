"""The sections of a scene: one frozen model each, with the keys, units and ranges that `scene` checks."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from rig_sim.friction.curve import CONSTANT, LINEAR
from rig_sim.friction.formula import Formula
from rig_sim.friction.formula_curve import formula_curve
from rig_sim.friction.law import LAWS, Law, law_or_curve
from rig_sim.friction.memory import MEMORY_LAWS, MemoryLaw
from rig_sim.friction.spline import spline_table

if TYPE_CHECKING:
    from rig_sim.effects.ripple import SwingingBelt

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Negative = Annotated[float, Field(lt=0)]


def validate_law(value: object) -> int | str:
    """Return the number or name of a law; refuse others, also true and false, which Python takes for 1 and 0."""
    laws: tuple[int | str, ...] = (0, *LAWS, *MEMORY_LAWS)
    law = next((name for name in laws if name == value and not isinstance(value, bool)), None)
    if law is None:
        raise PydanticCustomError("law", f"input should be {', '.join(map(str, laws[:-1]))} or {laws[-1]}")
    return law


LawName = Annotated[int | str, BeforeValidator(validate_law)]
LARGEST_FORCE_SAMPLES = 129  # slip speeds at which the largest friction is sought; it sets how far the curve must reach
EventRate = Annotated[float, Field(gt=0, le=1000)]  # per second


class Section(BaseModel):
    """A scene's section: frozen; unknown keys, NaN, infinity, and strings in place of numbers are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Mass(Section):
    """The sliding mass; ``m`` in kg."""

    m: Positive


class Spring(Section):
    """The spring between mass and wall: ``k`` in N/m, rest position ``x0`` in m."""

    k: Positive
    x0: float = 0.0


class Belt(Section):
    """The driving belt: ``speed`` in m/s (signed), ``start`` in s, ``length`` of one turn in m.

    From its start its speed swings by ``ripple`` (amplitude, m/s) ``ripple_hz`` times per second.  With a ``channel``
    the board sends the belt's counts too.
    """

    speed: float
    start: NotNegative = 0.0
    length: Positive | None = None
    ripple: NotNegative | None = None
    ripple_hz: Positive | None = None
    channel: bool | None = None

    def swing(self) -> "SwingingBelt":
        from rig_sim.effects.ripple import SwingingBelt

        return SwingingBelt(self.ripple or 0.0, self.ripple_hz or 0.0, self.start)


class Friction(Section):
    """Law 1 to 6, 0 for a measured curve, a law with memory, or a formula; the law takes the parameters it needs.

    Other keys are parameters of the formula or of laws with memory: numbers, in ``model_extra``.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float] = Field(init=False)

    law: LawName | None = None
    Fs: NotNegative | None = None  # largest static force, N; a measured curve has its first force instead
    G_slip: NotNegative | None = None  # slope of the linear curve, N s/m
    gamma: NotNegative | None = None  # rate of the hyperbolic curve, s/m
    G_stick: Negative | None = None  # slope of the ramp, N s/m; or d instead
    d: Positive | None = None  # half-width of the ramp, m/s
    static: Annotated[float, Field(ge=1)] = 1.0  # break-away level over Fs
    # points of the measured curve: slip speed (m/s, from 0, increasing) and friction (N, above 0), joined as
    # `rig_sim.friction.spline` says
    curve: list[Annotated[list[float], Field(min_length=2, max_length=2)]] | None = None
    # of the measured curve: 'jump' (default), or 'ramp' of half-width d.  Of a formula: 'ramp' where d or G_stick is
    # given, else 'jump'.
    contact: Literal["jump", "ramp"] | None = None
    # the curve as `rig_sim.friction.formula` reads it: friction in N at slip speed s.  Instead of ``law``.
    formula: str | None = None

    def law_record(self) -> Law:
        """Return the law; `MEASURED_CURVE` for points and for a formula, whose contact is in ``contact`` and ``d``."""
        return law_or_curve(self.law if isinstance(self.law, int) else 0)

    def memory_law(self) -> MemoryLaw | None:
        return MEMORY_LAWS[self.law] if isinstance(self.law, str) else None

    def memory_parameters(self) -> dict[str, float | None]:
        """Return the parameters of the law with memory, by name; None where the scene must give one and does not."""
        law = self.memory_law()
        parameters = law.parameters.items() if law is not None else ()
        return {
            name: parameter.default if (value := getattr(self, name, None)) is None else float(value)
            for name, parameter in parameters
        }

    def parse_formula(self) -> Formula | None:
        return None if self.formula is None else Formula.parse(self.formula)

    def formula_values(self) -> dict[str, float]:
        """Return the formula's parameters in this section, by name, in the formula's order; empty for a law."""
        formula = self.parse_formula()
        values = {name: getattr(self, name, None) for name in (formula.parameters if formula else ())}
        return {name: float(value) for name, value in values.items() if value is not None}

    def ramp_width(self) -> float:
        """Return the ramp's half-width (m/s), at which its slope reaches static Fs; 0 when the scene names no ramp."""
        if self.d is not None:
            return self.d
        return self.static * self.level() / -self.G_stick if self.G_stick is not None else 0.0

    def has_ramp(self) -> bool:
        """Return whether a measured curve or a formula begins beyond a ramp."""
        if self.contact is None and self.formula is not None:
            return self.d is not None or self.G_stick is not None
        return self.contact == "ramp"

    def level(self) -> float:
        """Return friction (N) at the start of slip."""
        formula = self.parse_formula()
        if formula is not None:
            return float(formula.value(0.0, self.formula_values()))
        if self.law == 0 and self.curve:
            return float(self.curve[0][1])
        return float(self.Fs or 0.0)

    def parameters(self) -> dict[str, float]:
        """Return Fs and the parameters that this law needs, by name; empty for a measured curve or a formula."""
        names = self.law_record().parameters if self.law and self.memory_law() is None else ()
        return {key: self.ramp_width() if key == "d" else float(getattr(self, key)) for key in names}

    def largest_force(self, speed: float) -> float:
        """Return the largest friction (N) of a formula up to a slip speed (m/s), including its break-away level."""
        import numpy as np

        formula = self.parse_formula()
        if formula is None:
            raise ValueError("friction has no formula")
        forces = formula.value(np.linspace(0.0, speed, LARGEST_FORCE_SAMPLES), self.formula_values())
        return max(self.static * float(forces[0]), float(np.max(forces)))

    def flow_fields(self, fastest: float = 0.0) -> dict[str, Any]:
        """Return friction as fields of a flow, by name; of the law's parameters those that it needs.

        The curve of a formula reaches at least the slip speed ``fastest`` (m/s).
        """
        formula = self.parse_formula()
        if formula is not None:
            curve = asdict(formula_curve(formula, tuple(self.formula_values().values()), fastest))
            return curve | {"static": float(self.static), "ramp": int(self.has_ramp()), "d": self.ramp_width()}
        law = self.law_record()
        fields: dict[str, Any] = {
            "curve": law.curve_code,
            "ramp": law.ramp,
            "Fs": self.level(),
            "static": float(self.static),
        }
        if self.law != 0:
            return fields | self.parameters()
        points = tuple((float(s), float(F)) for s, F in self.curve or ())
        if len({F for _, F in points}) == 1:  # exactly law 1 or 3: closed forms
            fields |= {"curve": CONSTANT}
        elif len(points) == 2:
            fields |= {"curve": LINEAR, "G_slip": (points[0][1] - points[1][1]) / points[1][0]}
        else:
            pieces, table = spline_table(points)
            fields |= {"pieces": pieces, "table": table}
        return fields | ({"ramp": 1, "d": self.ramp_width()} if self.has_ramp() else {})


class Start(Section):
    """Position (m) and velocity (m/s) of the mass at t = 0; or those of two masses, or another form of their start."""

    x: float = 0.0  # of one mass
    v: float = 0.0
    x1: float | None = None  # of two masses; 0 where not given
    v1: float | None = None
    x2: float | None = None
    v2: float | None = None
    d: float | None = None  # two masses: both stick with x2 - x1 = d (m), and at t = 0 the first of them starts to slip
    # two masses: as ``d``, on this attractor.  1 has the largest basin.
    attractor: Annotated[int, Field(ge=1)] | None = None


class Coupling(Section):
    """A second mass on the belt: ``a``, stiffness of the spring between them over k; ``b``, ratio of friction levels.

    The second mass has the mass, spring and damper of the first, and b times its friction.
    """

    a: NotNegative
    b: NotNegative


class Damper(Section):
    """Viscous damper to the wall; ``c`` in N s/m."""

    c: NotNegative


class Drive(Section):
    """The force u0 cos(omega t) on the mass; N and rad/s."""

    u0: float
    omega: NotNegative


class Shaker(Section):
    """A force a e^{-i phi} x' on the mass: ``a`` times its velocity (N s/m), ahead of it by the phase ``phi`` (rad)."""

    a: NotNegative
    phi: float


class WearSection(Section):
    """``rate``: fraction of Fs lost per second (negative: the contact runs in and Fs grows)."""

    rate: float


class Scatter(Section):
    """``Fs``: standard deviation of the factor drawn at each stick, a fraction of Fs."""

    Fs: NotNegative


class Joint(Section):
    """``kick``: step of the mass's velocity (m/s) each time the belt's joint comes by."""

    kick: float


class Encoder(Section):
    """The rotary encoder on its cog: x4 count n = floor((x + vibration)/(circumference/lines_per_rev/4))."""

    lines_per_rev: Annotated[int, Field(gt=0)]
    circumference: Positive
    decoder: Literal["x4", "x1", "jk", "jk-latched"] = "x4"
    vibration: NotNegative = 0.0
    vibration_hz: NotNegative = 50.0

    @property
    def metres_per_count(self) -> float:
        """The x4 count in metres; a line is four of them."""
        return self.circumference / self.lines_per_rev / 4


class Jitter(Section):
    """``rms`` of the sampling instants about the commanded grid, s.

    Clipped at 0.45 of a sampling period, so that samples stay in order; the board's name then says so.
    """

    rms: NotNegative


class Output(Section):
    """``truth``: the board also sends the exact time, x, v and F of every sample."""

    truth: bool = False


class Droop(Section):
    """``fraction`` of the belt's speed lost under the present load Fs; in proportion at other loads."""

    fraction: Annotated[float, Field(ge=0, lt=1)]


class FitSection(Section):
    """The fit's result for the scene: ``covariance`` of the keys in ``parameters`` about their ``values``.

    Keys are written ``section.key``; ``friction.curve.3`` is the friction of the fourth point.  ``cycles`` is the
    number fitted; ``verdict`` and ``mass_assumed`` are for the reader.
    """

    parameters: list[str]
    values: list[float]
    covariance: list[list[float]]
    cycles: Annotated[int, Field(ge=2)] = 1_000_000
    verdict: str = ""
    mass_assumed: bool = False


class SlipLoss(Section):
    """The cog slips ``rate`` times per second: ``counts`` x4 counts missed over ``samples`` sampling periods."""

    rate: EventRate
    counts: Annotated[int, Field(gt=0, le=1_000_000)]
    samples: Annotated[int, Field(gt=0, le=1_000_000)] = 1


class Gaps(Section):
    """``rate`` times per second the board sends nothing for ``duration`` s."""

    rate: EventRate
    duration: Annotated[float, Field(gt=0, le=600)]
