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

    # Of the last Taylor step:
    w: Series  # relative velocity
    p: Series  # displacement
    q: Series  # 1/q0 of the hyperbola's denominator; on a measured curve the square of w
    d: Series  # the hyperbola's fall
    u: Series  # the drive
    steps: float
    steps_allowed: float  # a kernel that would exceed them ends in the outcome `step limit`
    rapid: float  # events in a row without time passing
    time_scale: float  # unit of time of the last Taylor step, s
    zeta: float  # damping of the closed form, 1/s
    start: float  # its acceleration at the start
    exit: float  # time of its exit, s
    exit_s: float  # its solution S and E there
    exit_e: float
    late: float  # rounding error of a phase's duration, s
    p_rest: float  # rests of compensated summation below the last digits of p and w
    w_rest: float
    piece: float  # of the last Taylor step on a measured curve
    degree: float  # number of its terms


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
    """Return a buffer of zeros, for interpreted or for compiled calls."""
    if not compiled:
        return [0.0] * number
    import numpy

    return numpy.zeros(number)


def new_record(kind: type[R], *, compiled: bool) -> R:
    """Return a record of zeros with the fields of ``kind``, a dataclass of numbers and series."""
    if not compiled:
        return kind(*([0.0] * COEFFICIENTS if is_series else 0.0 for is_series in list_fields(kind).values()))
    import numpy

    return numpy.zeros((), numpy_type(kind)).view(numpy.recarray)  # type: ignore[return-value]  # has the fields


def unboxed(record: R) -> R:
    """Return the record that a kernel reads and writes; in compiled code, taken out of the array of `new_record`."""
    return record


def list_fields(kind: type[Any]) -> dict[str, bool]:
    """Return the names of a record's fields, and whether each is a series."""
    if kind not in _SHAPES:
        _SHAPES[kind] = {field.name: field.type is Series for field in fields(kind)}
    return _SHAPES[kind]


def numpy_type(kind: type[Any]) -> Any:
    if kind not in _TYPES:
        import numpy

        shapes = {name: (COEFFICIENTS,) if is_series else () for name, is_series in list_fields(kind).items()}
        _TYPES[kind] = numpy.dtype([(name, "f8", shape) for name, shape in shapes.items()], align=True)
    return _TYPES[kind]


def copy_for_compiled(record: R) -> R:
    """Return an interpreted record's numbers as a record for compiled kernels."""
    copy = new_record(type(record), compiled=True)
    for name in list_fields(type(record)):
        setattr(copy, name, getattr(record, name))
    return copy
