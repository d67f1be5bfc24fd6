"""The kernels compiled by numba, from the very source that runs interpreted; numba loads on the first request.

Every kernel function is registered as jitable, then the entry is compiled: no second source, no fast-math.  Machine
code is kept in a folder named by a hash of the kernels' sources, so a changed installation never meets a stale cache.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

from daq.compute.compile import build, cache_folder, register

KERNEL_MODULES = (
    "rig_sim.friction.curve",
    "rig_sim.integrate.newton",
    "rig_sim.integrate.modes",
    "rig_sim.integrate.flow",
    "rig_sim.integrate.frame",
    "rig_sim.integrate.buffer",
    "rig_sim.integrate.contact_state",
    "rig_sim.integrate.linear",
    "rig_sim.integrate.taylor",
    "rig_sim.integrate.driven",
    "rig_sim.integrate.phases",
)

# Division by zero gives an infinity, which ends a run as `not finite`.  No kernel makes an array, so numba need not
# count references to them (_nrt): at every call from kernel to kernel that costs as much as the arithmetic.
JIT_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

ENTRIES = {
    "initial_mode": "rig_sim.integrate.contact_state",
    "force": "rig_sim.integrate.contact_state",
    "next_event": "rig_sim.integrate.phases",
    "next_turn": "rig_sim.integrate.phases",
    "sample_phase": "rig_sim.integrate.phases",
    "sample": "rig_sim.integrate.phases",
    "run": "rig_sim.integrate.phases",
}


def compiled(name: str) -> Callable[..., Any]:
    """Return the compiled kernel ``name``; called like the plain one, with arrays for buffers.

    Raises
    ------
    ValueError
        For a name that is not an entry.
    """
    if name not in ENTRIES:
        raise ValueError(f"{name!r} is no kernel; known: {', '.join(ENTRIES)}")
    return compile_entry(getattr(import_module(ENTRIES[name]), name))


@cache
def compile_entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` compiled; it may call any kernel, helpers registered with `JIT_OPTIONS`, and make no array.

    The first call of a function whose machine code is not yet cached says on stderr that it compiles.
    """
    register_kernels()
    return build(function, cache_folder((*KERNEL_MODULES, function.__module__, __name__)), **JIT_OPTIONS)


def register_kernels() -> None:
    """Make every kernel function callable from compiled code."""
    for name in KERNEL_MODULES:
        register(name, forceinline=True, **JIT_OPTIONS)
