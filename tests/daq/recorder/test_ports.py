"""Ports and their limits: what will not open, or cannot carry the recording, is named with its cure."""

import errno
import os
import socket
import sys
from dataclasses import replace

import pytest
import serial

from daq.protocols import link_budget
from daq.protocols.frames import Frames
from daq.protocols.request import RecordRequest
from daq.protocols.session import Plan
from daq.recorder import ports
from daq.runfile.rig import Rig
from daq.wire.frames import Capability, Ident
from stickslip.errors import DeviceError, InputError
from stickslip.units import Measured

BOARD = Ident((1, 0, 0), "x4", Capability.BLOCKS | Capability.LEVELS, 16, 1000, 8, 5000, 125_000, "uno")
RIG = Rig(metres_per_count=Measured(7.67e-6), belt_speed=Measured(0.22))


def check(rate_hz, block, baud=None, board=BOARD, rig=RIG):
    plan = Plan(rate_hz, block, link_budget.compute_load(board, rate_hz, block))
    return link_budget.check(board, rig, plan, baud)


def test_a_missing_port_is_named_with_what_is_there():
    with pytest.raises(DeviceError) as caught:
        ports.open_port("/dev/ttyNONE7")
    assert caught.value.where == "/dev/ttyNONE7"
    assert "no such port" in caught.value.what
    assert "connect the board" in caught.value.do


def test_a_url_writes_to_no_file(tmp_path):
    other = tmp_path / "thesis.txt"
    other.write_text("three years of work")
    for url in (f"spy:///dev/ttyNONE7?file={other}", f"SPY://loop://?file={other}", f"alt://x?class={other}"):
        with pytest.raises(InputError, match="is not a supported kind of port"):  # spy:// emptied the file
            ports.open_port(url)
    assert other.read_text() == "three years of work"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("morse://7", "rig://SCENE"),
        ("loop://?logging=x", "this kind of port cannot be opened"),  # a KeyError was a traceback
        ("rig://rig?set=friction.lew%3D3", "friction"),
    ],
)
def test_what_is_wrong_in_a_url_is_bad_input(url, words):
    with pytest.raises(InputError, match=words):
        ports.open_port(url)


@pytest.mark.parametrize(
    ("error", "said", "cure"),
    [
        (PermissionError(errno.EACCES, "Permission denied"), "permission", "run 'sudo "),
        (OSError(errno.EBUSY, "Device or resource busy"), "another program", "close"),
    ],
)
def test_a_port_that_is_there_and_refused_is_named_with_the_cure(tmp_path, error, said, cure):
    device = tmp_path / "ttyACM0"
    device.touch()
    what, where, do = ports.explain_refusal(str(device), error)
    assert (said in what, where, cure in do) == (True, str(device), True)


@pytest.mark.parametrize(("mode", "command"), [(0o660, "usermod -a -G dialout"), (0o600, "chmod a+rw")])
def test_the_group_is_the_cure_only_where_it_has_the_right(tmp_path, monkeypatch, mode, command):
    grp = pytest.importorskip("grp")
    device = tmp_path / "ttyACM0"
    device.touch(mode)
    device.chmod(mode)
    monkeypatch.setattr(grp, "getgrgid", lambda gid: type("Group", (), {"gr_name": "dialout"}))
    assert command in ports.permission_fix(device)


@pytest.mark.parametrize(
    ("scene", "changes", "realtime", "url"),
    [
        ("rig", [], False, "rig://rig"),
        ("rig", ["friction.law=3"], True, "rig://rig?set=friction.law%3D3&realtime=1"),
        ("/a b/s.toml", ["x.y=1", "z.w=2"], False, "rig://%2Fa%20b%2Fs.toml?set=x.y%3D1&set=z.w%3D2"),
    ],
)
def test_the_rigs_url_carries_scene_and_changes(scene, changes, realtime, url):
    assert ports.rig_url(scene, changes, realtime) == url
    assert ports.waits_for_reader(url) is not realtime
    assert not any(map(ports.waits_for_reader, ("/dev/ttyACM0", "socket://rig:1")))


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ((1000, 8, 115_200), None),
        ((5000, 8, None), None),  # a line without a baud rate has no such limit
        ((500, 1, 115_200), "11000 bytes/s"),
        # a slip that would outrun the decoder
        ((1000, 8, None, replace(BOARD, max_edge_rate_hz=80_000)), "114733 edges/s"),
    ],
)
def test_what_a_line_carries_is_recorded_with_a_warning_where_it_is_tight(what, said):
    warnings = check(*what)
    assert len(warnings) == (said is not None)
    assert said is None or said in warnings[0]


