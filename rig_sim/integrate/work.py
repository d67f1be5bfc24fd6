"""What the kernels keep between their steps: a record whose fields have names, interpreted and compiled.

A kernel reads and writes ``work.steps`` and ``work.w[j]``.  Interpreted it is handed an object of floats and lists;
compiled, a record of numpy with fields of the same names.  Numba passes a record as one pointer, so that no call counts
references, and does not look for indices below 0 in its arrays.  A kernel that Python calls begins with ``work =
unboxed(work)``: the record comes in an array of no dimensions, which a call hands over in a tenth of the time.
"""

from dataclasses import dataclass, fields
from typing import Any, TypeVar

Buffer = Any  # list of floats (interpreted) or one-dimensional float64 array (compiled)
Series = Any  # the same, of the coefficients of a Taylor series

ORDER = 28  # order of the Taylor series: 24 to 32 cost about the same per unit of time
COEFFICIENTS = ORDER + 2  # coefficients of a series

R = TypeVar("R")
_SHAPES: dict[Any, dict[str, bool]] = {}
_TYPES: dict[Any, Any] = {}


@dataclass(slots=True)
class Work:
    """The record of one mass."""

    # of the last Taylor step: relative velocity, displacement, 1/q0 of the hyperbola's denominator (the square of w on
    # a measured curve), the hyperbola's fall, the drive
    w: Series
    p: Series
    q: Series
    d: Series
    u: Series
    steps: float  # steps taken, and after how many a kernel ends in the outcome `step limit`
    steps_allowed: float
    rapid: float  # events in a row without time passing
    time_scale: float  # unit of time of the last Taylor step, s
    zeta: float  # the closed form's damping and acceleration at its start, when it was left, and its solution there
    start: float
    exit: float
    exit_s: float
    exit_e: float
    late: float  # how much later than its duration says a phase was left, s
    p_rest: float  # what compensated summation holds below the last digits of p and w
    w_rest: float
    piece: float  # of the last Taylor step on a measured curve: its piece, and the number of terms
    degree: float


def new_work(max_steps: float = 1_000_000, *, compiled: bool = False) -> Work:
    """Return the record of one mass, for interpreted or for compiled calls.

    A step is one closed-form phase or one Taylor step; they are counted over the record's life, and a kernel that would
    exceed ``max_steps`` ends in the outcome `step limit`.
    """
    work = new_record(Work, compiled=compiled)
    work.steps_allowed = float(max_steps)
    work.time_scale = 1.0
    return work


def zeros(number: int, *, compiled: bool) -> Buffer:
    """Return a buffer of so many zeros, for interpreted or for compiled calls."""
    if not compiled:
        return [0.0] * number
    import numpy

    return numpy.zeros(number)


def new_record(kind: type[R], *, compiled: bool) -> R:
    """Return a record of zeros with the fields of ``kind``, a dataclass of numbers and series."""
    if not compiled:
        return kind(*([0.0] * COEFFICIENTS if is_series else 0.0 for is_series in _shapes(kind).values()))
    import numpy

    return numpy.zeros((), _as_numpy(kind)).view(numpy.recarray)  # type: ignore[return-value]  # has the fields


def unboxed(record: R) -> R:
    """Return the record that a kernel reads and writes; compiled, what `new_record` has put into an array."""
    return record


def _shapes(kind: type[Any]) -> dict[str, bool]:
    """Return the names of a record's fields, and whether each is a series."""
    if kind not in _SHAPES:
        _SHAPES[kind] = {field.name: field.type is Series for field in fields(kind)}
    return _SHAPES[kind]


def _as_numpy(kind: type[Any]) -> Any:
    """Return numpy's type of a record."""
    if kind not in _TYPES:
        import numpy

        shapes = {name: (COEFFICIENTS,) if is_series else () for name, is_series in _shapes(kind).items()}
        _TYPES[kind] = numpy.dtype([(name, "f8", shape) for name, shape in shapes.items()], align=True)
    return _TYPES[kind]


def for_compiled(record: R) -> R:
    """Return an interpreted record's numbers as the record that compiled kernels take."""
    made = new_record(type(record), compiled=True)
    for name in _shapes(type(record)):
        setattr(made, name, getattr(record, name))
    return made
