"""Records of a QSB and text lines: read as declared, damage seen as far as it can be, refusals with their cure."""

import re
import time

import numpy as np
import pytest

from daq import protocols
from daq.protocols import neighbours, qsb, text
from daq.protocols import session as session_module
from daq.protocols.columns import LineParser
from daq.protocols.lines import NoSample
from daq.protocols.request import RecordRequest
from daq.protocols.session import Plan, decode_whole
from stickslip.errors import DeviceError, InputError


def motion(k):
    return np.floor(20_000 * np.sin(np.asarray(k) * 0.005)).astype(np.int64)


def xor_of(line):
    total = 0
    for byte in line:
        total ^= byte
    return total


def qsb_line(k):
    return f"s0E{int(motion(k)) % 2**32:08X}{k % 2**32:08X}!\n".encode()


def text_line(k):
    return f"{2000 * k + 7},{int(motion(k))}\n".encode()


def checked_line(k):
    line = f"{2000 * k + 7},{int(motion(k))}".encode()
    return line + f",*{xor_of(line):02X}\n".encode()


FORMS = {
    "qsb": (qsb_line, {"protocol": "qsb", "rate_hz": 512.0}, 1 / 512),
    "text": (text_line, {"protocol": "text", "columns": "t_us,count", "rate_hz": 500.0}, 1 / 500),
    "xor": (checked_line, {"protocol": "text", "columns": "t_us,count,xor", "rate_hz": 500.0}, 1 / 500),
}


@pytest.fixture(params=list(FORMS))
def form(request):
    line, header, period_s = FORMS[request.param]

    def decode(data, cut=4096):
        reads = [(at, data[at : at + cut]) for at in range(0, len(data), cut)]
        return decode_whole(protocols.load(header["protocol"]), reads, header)

    return request.param, line, decode, period_s


def counts(stream):
    width = 2**stream.ident.counter_bits
    net = (stream.up.astype(np.int64) - stream.down.astype(np.int64)) % width
    return np.where(net >= width // 2, net - width, net)


def test_a_million_corrupted_bytes_are_survived(form, damaged):
    """What passes unseen: without a checksum a flipped digit of little weight; with xor, 1 of 256 at most."""
    name, line, decode, period_s = form
    lines = 1_150_000 // len(line(50_000))
    sent, touched = damaged(list(map(line, range(lines))), 7)
    data = b"".join(sent)
    assert len(data) > 1_000_000
    stream = decode(data)
    assert stream.crc_errors > 0.5 * len(touched)
    period = round(period_s * 1e9 / stream.ident.tick_ns)
    k = (stream.ticks - (0 if name == "qsb" else 7)) / period
    whole = np.round(k).astype(int)
    right = (np.abs(k - whole) < 1e-9) & (counts(stream) == motion(whole))
    wrong = int(np.count_nonzero(~right))
    # Every line that was not touched, nor stands beside one that was, is there and right.
    sound = [k for k in range(8, lines) if not {k + 1, k, k - 1, k - 2} & touched]
    assert np.isin(sound, whole[right]).all()
    share = {"qsb": 0.012, "text": 0.035, "xor": 1 / 256}[name]
    assert wrong <= share * len(touched), wrong / len(touched)
    # What passed alone is wrong by little; two damaged lines side by side may vouch for each other.
    alone = np.array([k not in touched or not {k - 1, k + 1} & touched for k in whole.tolist()])
    assert np.abs(counts(stream) - motion(whole))[alone].max() <= neighbours.LEAP_COUNTS + 8 * 110


def test_a_qsb_in_any_reply_format_is_read():
    data = b"s0E0000000500000001!\r\ns 0E 00000006 00000002 !\ns0effffffff00000003!"
    stream = decode_whole(qsb, [(0, data)], {"rate_hz": 512.0})
    assert counts(stream).tolist() == [5, 6, -1]


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        ("t_us", "which columns are the counts"),
        ("up,down", "a column of times is required"),
        ("t_us,t_ms,count", "which column is the time"),
        ("t_us,up", "up and down"),
        ("t_us,up,down,count", "counts"),
        ("t_us,cuont", "did you mean 'count'"),
        ("t_us,count,count", "twice"),
        ("t_us,up:16,down", "different widths"),
        ("t_us,count:12", "not a valid counter width"),
        ("t_us,count,a", "only one of the two logic levels"),
        ("t_us,x_in", "unknown column 'x_in'"),
        ("t_us,x_mm:12", "'x_mm:12' is not a valid number of decimals; write x_mm:2 for two decimals; at most 9"),
        ("t_us,x_mm,F_N", r"which columns are the counts\?"),
        ("t_us,count,x_mm", "such as x_mm or F_N"),
    ],
)
def test_columns_that_cannot_be_read_are_refused(declared, said):
    with pytest.raises(InputError, match=said):
        text.parse_columns(declared)


