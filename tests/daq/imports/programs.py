"""Tables as programs write them, each by its published form: columns of numbers with names and units, into a file."""

import h5py
import numpy as np

SEPARATORS = {"\t": "Tab", ",": "Comma"}


def lvm(
    path, columns, *, x_columns="One", multi=False, decimal=".", separator="\t", segments=1, restart=False, version="2"
):
    """Write a LabVIEW measurement; ``columns`` are (name, unit, values), the first one the times."""
    (_, _, time), *channels = columns
    n = len(time)
    head = [("LabVIEW Measurement",), ("Writer_Version", version), ("Reader_Version", version)]
    head += [("Separator", SEPARATORS[separator])]
    head += [("Decimal_Separator", decimal)] if version == "2" else []
    head += [("Multi_Headings", "Yes" if multi else "No"), ("X_Columns", x_columns), ("Time_Pref", "Relative")]
    head += [("Operator", "lab"), ("Date", "2019/07/22"), ("Time", f"17:18:18{decimal}5"), ("***End_of_Header***", "")]
    lines = [separator.join(row) for row in head] + [separator]

    def number(value):
        return f"{value:.6f}".replace(".", decimal)

    def each(*cells):
        gap = separator if x_columns == "Multi" else ""
        return separator.join(f"{cell}{gap}" for cell in cells)

    size = n // segments
    for part in range(segments):
        own = slice(part * size, (part + 1) * size)
        begun = time[own.start] if restart else 0.0
        if part == 0 or multi:
            clock = f"{18.5 + (begun if restart else 0):09.6f}".replace(".", decimal)
            lines += [
                f"Channels{separator}{len(channels)}",
                f"Samples{separator}{each(*[str(size)] * len(channels))}",
                f"Date{separator}{each(*['2019/07/22'] * len(channels))}",
                f"Time{separator}{each(*[f'17:18:{clock}'] * len(channels))}",
                f"Y_Unit_Label{separator}{each(*(unit for _, unit, _ in channels))}",
                f"X_Dimension{separator}{each(*['Time'] * len(channels))}",
                f"X0{separator}{each(*[number(time[own.start] - begun)] * len(channels))}",
                f"Delta_X{separator}{each(*[number(time[1] - time[0])] * len(channels))}",
                f"***End_of_Header***{separator}",
            ]
            names = [name for name, _, _ in channels]
            between = f"{separator}X_Value{separator}" if x_columns == "Multi" else separator
            lines.append(separator.join(["X_Value", between.join(names), "Comment"]))
        for k in range(own.start, own.stop):
            values = [number(channel[k]) for _, _, channel in channels]
            x = number(time[k] - begun)
            if x_columns == "No":
                lines.append(separator.join(["", *values]))
            elif x_columns == "Multi":
                lines.append(separator.join(f"{x}{separator}{value}" for value in values))
            else:
                lines.append(separator.join([x, *values]) + (f"{separator}begun" if k == own.start else ""))
        lines.append("")
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    return path


def xlsx(path, columns, *, above=(), units_below=False, others=()):
    """Write a workbook of openpyxl; ``above`` are lines of text above the table, ``others`` sheets without one."""
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    sheet.title = "Messung 1"
    for text in above:
        sheet.append([text])
    sheet.append([name if units_below or not unit else f"{name} ({unit})" for name, unit, _ in columns])
    if units_below:
        sheet.append([unit for _, unit, _ in columns])
    for row in zip(*(values for _, _, values in columns), strict=True):
        sheet.append([float(value) for value in row])
    for name in others:
        book.create_sheet(name).append(["notes", "nothing"])
    book.save(path)
    return path


def tdms(path, columns, *, waveform=True, group="Measured"):
    """Write a TDMS file of npTDMS: times as the waveform of each channel, or as a channel of their own."""
    from nptdms import ChannelObject, RootObject, TdmsWriter

    (t_name, t_unit, time), *channels = columns
    how = {"wf_increment": float(time[1] - time[0]), "wf_start_offset": float(time[0]), "wf_samples": len(time)}
    made = []
    if not waveform:
        made.append(ChannelObject(group, t_name, np.asarray(time), {"unit_string": t_unit}))
    for name, unit, values in channels:
        made.append(ChannelObject(group, name, np.asarray(values), (how if waveform else {}) | {"unit_string": unit}))
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({"name": "a rig"}), *made])
    return path


def mat5(path, columns, *, struct=""):
    """Write a MATLAB file of version 5."""
    from scipy.io import savemat

    found = {name: np.asarray(values)[:, None] for name, _, values in columns}
    savemat(path, {struct: found} if struct else found)
    return path


def mat73(path, columns, *, struct=""):
    """Write a MATLAB file of version 7.3: HDF5 behind a header of 512 bytes, vectors transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        inside = file.create_group(struct) if struct else file
        if struct:
            inside.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, _, values in columns:
            made = inside.create_dataset(name, data=np.asarray(values)[None, :])
            made.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("note", data=np.array([[104], [105]], np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def text(path, columns, *, delimiter=",", decimal=".", units="brackets", above=(), end="\n", encoding="utf-8"):
    """Write a table of text; ``units`` stand in brackets behind the names, in a line of their own, or nowhere."""
    names = [name for name, _, _ in columns]
    if units == "brackets":
        names = [f"{name} ({unit})" if unit else name for name, unit, _ in columns]
    lines = [*above, delimiter.join(names)]
    lines += [delimiter.join(unit or "-" for _, unit, _ in columns)] if units == "below" else []
    for row in zip(*(values for _, _, values in columns), strict=True):
        lines.append(delimiter.join(f"{value:.9g}".replace(".", decimal) for value in row))
    path.write_bytes((end.join(lines) + end).encode(encoding))
    return path


def tracker(path, columns, *, decimal="."):
    """Write the export of the program Tracker: the mass's name, names without units, tabs."""
    return text(path, columns, delimiter="\t", decimal=decimal, units="", above=["mass A"])


def kinovea(path, x, y, rate_hz, *, codes=True, decimal="."):
    """Write the trajectories' text of the program Kinovea: names in a comment; time codes with hundredths, or ms."""
    lines = ["#Kinovea Trajectory data export", "#T X Y", *([] if codes else ["", "# Trajectory 1"])]
    for k, (a, b) in enumerate(zip(x, y, strict=True)):
        hundredths = int(100 * k / rate_hz)
        when = f"0:{hundredths // 6000:02d}:{hundredths // 100 % 60:02d}:{hundredths % 100:02d}"
        when = when if codes else f"{1e3 * k / rate_hz:.3f}".replace(".", decimal)
        lines.append(" ".join([when, *(f"{value:.2f}".replace(".", decimal) for value in (a, b))]) + " ")
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("latin-1"))
    return path


def numpy_text(path, columns):
    """Write a table of numpy.savetxt, its header a comment."""
    header = " ".join(f"{name}_{unit}" if unit else name for name, unit, _ in columns)
    np.savetxt(path, np.c_[tuple(values for _, _, values in columns)], header=header, fmt="%.9g")
    return path
