"""Text lines with measured numbers: positions and forces with decimals and signs, as counts of their last decimal."""

import numpy as np
import pytest

from daq.protocols import text
from daq.protocols.columns import parse_columns, with_decimals
from daq.protocols.request import RecordRequest
from daq.recorder import ports, record
from daq.runfile import store
from stickslip.errors import InputError
from stickslip.units import Measured
from tests.daq.protocols.test_lines import Sketch, xor_of


@pytest.mark.parametrize(
    ("declared", "lines", "decimals"),
    [
        ("t_us,x_mm", [b"1,21.04", b"2,21.1", b"3,20.999"], 3),
        ("t_us,x_mm", [b"1,21", b"2,22", b"3,23"], 0),
        ("t_us,x_m", [b"1,0.021", b"2,1e-05", b"3,-2.5e-4"], 5),
        ("t_us,x_mm", [b"1,21.040000000000003", b"2,21.1", b"3,20.9"], 5),  # as Python prints a float
        ("t_us,x_mm:1", [b"1,21.04", b"2,21.1", b"3,20.9"], 1),
        ("t_us,x_mm", [b"t=1 pos=21.04", b"t=2 pos=21.1", b"t=3 pos=20.9"], 2),
    ],
)
def test_decimals_that_are_not_declared_are_those_of_the_first_lines(declared, lines, decimals):
    form = with_decimals(declared, b"\n".join([b"cut", *lines, b""]))
    assert form.decimals == decimals
    assert parse_columns(form.declared).decimals == decimals


# Declared columns, and a line of sample k with a number in thousandths.
LINES = {
    "t_us,x_mm:3": lambda k, n: f"{2000 * k},{n / 1000:.3f}\n",
    "t_s,x_mm:3": lambda k, n: f"({2 * k // 1000}.{2 * k % 1000:03d}, {n / 1000:+.3f})\r\n",
    "seq,t_us,F_N:3": lambda k, n: f"{k}\t{2000 * k}\t{n / 1000:.3f}\n",
    "t_us,x_um:0": lambda k, n: f"us: {2000 * k}, x_um: {n}\n",
    "t_us,x_mm:4": lambda k, n: f"{2000 * k} {n / 1000:.3f}\n",  # not the declared decimals
    "t_us,-,x_mm:3": lambda k, n: f"{2000 * k} {k / 10} {n / 1000:.3f}\n",
    "t_us,x_mm:3,xor": lambda k, n: (s := f"{2000 * k},{n / 1000:.3f}") + f",{xor_of(s.encode()):02X}\n",
    "t_us,x_mm:3,a,b": lambda k, n: f"t={2000 * k} pos={n / 1000:.3f} a={k & 1} b=1\n",
}


@pytest.mark.parametrize("declared", LINES)
def test_sound_lines_give_their_numbers(declared):
    numbers = 1000 * np.sin(np.arange(100) / 9) // 1
    reader = text.make_reader(text.parse_columns(declared))
    batch = reader.feed(b"".join(LINES[declared](k, int(n)).encode() for k, n in enumerate(numbers)))
    found = batch.rows[:, 1]
    scale = 10 if declared == "t_us,x_mm:4" else 1
    np.testing.assert_array_equal(np.where(found >= 2**31, found - 2**32, found), scale * numbers[1:])
    np.testing.assert_array_equal(batch.rows[:, 0], 2000 * np.arange(1, 100))


def x_mm(k):
    return 21.04 + 5 * np.sin(np.asarray(k) * 0.01)


def recorded(tmp_path, monkeypatch, line, **wish):
    """Record lines of a sketch, and return the quality and the run."""
    monkeypatch.setattr(ports, "open_port", lambda url, baud: sketch)
    sketch = Sketch(line)
    sketch.close = lambda: None
    request = RecordRequest(port="fake", output=tmp_path / "run.h5", protocol="text", duration_s=2.0, **wish)
    return record.record(request), store.load(tmp_path / "run.h5")


@pytest.mark.parametrize(
    ("line", "declared"),
    [
        (lambda k: f"{2000 * k},{x_mm(k):.2f}\n", "t_us,x_mm"),
        (lambda k: f"({2000 * k}, {x_mm(k):.2f})\n", "t_us,x_mm"),
        (lambda k: f"t={2000 * k} pos={x_mm(k):.2f}\n", "t_us,x_mm"),
        (lambda k: f"t={2000 * k} pos_mm={x_mm(k):.2f} temp=20.5\n", None),
        (lambda k: f"t={2000 * k} distance_mm={x_mm(k):.2f}\n", None),
    ],
)
def test_positions_are_recorded_in_metres(tmp_path, monkeypatch, line, declared):
    found, run = recorded(tmp_path, monkeypatch, lambda k: line(k).encode(), columns=declared)
    assert (found.samples, found.lost, found.crc_errors, found.unit, run.rate_hz) == (1000, 0, 0, "m", 500)
    k = np.rint(run.raw.device_time / 2000).astype(int)
    np.testing.assert_allclose(run.position, 1e-3 * np.round(x_mm(k), 2), atol=1e-9)
    assert run.rig.metres_per_count == Measured(pytest.approx(1e-5))


def test_a_force_is_the_stretch_of_its_spring(tmp_path, monkeypatch):
    line = lambda k: f"{2000 * k} {x_mm(k) / 10:.3f}\n".encode()  # noqa: E731
    with pytest.raises(InputError, match="the stiffness of its spring is not known"):
        recorded(tmp_path, monkeypatch, line, columns="t_us,F_N")
    stiffness = {"stiffness": Measured(100.0, 1.0)}
    _, run = recorded(tmp_path, monkeypatch, line, columns="t_us,F_N", stated=stiffness)
    k = np.rint(run.raw.device_time / 2000).astype(int)
    np.testing.assert_allclose(run.position, np.round(x_mm(k) / 10, 3) / 100, atol=1e-9)
    assert run.rig.metres_per_count == Measured(pytest.approx(1e-5), pytest.approx(1e-7))
    assert run.rig.stiffness == Measured(100.0, 1.0)


def test_decimals_without_a_unit_are_counts_and_said_to_be(tmp_path, monkeypatch):
    line = lambda k: f"t={2000 * k} pos={x_mm(k):.2f}\n".encode()  # noqa: E731
    found, run = recorded(tmp_path, monkeypatch, line)
    assert run.unit == "count"
    assert np.ptp(run.count) == pytest.approx(1000, abs=2)
    assert any(
        "the positions have no unit, so they are recorded as counts of 0.01 of the unit" in text
        for text in found.warnings
    )
    assert any("--columns t_us,x_mm:2" in text for text in found.warnings)


def test_metres_per_count_beside_a_unit_are_refused(tmp_path, monkeypatch):
    stated = {"metres_per_count": Measured(1e-5)}
    with pytest.raises(InputError, match="positions have a unit"):
        recorded(
            tmp_path, monkeypatch, lambda k: f"{2000 * k} {x_mm(k):.2f}\n".encode(), columns="t_us,x_mm", stated=stated
        )