@pytest.mark.parametrize(
    ("declared", "line", "row"),
    [
        ("t_us,up,down", b"1000,5,3", (1000, 5, 3)),
        ("ticks,ms", b" -7\t12 ", (12_000, 2**32 - 7, 0)),
        ("s,count", b"1.25; 9", (1_250_000, 9, 0)),
        ("t_s,count", b"0.000001999 9", (1, 9, 0)),
        ("t_us,count:16,a,b,illegal", b"4294967297,-1,1,1,3", (1, 65535, 0, 3, 3)),
        ("t_us,-,count", b"1,x=4,2", (1, 2, 0)),
        ("t_us,up:16,down:16", b"1,65536,0", NoSample.DAMAGED),
        ("t_us,count", b"1,2,3", NoSample.DAMAGED),
        ("t_us,count", b"1,2.5", NoSample.DAMAGED),
        ("t_us,count", b"-1,2", NoSample.DAMAGED),
        ("t_us,count,xor", b"10,2,1F", (10, 2, 0, 0, 0)),
        ("t_us,count,xor", b"10,3,1F", NoSample.DAMAGED),
        ("t_us,count,xor", b"10 2 13", (10, 2, 0, 0, 0)),
        ("t_us,count,xor", b"10\t2 \t*3A", (10, 2, 0, 0, 0)),
        ("t_us,count,xor", b"10 2 ; *13", (10, 2, 0, 0, 0)),
        ("t_us,count,xor", b"10 3 13", NoSample.DAMAGED),
        ("t_us,count", b"# a remark", NoSample.REMARK),
        ("t_us,count", b"\r", NoSample.REMARK),
        # By their labels.
        (None, b"t=123456 pos=789", (123_456, 789, 0)),
        (None, b"t:123456,pos:789\r", (123_456, 789, 0)),
        (None, b"time: 12, count: -3", (12, 2**32 - 3, 0)),
        (None, b"us = 5;count = 6", (5, 6, 0)),
        (None, b"Encoder:+6\tMillis:5", (5000, 6, 0)),
        (None, b"v=-1.5e3 , micros=7 state=ok;position=8,v=2", (7, 8, 0)),
        ("t_ms,count:16", b"T=4,Ticks=-1,temp=21.5", (4000, 65535, 0)),
        ("t_ms,count", b"us=4,counts=5", (4, 5, 0)),  # a unit in the label is the unit
        ("us,count", b"us=1,ms=2,pos=3,count=4", (1, 4, 0)),  # declared names come first
        ("t_us,up,down", b"down=1 up=2 time=3", (3, 2, 1)),
        ("t_us,count,a,b,illegal", b"illegal=3,a=1,b=0,t=4,pos=5", (4, 5, 0, 1, 3)),
        ("t_us,count,xor", b"t=10;pos=2, xor: *10", (10, 2, 0, 0, 0)),
        ("t_us,count,xor", b"t=10;pos=3, xor: *10", NoSample.DAMAGED),
        (None, b"t=1,pis=2", NoSample.DAMAGED),
        (None, b"t=1,pos=2.5", NoSample.DAMAGED),
        (None, b"t=1,pos=2,3", NoSample.DAMAGED),
        (None, b"t=1,pos=2,pos=2", NoSample.DAMAGED),
        (None, b"t=1,pos=2,Pos=2", NoSample.DAMAGED),
        (None, b"t=1,ms=1,pos=2", NoSample.DAMAGED),
        (None, b"t=1,pos=2t=3,pos=4", NoSample.DAMAGED),
        (None, b"1,2", NoSample.DAMAGED),
        (None, b"# t=1,pos=2", NoSample.REMARK),
        # A measured number counts its last decimal.
        ("t_us,x_mm:2", b"1000,21.04", (1000, 2104, 0)),
        ("t_us,x_mm:2", b"(1000, 21.04)", (1000, 2104, 0)),
        ("t_us,x_mm:2", b"[1000 -21.04]\r", (1000, 2**32 - 2104, 0)),
        ("t_us,x_mm:2", b"1000;+0.5", (1000, 50, 0)),
        ("t_us,x_mm:2", b"1000 -.05", (1000, 2**32 - 5, 0)),
        ("t_us,x_mm:2", b"1000 -0.05", (1000, 2**32 - 5, 0)),
        ("t_us,x_mm:2", b"1000 3", (1000, 300, 0)),
        ("t_us,x_mm:2", b"1000 3.14159", (1000, 314, 0)),
        ("t_us,x_m:6", b"1000 -1.5e-05", (1000, 2**32 - 15, 0)),
        ("t_us,x_um:0", b"1000 -17", (1000, 2**32 - 17, 0)),
        ("seq,t_us,F_N:3", b"7,1000,-0.125", (1000, 2**32 - 125, 0)),
        ("t_us,x_mm:2", b"t=1000 pos=21.04", (1000, 2104, 0)),
        ("t_us,x_mm:2", b"t: 1000, x: -21.04, y: 3", (1000, 2**32 - 2104, 0)),
        ("t_us,x_mm:2", b"t=1000 x=1 pos_mm=21.04", (1000, 2104, 0)),
        ("t_us,F_N:3", b"us=1000 load=1.5", (1000, 1500, 0)),
        ("t_us,x_mm:2", b"1000,nan", NoSample.DAMAGED),
        ("t_us,x_mm:2", b"1000,21.0.4", NoSample.DAMAGED),
        ("t_us,x_mm:2", b"1000,21,04", NoSample.DAMAGED),
        ("t_us,x_mm:6", b"1000,2148.0", NoSample.DAMAGED),  # beyond 32 bits
        ("t_us,x_mm:2", b"t=1000 x_m=0.02", NoSample.DAMAGED),  # another unit than the declared one
        ("t_us,x_mm:2", b"1000,1e99", NoSample.DAMAGED),
        ("seq,t_us,F_N:3", b"-3\t1000\t0.1", NoSample.DAMAGED),  # a number of a line has no sign
    ],
)
def test_a_line_is_read_as_its_columns_and_labels_say(declared, line, row):
    assert LineParser(text.parse_columns(declared)).read(line) == row


