"""Captures of a logic analyser in sigrok's .sr format, read as a stream.

A .sr file is a zip of ``metadata`` (ini text: sample rate, unit size, probe names) and the logic samples, one entry
``logic-1`` or several ``logic-1-1``, ``logic-1-2`` ... which follow each other by number, not by name.  A sample is
``unitsize`` bytes, little endian; bit n is probe n + 1 of the metadata.

A probe is called by its name, or by its index numbered from 0 (its bit); where a name looks like an index (probes
called 0 to 7), the name counts.  Not read: analog channels, compressed formats other than the zip's own.
"""

import configparser
import errno
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.runfile.regular import open_regular
from stickslip.errors import InputError, nearest

MOST_METADATA = 1 << 20  # bytes; a capture of 16 channels has 500
PIECE = 1 << 18  # bytes read at a time; what is made of larger pieces is given back to the system each time
# What zipfile raises for a damaged archive; OSError with EINVAL for a place before the file's beginning.
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, UnicodeDecodeError, OSError)
SLOWEST_HZ, FASTEST_HZ = 1e-3, 1e12  # sampling rates of a logic analyser, with room on both sides
_RATE = re.compile(r"(\d++(?>\.\d++)?+)\s*+([kKmMgG]?+)\s*+(?>[hH][zZ])?+")
_PREFIX = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}


@dataclass(frozen=True)
class Capture:
    """A capture, its samples still on disk."""

    path: Path  # the file
    probes: dict[int, str]  # name of each probe by its bit
    unitsize: int  # bytes a sample
    rate_hz: float | None  # sample rate; None where the metadata do not state it
    samples: int  # how many
    # Year, month, day, hour, minute, second at which the capture was written, in a zone that the file does not state
    stamp: tuple[int, int, int, int, int, int]
    entries: tuple[str, ...]  # names of the zip entries with the samples, in order

    @property
    def listed(self) -> str:
        return ", ".join(f"{bit} {name}" for bit, name in self.probes.items())

    def bit(self, probe: str, flag: str) -> int:
        """Return the bit of a probe called by name or index."""
        for bit, name in self.probes.items():
            if name == probe:
                return bit
        if probe.isdecimal() and int(probe) in self.probes:
            return int(probe)
        near = nearest(probe, tuple(self.probes.values()))
        do = (near + " " if near.startswith("did") else "") + f"the capture has: {self.listed}"
        raise InputError(f"{flag}: the capture has no probe {probe!r}", str(self.path), do)

    def levels(self, *bits: int) -> Iterator[NDArray[np.uint8]]:
        """Yield the samples chunk by chunk: bit i of each value is the level of the i-th probe of ``bits``."""
        rest = b""
        with _open_zip(self.path) as archive:
            for entry in self.entries:
                with archive.open(entry) as stream:
                    while piece := stream.read(PIECE):
                        data = rest + piece if rest else piece
                        whole = len(data) - len(data) % self.unitsize
                        rest = data[whole:]
                        yield _extract_bits(np.frombuffer(data, np.uint8, whole), bits, self.unitsize)
        if rest:
            raise InputError("ends within a sample", str(self.path), "copy the capture again from its source")


