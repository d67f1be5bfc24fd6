"""What a run file from somebody else may hold: everything in the file itself, and no more than fits into it.

HDF5 can name other files of the computer as the content of a dataset, and declare data of any size.
"""

from pathlib import Path

import h5py

from daq.errors import InputError

DO = "do not trust this file; ask who made it"
# Bytes of data per byte of file: deflate reaches at most 1032.  More has never been written.
MOST_EXPANSION = 1100
FREE_BYTES = 1 << 20  # of a dataset that is not checked against the file's size
MOST_OBJECTS = 10_000  # a run file with all its stages has about 200


def check(file: h5py.File, path: Path) -> None:
    """Refuse a file that leads to other files, or declares more data than it can hold.

    Parameters
    ----------
    file : h5py.File
        Open for reading.
    path : Path
        The file, for its size and for the message.

    Raises
    ------
    InputError
        An external link, external storage, a virtual dataset, a dataset larger than the file can hold, or more
        objects than any run has.
    """
    names: list[bytes] = []

    # What these return ends the visit; h5py does not survive an exception in them.
    def wrong_link(name: bytes, info: h5py.h5l.LinkInfo) -> str | None:
        names.append(name)
        if info.type == h5py.h5l.TYPE_EXTERNAL:
            return f"/{name.decode(errors='replace')} is a link to another file"
        return f"holds more than {MOST_OBJECTS} objects" if len(names) > MOST_OBJECTS else None

    def wrong_object(name: bytes, info: h5py.h5o.ObjInfo) -> str | None:
        if info.type != h5py.h5o.TYPE_DATASET:
            return None
        here = f"/{name.decode(errors='replace')}"
        found = h5py.h5o.open(file.id, name)
        made = found.get_create_plist()
        if made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count():
            return f"{here} reads its data from another file"
        held = found.get_space().get_simple_extent_npoints() * found.get_type().get_size()
        return f"{here} declares {held} bytes in a file of {size}" if held > most else None

    size = path.stat().st_size
    most = max(FREE_BYTES, MOST_EXPANSION * size)
    # The functions of h5py's low level: a run file has a hundred objects, and each costs a tenth there.
    what = file.id.links.visit(wrong_link, info=True) or h5py.h5o.visit(file.id, wrong_object, info=True)
    if what:
        raise InputError(what, str(path), DO)