@pytest.mark.parametrize("shape", ["t=%d,pos=%d\n", "time: %d, count: %d, temp: 21.5\n"])
def test_damaged_labelled_lines_are_found(shape, damaged):
    lines, touched = damaged([(shape % (2000 * k + 7, motion(k))).encode() for k in range(8000)], 5)
    stream = decode_whole(text, [(0, b"".join(lines))], {"columns": None, "rate_hz": 500.0})
    k = (stream.ticks - 7) / 2000
    right = (k == np.round(k)) & (counts(stream) == motion(np.round(k)))
    assert np.count_nonzero(~right) <= 0.016 * len(touched)  # what passes of plain lines, by this damage
    near = np.add.outer(sorted(touched), np.arange(-1, 3))
    assert np.isin(np.setdiff1d(np.arange(8, 8000), near), k[right]).all()


def test_a_label_that_changes_is_damage():
    """Without its u, the label us means seconds."""
    lines = [b"us=%d,pos=%d\n" % (2000 * k, k) for k in range(100)]
    lines[40] = lines[40][1:]
    lines[60] = lines[60].replace(b"pos", b"Pos")
    stream = decode_whole(text, list(enumerate(lines)), {"columns": None, "rate_hz": 500.0})
    assert stream.stamp_ns.tolist() == [k for k in range(1, 100) if k not in (40, 60)]
    assert np.array_equal(stream.ticks, 2000 * stream.stamp_ns)