def _extract_bits(data: NDArray[np.uint8], bits: tuple[int, ...], unitsize: int) -> NDArray[np.uint8]:
    out = np.zeros(data.size // unitsize, np.uint8)
    for position, bit in enumerate(bits):
        out |= ((data[bit // 8 :: unitsize] >> (bit % 8)) & 1) << position
    return out


def read(path: Path) -> Capture:
    """Read the metadata of a capture; its samples stay on disk."""
    where = str(path)
    with _open_zip(path) as archive:
        names = archive.namelist()
        if "metadata" not in names:
            raise InputError("is a zip without 'metadata', not a sigrok capture", where, "use a .sr file")
        packed = {info.compress_type for info in archive.infolist()}
        if not packed <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            raise InputError(
                "uses a compression method that sigrok does not use", where, "compress it again with the method deflate"
            )
        if archive.getinfo("metadata").file_size > MOST_METADATA:
            raise InputError(f"has over {MOST_METADATA} bytes of metadata", where, "copy the capture again")
        device = _parse_metadata(archive.read("metadata"), where)
        base = device.get("capturefile", "logic-1")
        entries = _order_entries(names, base, where)
        size = sum(archive.getinfo(name).file_size for name in entries)
        stamp = archive.getinfo(entries[0]).date_time
        if not (1 <= stamp[1] <= 12 and 1 <= stamp[2] <= 31):
            stamp = (1980, 1, 1, 0, 0, 0)  # a zip without dates
    probes = _name_probes(device, where)
    unitsize = _read_whole(device, "unitsize", where) or 1 + max(probes) // 8
    if max(probes) >= 8 * unitsize:
        raise InputError(f"names probe {max(probes) + 1} in samples of {unitsize} bytes", where, "capture again")
    if size // unitsize == 0:
        raise InputError("has no logic samples", where, "capture again")
    return Capture(path, probes, unitsize, _read_rate(device, where), size // unitsize, stamp, entries)


@contextmanager
def _open_zip(path: Path) -> Iterator[zipfile.ZipFile]:
    where = str(path)
    try:
        with open_regular(path, "choose a .sr file in it") as file, zipfile.ZipFile(file) as archive:
            yield archive
    except DAMAGE as error:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:
            raise
        with path.open("rb") as stream:
            head = stream.read(2)
        if head != b"PK":
            raise InputError("is not a sigrok capture (not a zip file)", where, "use a .sr file") from error
        what = f"is damaged or cut short ({error})"
        raise InputError(what, where, "copy the capture again from its source") from error


def _parse_metadata(text: bytes, where: str) -> dict[str, str]:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    # A line of its own is a key, even where it is indented: a parser of ini files takes it for more of the value above.
    lines = [line.strip() for line in text.decode("utf-8", "replace").splitlines()]
    try:
        parser.read_string("\n".join(lines))
    except configparser.Error as error:
        what = f"has broken metadata: {' '.join(str(error).split())}"
        raise InputError(what, where, "copy the capture again from its source") from error
    devices = [dict(parser[name]) for name in parser.sections() if name.lower().startswith("device")]
    with_logic = [device for device in devices if "capturefile" in device]
    if not with_logic:
        raise InputError("has no logic samples (no capturefile in its metadata)", where, "capture digital channels")
    return with_logic[0]


def _order_entries(names: list[str], base: str, where: str) -> tuple[str, ...]:
    if base in names:
        return (base,)
    numbers = sorted({int(n[len(base) + 1 :]) for n in names if re.fullmatch(re.escape(base) + r"-[1-9]\d{0,8}", n)})
    if not numbers:
        raise InputError(f"has no logic samples (no {base} in the zip)", where, "capture digital channels")
    missing = next((expected for expected, number in enumerate(numbers, start=1) if number != expected), None)
    if missing is not None:
        what = f"lacks {base}-{missing} of {base}-1 to {base}-{numbers[-1]}"
        raise InputError(what, where, "copy the capture again from its source")
    return tuple(f"{base}-{number}" for number in numbers)


def _name_probes(device: dict[str, str], where: str) -> dict[int, str]:
    probes = {int(key[5:]) - 1: name for key, name in device.items() if re.fullmatch(r"probe[1-9]\d{0,3}", key)}
    if not probes:
        raise InputError("has no probe names in its metadata", where, "capture digital channels")
    return dict(sorted(probes.items()))


def _read_whole(device: dict[str, str], key: str, where: str) -> int | None:
    if key not in device:
        return None
    if not re.fullmatch(r"0*[1-9]\d{0,3}", device[key]):
        raise InputError(f"has {key} = {device[key]!r} in its metadata", where, "copy the capture again")
    return int(device[key])


def _read_rate(device: dict[str, str], where: str) -> float | None:
    text = device.get("samplerate", "").strip()
    if not text or text == "0":
        return None
    parts = _RATE.fullmatch(text)
    rate = float(parts[1]) * _PREFIX[parts[2].lower()] if parts else 0.0
    if not SLOWEST_HZ <= rate <= FASTEST_HZ:
        raise InputError(f"has samplerate = {text[:40]!r} in its metadata", where, "copy the capture again")
    return rate
