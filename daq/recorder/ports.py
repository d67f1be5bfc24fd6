"""Ports: open one by its name or URL, list those present, and explain why one cannot be opened.

A port is anything pyserial opens: ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``, ``rfc2217://host:port``,
``loop://``, and ``rig://SCENE``, the simulated rig.  pyserial finds the handler of the last one by name: this package
never imports the simulator.  A device is opened by one program at a time, as far as the others ask for its lock.
"""

import contextlib
import errno
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast
from urllib.parse import quote, unquote

from daq.protocols.session import Port
from stickslip.errors import DeviceError, InputError

SIMULATED_RIG = "rig://rig"
LONGEST_SHOWN = 100  # characters of a port in a message
# The schemes that are opened.  pyserial knows more: spy:// writes to a file that the URL names, and the URL may come
# from somebody else's rig.toml.
SCHEMES = ("rig", "socket", "rfc2217", "loop")
REMOTE_LINE = "rfc2217://"
BAUD = 115_200
READ_TIMEOUT_S = 0.1
WRITE_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class PortInfo:
    """A port of this machine: its name, the system's description, whether it can be opened, and what to do if not."""

    port: str
    description: str
    usable: bool
    do: str = ""


def rig_url(scene: str, changes: list[str], realtime: bool) -> str:
    """Return the URL of the simulated rig: a built-in scene or a TOML file, with ``section.key=value`` changes."""
    query = [f"set={quote(change, safe='')}" for change in changes] + ["realtime=1"] * realtime
    return f"rig://{quote(scene, safe='')}" + ("?" + "&".join(query) if query else "")


def shorten_url(url: str) -> str:
    """Return a port for people: the changes of a simulated rig as they were typed, cut off where they are long."""
    words = unquote(url) if url.startswith("rig://") else url
    return words if len(words) <= LONGEST_SHOWN else f"{words[: LONGEST_SHOWN - 3]}..."


def waits_for_reader(url: str) -> bool:
    """Return whether a port produces bytes only when read: the simulated rig outside real time, and no other."""
    return url.startswith("rig://") and "realtime=1" not in url.partition("?")[2].split("&")


def open_port(url: str, baud: int = BAUD) -> Port:
    """Open a port for reading and writing; reads return after `READ_TIMEOUT_S` with the bytes that came."""
    import serial

    do = "use a device ('daq ports' lists them), rig://SCENE, socket://HOST:PORT, rfc2217://HOST:PORT or loop://"
    scheme, address, _ = url.partition("://")
    if address and scheme.lower() not in SCHEMES:
        raise InputError(f"{scheme}:// is not a supported kind of port", url, do)
    if "rig_sim" not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append("rig_sim")
    # Two readers of one device would each get a part of the bytes.
    opened = partial(serial.serial_for_url, url, baudrate=baud, timeout=READ_TIMEOUT_S, exclusive=True)
    if not url.lower().startswith(REMOTE_LINE):  # that one raises NotImplementedError, after it has connected
        opened = partial(opened, write_timeout=WRITE_TIMEOUT_S)
    try:
        port = opened()
    except (ValueError, LookupError) as error:  # raised by pyserial for an unknown setting in the URL
        raise InputError(f"this kind of port cannot be opened: {error}", url, do) from error
    except OSError as error:  # SerialException is a subclass
        raise DeviceError(*explain_refusal(url, error)) from error
    _ask_for_low_latency(port)
    return cast(Port, port)


def _ask_for_low_latency(port: object) -> None:
    """Ask the driver of a USB serial chip (on Linux) to pass bytes on within 1 ms, not 16 ms."""
    ask = getattr(port, "set_low_latency_mode", None)
    if ask is not None:
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            ask(True)


def line_baud(url: str, port: Port) -> int | None:
    """Return the baud rate that limits a port, also of a ttyACM, often a second chip's line; None for a URL."""
    if "://" in url and not url.lower().startswith(REMOTE_LINE):
        return None
    baud: int | None = getattr(port, "baudrate", None)
    return baud


def uart_baud(url: str, port: Port) -> int | None:
    """Return the baud rate at which bytes pass one after the other; None for a URL or a pseudo-terminal."""
    return None if "://" in url or os.path.realpath(url).startswith("/dev/pts/") else line_baud(url, port)


def explain_refusal(url: str, error: OSError) -> tuple[str, str, str]:
    """Return why a port could not be opened, its name, and what to do."""
    device = Path(url)
    code = error.errno
    if code == errno.EACCES or (device.exists() and not _is_allowed(device)):
        return "no permission to open this port", url, permission_fix(device)
    if code == errno.EBUSY or "exclusively lock" in str(error):
        return "another program is using this port", url, "close that program (a serial monitor?) and try again"
    if code == errno.ENOENT or (url.startswith("/dev/") and not device.exists()):
        return "no such port", url, f"connect the board; {_list_present()}"
    if "://" in url:
        return f"cannot connect: {error}", url, "check the address, and that the program at the other end is running"
    return f"cannot open this port: {error}", url, f"check the name; {_list_present()}"


def list_ports() -> list[PortInfo]:
    """Return the serial devices of this machine, and the simulated rig, which is always present."""
    from serial.tools.list_ports import comports

    ports = [PortInfo(SIMULATED_RIG, "simulated rig, which 'daq record' uses if no --port is given", True)]
    for info in sorted(comports()):
        device = Path(info.device)
        usable = os.name == "nt" or _is_allowed(device)
        if info.description in ("n/a", "", None) and info.hwid in ("n/a", "", None) and not usable:
            continue  # a port of the machine itself with nothing behind it
        description = (
            info.description if info.description not in ("n/a", None) else "serial port without further information"
        )
        ports.append(PortInfo(info.device, description, usable, "" if usable else permission_fix(device)))
    return ports


def permission_fix(device: Path) -> str:
    """Return the exact command that gives this user the right to open ``device``."""
    user = _get_user()
    try:
        import grp

        status = device.stat()
        group = grp.getgrgid(status.st_gid).gr_name
    except (ImportError, OSError, KeyError):
        return f"ask for read and write permission on {device}"
    # Joining the group helps only where the group may read and write; otherwise an administrator must grant it.
    if status.st_mode & 0o060 == 0o060 and group != "root":
        return f"run 'sudo usermod -a -G {group} {user}', then log out and in again"
    return f"run 'sudo chmod a+rw {device}' (until it is unplugged)"


def _is_allowed(device: Path) -> bool:
    return os.access(device, os.R_OK | os.W_OK)


def _get_user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "$USER"


def _list_present() -> str:
    devices = [info.port for info in list_ports() if info.port != SIMULATED_RIG]
    return f"ports here: {', '.join(devices)}" if devices else "no serial port is connected; see 'daq ports'"