class Sketch:
    """A port on which a sketch prints by itself, so many bytes a read."""

    def __init__(self, line, baudrate=115_200):
        self.line, self.k, self.baudrate, self.in_waiting = line, 0, baudrate, 0

    def read(self, size=1):
        self.k += 40
        return b"".join(self.line(k) for k in range(self.k - 40, self.k))

    def write(self, data):
        raise AssertionError("nothing is said to a sketch")


def planned(line, wish):
    session = text.session(Sketch(line), "fake", wish)
    return session.plan(session.identify())


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (lambda k: b"millis:%d up:%d down:3 temp:%d.5\n" % (2 * k, k, k), "ms,up,down"),
        (lambda k: b"t=%d,pos=%d,a=%d,b=1,illegal=0\n" % (2000 * k, k, k & 1), "t_us,count,a,b,illegal"),
        (lambda k: b"t=%d,pos=%d,a=%d,b=1\n" % (2000 * k, k, k), "t_us,count"),  # an acceleration, no level
        (
            lambda k: b"# columns seq,t_us,-,count\n" * (k % 500 == 7) + b"%d,%d,x,%d\n" % (k, 2000 * k, k),
            "seq,t_us,-,count",
        ),
        (lambda k: b"# columns t_us,foo\n" * (k % 500 == 7) + b"t=%d,pos=%d,x=3\n" % (2000 * k, k), "t_us,count"),
    ],
)
def test_the_columns_of_labelled_lines_are_found_and_kept(line, found):
    session = text.session(Sketch(line), "fake", RecordRequest())
    assert session.plan(session.identify()).rate_hz == 500.0
    assert session.request.columns == found


