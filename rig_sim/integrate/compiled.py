"""The integrator's kernels compiled: which modules they are, and with which of numba's options.

`compiled` returns any kernel, or a function of another module that calls kernels, as machine code.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from rig_sim.flow.flow import Flow
from stickslip.compute import compile as kernels

KERNEL_MODULES = (
    "rig_sim.friction.curve",
    "rig_sim.friction.spline",
    "rig_sim.integrate.newton",
    "rig_sim.flow.modes",
    "rig_sim.flow.flow",
    "rig_sim.flow.frame",
    "rig_sim.integrate.work",
    "rig_sim.flow.contact_state",
    "rig_sim.integrate.linear",
    "rig_sim.integrate.polynomial",
    "rig_sim.integrate.taylor",
    "rig_sim.integrate.driven",
    "rig_sim.integrate.phases",
)

# Division by zero gives an infinity, which ends a run as `not finite`.  No kernel makes an array, so numba need not
# count references to them (_nrt): at every call from kernel to kernel that costs as much as the arithmetic.  Other
# threads run meanwhile (nogil): the one that hands tasks to processes would keep them waiting, 3 % of a sweep.
JIT_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False, "nogil": True}


@cache
def compiled(function: Callable[..., Any], *modules: str, inline: bool = True) -> Callable[..., Any]:
    """Return ``function`` compiled; it may call any kernel and any function of ``modules``, and make no array.

    Kernels written into their callers (``inline``) list events 1.15 to 1.3 times as fast; without, they compile in
    three quarters of the time, and a fit, which spends its time within kernels, is as fast.
    """
    unbox_records()
    options = {**JIT_OPTIONS, "forceinline": True} if inline else JIT_OPTIONS
    return kernels.compiled(function, (*KERNEL_MODULES, *modules), **options)


@cache
def unbox_records() -> None:
    """Let compiled code call `rig_sim.integrate.work.unboxed`."""
    from numba.core import types
    from numba.extending import overload

    from rig_sim.integrate.work import unboxed

    @overload(unboxed)
    def record_of(record):  # type: ignore[no-untyped-def]
        return (lambda record: record[()]) if isinstance(record, types.Array) else (lambda record: record)


def for_kernels(flow: Flow) -> Flow:
    """Return the flow for compiled kernels: a measured curve's table is an array."""
    if flow.pieces == 0:
        return flow
    import numpy

    return flow._replace(table=numpy.array(flow.table))
