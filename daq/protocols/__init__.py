"""Protocols between a board and the host, one module each, imported when it is used.

========  ==================  =======================================================================================
name      module              used by
========  ==================  =======================================================================================
frames    protocols.frames    stickslip firmware, and the simulated rig: binary frames, CRC (docs/reference/wire.md)
qsb       protocols.qsb       US Digital's QSB quadrature-to-USB adapter: ASCII, at most 512 Hz
text      protocols.text      any sketch that prints a line of numbers per sample; declared columns, or labels
========  ==================  =======================================================================================

The header of a journal names its protocol.  `daq.protocols.session` defines the interface of each module.
"""

from typing import TYPE_CHECKING, cast

from stickslip.errors import check_known

if TYPE_CHECKING:
    from daq.protocols.session import Backend

PROTOCOLS = {
    "frames": "daq.protocols.frames",
    "qsb": "daq.protocols.qsb",
    "text": "daq.protocols.text",
}


def load(name: str, where: str = "--protocol") -> "Backend":
    """Return a protocol's module; InputError for an unknown name."""
    from importlib import import_module

    check_known(name, list(PROTOCOLS), "protocol", where)
    return cast("Backend", import_module(PROTOCOLS[name]))