FAST = replace(RIG, metres_per_count=Measured(7.67e-9))


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ((1000, 1, 115_200), r"22000 bytes/s; 115200 baud can transfer 11520; use rate_hz=523 or less"),
        ((6000, 8), "5000"),  # more than the board samples
        ((1000, 8, None, replace(BOARD, max_edge_rate_hz=0), FAST), "roll over"),
    ],
)
def test_what_cannot_be_carried_or_counted_is_refused_with_the_limit(what, said):
    with pytest.raises(InputError, match=said):
        check(*what)


def test_slow_rates_are_sent_in_single_frames():
    assert link_budget.choose_block_size(BOARD, 20) == 1
    assert link_budget.choose_block_size(replace(BOARD, capabilities=Capability.LEVELS), 1000) == 1


def test_a_usb_serial_driver_is_asked_for_low_latency_and_may_say_no(monkeypatch):
    asked = []

    class Port:
        def set_low_latency_mode(self, wanted):
            asked.append(wanted)
            raise ValueError("this driver cannot")

    monkeypatch.setattr(serial, "serial_for_url", lambda url, **settings: Port())
    assert isinstance(ports.open_port("/dev/ttyUSB7"), Port)
    assert asked == [True]


def test_bytes_of_a_pseudo_terminal_or_a_url_have_no_time_of_their_own(tmp_path):
    port = type("Port", (), {"baudrate": 115_200})()
    assert ports.uart_baud("/dev/ttyUSB0", port) == 115_200
    assert ports.uart_baud("socket://rig:1", port) is None
    (tmp_path / "ttyFAKE").symlink_to("/dev/pts/7")
    assert ports.uart_baud(str(tmp_path / "ttyFAKE"), port) is None


def test_lines_that_come_already_are_not_refused_for_a_baud_rate_that_is_only_a_name():
    plan = Plan(1000.0, 1, 24_000.0, comes_already=True)
    assert link_budget.check(BOARD, RIG, plan, 115_200) == []
    assert len(link_budget.check(BOARD, RIG, replace(plan, bytes_per_s=11_400.0), 115_200)) == 1


def test_a_socket_that_does_not_say_how_many_bytes_wait_is_read_in_large_pieces():
    """Pyserial's sockets say 1 for some: read byte by byte, with a pause between reads, they could not keep up."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = ports.open_port(f"socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer, port:
            sent = bytes(range(256)) * 40
            peer.sendall(sent)
            line = Frames(port, "socket", RecordRequest())
            reads = [line.read()]
            while sum(map(len, reads)) < len(sent):
                reads.append(line.read())
            assert b"".join(reads) == sent
            assert len(reads) < 20


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_a_port_is_opened_once_under_whatever_name(tmp_path):
    master, slave = os.openpty()
    name = os.ttyname(slave)
    (tmp_path / "ttyLINK").symlink_to(name)
    port = ports.open_port(name)
    for other in (name, str(tmp_path / "ttyLINK")):
        with pytest.raises(DeviceError, match="another program is using this port"):
            ports.open_port(other)
    port.close()
    ports.open_port(str(tmp_path / "ttyLINK")).close()
    os.close(master)
    os.close(slave)


def test_a_port_is_shown_readable_and_short():
    # The first line of a recording of a measured curve was 3000 percent signs long.
    assert ports.shorten_url("/dev/ttyACM0") == "/dev/ttyACM0"
    assert ports.shorten_url(ports.rig_url("rig", ["belt.speed=0.15"], False)) == "rig://rig?set=belt.speed=0.15"
    assert len(ports.shorten_url(ports.rig_url("rig", [f"friction.curve={[[0.0, 1.0]] * 99}"], False))) == 100