@pytest.mark.parametrize("micros", [300, 1000, 1500, 2300])
def test_the_rate_of_a_coarse_clock_is_that_of_all_lines(micros):
    wish = RecordRequest(columns="ms,count")
    assert planned(lambda k: b"%d,7\n" % ((micros * k + 500) // 1000), wish).rate_hz == pytest.approx(
        1e6 / micros, rel=3e-3
    )


def test_the_rate_of_a_sketch_is_measured_and_another_is_refused_with_it():
    wish = RecordRequest(columns="t_us,count")
    assert planned(text_line, wish).rate_hz == 500.0
    assert planned(lambda k: b"%d,7\n" % (2013 * k), wish).rate_hz == pytest.approx(497, rel=2e-3)
    with pytest.raises(InputError, match="arrive at 500 Hz, not at 1000 Hz"):
        planned(text_line, RecordRequest(rate_hz=1000, columns="t_us,count"))


COUNTS = "t_us,count"


@pytest.mark.parametrize(
    ("columns", "line", "said"),
    [
        # Columns or labels are needed.
        (
            None,
            lambda k: b"t=%d,foo=%d\n" % (k, k),
            "labels t, foo, but none of them is a position; label .* pos, position, count",
        ),
        (None, lambda k: b"x=%d,pos=%d\n" % (k, k), "labels x, pos, but none of them is a time; .* micros"),
        (None, lambda k: b"t=%d,pos=1,count=2\n" % k, "more than one of them is a position; .* --columns"),
        (None, lambda k: b"%d,1\n" % k, "no columns are declared; .* --columns t_us,up,down"),
        (None, lambda k: b"t=%d x=%d.04 y=3\n" % (2000 * k, k), "the position has no unit; .* t_us,x_mm"),
        (None, lambda k: b"(%d, %d.04)\n" % (2000 * k, k), "no columns are declared; .* --columns t_us,x_mm"),
        # Something else is printed.
        (COUNTS, lambda k: b"Hello\n", "the lines, such as 'Hello', do not match the columns"),
        (COUNTS, lambda k: b"1,2,3,4\n", "do not match the columns t_us,count"),
        (COUNTS, lambda k: b"", "no data arrived"),
        (COUNTS, lambda k: b"77,5\n", "does not change"),
        (COUNTS, lambda k: b"%d,7\n" % (2003 * min(k, 400)), "does not change"),
        (COUNTS, lambda k: b"%d,5\n" % (10_000_000 - 2000 * k), "runs backwards, by 2000 us"),
    ],
)
def test_a_sketch_whose_lines_cannot_be_read_is_told_what_and_what_to_do(monkeypatch, columns, line, said):
    monkeypatch.setattr(session_module, "ANSWER_S", 0.1)
    with pytest.raises(DeviceError) as refused:
        planned(line, RecordRequest(columns=columns))
    assert re.search(said, refused.value.as_line())


def test_milliseconds_taken_for_microseconds_are_refused(monkeypatch):
    class Slow(Sketch):
        def read(self, size=1):
            time.sleep(0.04)
            return super().read()

    monkeypatch.setattr(session_module, "ANSWER_S", 0.4)
    with pytest.raises(DeviceError, match=r"advances by .* ms in .* s; .*columns t_ms"):
        text.session(Slow(lambda k: b"t=%d,pos=%d\n" % (k, k)), "fake", RecordRequest()).identify()


def test_an_endless_line_is_one_damaged_one(form):
    _, line, decode, _ = form
    good = b"".join(map(line, range(1, 20)))
    sound = decode(good)
    for cut_at in (100, 10_000):
        found = decode(good + b"7" * 5000, cut_at)
        assert found.crc_errors == 1
        assert np.array_equal(found.ticks, sound.ticks)


@pytest.mark.parametrize(
    ("columns", "line", "said"),
    [
        ("t_us,count", lambda k: b"%d,5\n" % (2000 * k), "exact if a timer triggers the samples"),
        ("t_us,count", lambda k: b"%d,5\n" % (2000 * k + 1000 * (k % 20 == 7)), "with errors up to 1 ms, so print"),
        ("ms,count", lambda k: b"%d,5\n" % (2.3 * k), "with errors up to 1 ms, so print"),
        ("t_us,count", lambda k: b"%d,5\n" % (2000 * k + 4 * (k % 20 == 7)), None),
    ],
)
def test_the_advice_about_whole_milliseconds_says_what_can_be_known(columns, line, said):
    notes = planned(line, RecordRequest(columns=columns)).notes
    assert len(notes) == (said is not None)
    assert said is None or said in notes[0]


def lines_of_a_reset(uptime_s, away_s, n=3000, reset=2000, rate=500):
    """Return the reads, as they come, of a sketch that has been up for some time and is reset after so many lines."""
    k = np.arange(n)
    since = k / rate + np.where(k < reset, 0.0, away_s)
    ticks = np.where(k < reset, 1e6 * (uptime_s + k / rate), 1e6 * (k - reset) / rate).astype(np.int64)
    lines = [f"{t % 2**32},{c}\n".encode() for t, c in zip(ticks.tolist(), motion(k).tolist(), strict=True)]
    return [(int(1e9 * (100 + since[a + 9])), b"".join(lines[a : a + 10])) for a in range(0, n, 10)]


@pytest.mark.parametrize("uptime_s", [600.0, 3000.0, 4260.0, 4294.0])
def test_a_reset_is_a_restart_however_long_the_sketch_was_up(uptime_s):
    # The step back of a clock of 32 bits is a step ahead after 36 minutes.
    reads = lines_of_a_reset(uptime_s, 0.3)
    stream = decode_whole(text, reads, {"columns": "t_us,count", "rate_hz": 500.0})
    assert stream.idents.tolist() == [1999]  # the first line of all is left out
    assert stream.seq[1998:2001].tolist() == [1998, 0, 1]
    sketch = text.session(Sketch(text_line), "fake", RecordRequest(columns="t_us,count"))
    sketch.prepare(Plan(500.0, 1, 0.0))
    tally = sketch.tally()
    for stamp, data in reads:
        tally.feed(data, stamp / 1e9)
    assert tally.resets == 1
    assert tally.reached <= 3000


def test_lines_that_a_stalled_host_reads_late_are_no_restart():
    # Of a process that was stopped for 20 s, the port keeps the first lines; what it could not hold is a gap.
    k = np.concatenate((np.arange(1000), np.arange(1000, 1200), np.arange(11_000, 12_000)))
    came_s = np.where((k >= 1000) & (k < 1200), 22.0, k / 500 + 0.001)
    reads = [(int(1e9 * s), text_line(each)) for s, each in zip(came_s.tolist(), k.tolist(), strict=True)]
    stream = decode_whole(text, reads, {"columns": "t_us,count", "rate_hz": 500.0})
    assert len(stream.idents) == 0
    assert int(stream.seq[-1]) == 11_999 - 1
