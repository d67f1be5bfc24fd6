"""The live view's server: a process of its own that only reads, answers its own page alone, and ends by itself."""

import contextlib
import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib.util import find_spec
from urllib.parse import urlsplit

import numpy as np
import pytest

from daq.cli.app import app
from daq.live import assets
from daq.runfile import journal, store
from stickslip.console import application

from ...conftest import need

need(find_spec("starlette"), "the extra live is not installed")
WATCH = [sys.executable, "-m", "daq.cli.app", "watch", "--no-browser"]


class Viewer:
    """A process that shows its address, and what its page asks it."""

    def __init__(self, process):
        self.process = process
        self.address = urlsplit(process.stdout.readline().strip())

    def ask(self, method, path, body=None, **headers):
        link = http.client.HTTPConnection("127.0.0.1", self.address.port, timeout=10)
        link.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        answer = link.getresponse()
        found = answer.status, answer.read()
        link.close()
        return found

    def events(self, after, most):
        """Return numbered events after a number, until the recording ends or ``most`` came."""
        link = http.client.HTTPConnection("127.0.0.1", self.address.port, timeout=20)
        link.request("GET", f"{self.address.path}events", headers={"Last-Event-ID": str(after)})
        found = []
        number = 0
        answer = link.getresponse()
        for line in answer:
            name, _, value = line.decode().strip().partition(": ")
            if name == "id":
                number = int(value)
            elif name == "data" and number > after:
                found.append((number, json.loads(value)))
                if "ended" in found[-1][1] or len(found) == most:
                    break
        answer.close()
        link.close()
        return found


@contextlib.contextmanager
def started(line):
    """Start a command, and kill it where a test fails: the test would wait for it for ever."""
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def viewer(keep_journal):
    """`daq watch` on a journal that the test lets grow up to a share of it."""
    part = keep_journal()
    content, live = part.read_bytes(), part.with_name("live.h5.part")
    live.write_bytes(content[:4096])

    def grow(until=1.0):
        with live.open("ab") as file:
            file.write(content[live.stat().st_size : round(until * len(content))])

    with started([*WATCH, str(live)]) as process:
        made = Viewer(process)
        made.part, made.grow = live, grow
        yield made


def test_the_page_is_served_to_its_own_computer_and_address_alone(viewer):
    path, own = viewer.address.path, viewer.address.netloc
    assert viewer.address.hostname == "127.0.0.1"
    assert len(path.strip("/")) >= 22
    served = {name: viewer.ask("GET", path + name) for name in ("", *assets.KINDS)}
    assert {status for status, _ in served.values()} == {200}
    assert sum(len(content) for name, (_, content) in served.items() if name) <= 150_000
    assert viewer.ask("GET", path, Host=own, Origin=f"http://{own}")[0] == 200
    wrong = "/" + "x" * 24 + "/"
    for page in ("/", wrong):
        status, answer = viewer.ask("GET", page)
        assert (status, b"There is no live view at this address" in answer) == (404, True)
        assert path.strip("/").encode() not in answer
    text, form = {"Content_Type": "text/plain"}, {"Content_Type": "application/x-www-form-urlencoded"}
    here = {"Origin": f"http://{own}"}
    for status, method, asked, body, headers in (
        (404, "GET", path + "secret", None, {}),
        (404, "GET", path + "../../../etc/passwd", None, {}),
        (404, "GET", path + "..%2f..%2fserver.py", None, {}),
        (421, "GET", path, None, {"Host": "example.org"}),
        (421, "GET", path, None, {"Host": f"127.0.0.1.example.org:{viewer.address.port}"}),
        (403, "GET", path, None, {"Host": own, "Origin": "http://example.org"}),
        (415, "POST", path + "marker", b"x", form),
        (413, "POST", path + "marker", b"x" * 2000, text),
        (405, "GET", path + "marker", None, {}),
        (403, "POST", path + "stop", b"stop", text),  # no page says where it is from
        (403, "POST", path + "stop", b"stop", text | {"Origin": "http://example.org"}),
        (403, "POST", path + "stop", b"stop", text | {"Origin": "null"}),
        (415, "POST", path + "stop", b"stop", form | here),
        (409, "POST", path + "stop", b"", text | here),
        (405, "GET", path + "stop", None, here),
        (404, "POST", wrong + "stop", b"stop", text | here),
        *(
            (400, "GET", f"{path}stretch{query}", None, {})
            for query in ("", "?from=1", "?from=a&to=b", "?from=nan&to=1")
        ),
    ):
        found = viewer.ask(method, asked, body, **headers)[0]
        assert found == status or (status, found) == (405, 404), (method, asked, headers)
    assert not journal.markers_path(viewer.part).exists()
    assert not journal.stop_path(viewer.part).exists()


def test_a_page_that_connects_again_misses_nothing_and_all_ends_with_the_recording(viewer):
    viewer.grow(0.4)
    before = viewer.events(0, 1)
    viewer.grow(0.7)
    later = []
    reader = threading.Thread(target=lambda: later.extend(viewer.events(before[-1][0], 10_000)))
    reader.start()
    path, origin = viewer.address.path, f"http://{viewer.address.netloc}"
    for name, body in (("marker", b" a\nhand "), ("stop", b"stop")):
        assert viewer.ask("POST", path + name, body, Content_Type="text/plain", Origin=origin) == (200, b"stored")
    viewer.grow()
    reader.join(20)
    output, errors = viewer.process.communicate(timeout=20)
    assert (viewer.process.returncode, output, errors) == (0, "", "")
    numbers = [number for number, _ in before + later]
    assert numbers == list(range(1, len(numbers) + 1))
    sent = [data for _, data in before + later]
    assert sent[-1]["ended"] == "Recording complete"
    x = np.concatenate([data["x"] for data in sent if "x" in data])
    run = store.load(viewer.part.with_name("run.h5"))
    parabola = run.position[10:-10]  # a parabola's middle is within the noise of the positions it is fitted to
    np.testing.assert_allclose(x[: parabola.size], parabola, rtol=0, atol=3e-5)
    assert x.size >= parabola.size
    assert sent[-2]["counts"]["samples"] >= run.time.size
    assert [text for _, text in journal.read_markers(journal.markers_path(viewer.part))] == ["a hand"]
    assert journal.stop_path(viewer.part).exists()


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("run.h5.part", "no such file"),
        ("run.h5", "no such file"),
        ("note.h5", "is not a"),
        ("note.h5.part", "is not a journal"),
    ],
)
def test_a_viewer_of_no_recording_says_so(tmp_path, capsys, name, what):
    (tmp_path / "note.h5").write_text("a note")
    (tmp_path / "note.h5.part").write_text("a note")
    assert application.run(app, ["watch", str(tmp_path / name), "--no-browser"]) == 2
    assert what in capsys.readouterr().err


def test_a_viewer_waits_for_the_first_record(keep_journal, tmp_path, capsys):
    content = keep_journal().read_bytes()
    part = tmp_path / "live.h5.part"
    part.write_bytes(content[:5])  # as a recorder leaves it for a moment
    assert application.run(app, ["watch", str(part), "--no-browser", "--wait", "0.2"]) == 2
    assert "is not a journal of daq" in capsys.readouterr().err
    with started([*WATCH, str(part), "--wait", "30"]) as process:
        time.sleep(1.0)
        assert process.poll() is None
        with part.open("ab") as file:
            file.write(content[5:])
        output, errors = process.communicate(timeout=30)
    assert (process.returncode, output[:17], errors) == (0, "http://127.0.0.1:", "")


@pytest.mark.slow  # it records in real time
def test_a_viewer_that_is_killed_leaves_the_recording_alone(tmp_path):
    run = tmp_path / "run.h5"  # the whole path, so that pkill finds no viewer of a test that runs beside this one
    line = [sys.executable, "-m", "daq.cli.app", "record", "--live", "--no-browser", "--duration", "3", "--json"]
    with started([*line, "--output", str(run)]) as process:
        lines = iter(process.stderr.readline, "")
        url = urlsplit(next(text.strip() for text in lines if text.startswith("http")))
        subprocess.run(["pkill", "-KILL", "-f", f"watch {run}.part"], check=True)
        with contextlib.suppress(ConnectionRefusedError):
            while True:  # as long as the kill takes
                socket.create_connection(("127.0.0.1", url.port), timeout=5).close()
                time.sleep(0.01)
        output, _ = process.communicate(timeout=60)
    found = json.loads(output)
    assert (process.returncode, found["samples"], found["lost"], found["ended"]) == (0, 3000, 0, "complete")


def test_a_finished_run_is_served_until_it_is_interrupted(keep_journal):
    run = keep_journal(duration_s=12.0).with_suffix("")
    with started([*WATCH, str(run)]) as process:
        viewer = Viewer(process)
        path, origin = viewer.address.path, f"http://{viewer.address.netloc}"
        sent = viewer.events(0, 1)
        while sent[-1][1]["progress"] < 1.0:  # on a busy machine the first event comes before all is read
            sent = viewer.events(sent[-1][0], 1)
        loaded = store.load(run)
        assert sent[-1][1]["counts"]["samples"] == loaded.time.size
        assert sent[-1][1]["summary"]["cycles"] >= 4
        found = json.loads(viewer.ask("GET", path + "stretch?from=2&to=3")[1])
        np.testing.assert_allclose(found["t"], loaded.time[(loaded.time >= 2) & (loaded.time <= 3)], atol=1e-6)
        for name in ("marker", "stop"):
            status, words = viewer.ask("POST", path + name, b"stop", Content_Type="text/plain", Origin=origin)
            assert (status, b"there is no recording" in words) == (409, True)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, "")


def test_a_run_that_is_still_recorded_is_followed_by_the_name_of_its_run_file(keep_journal):
    part = keep_journal()
    part.with_suffix("").unlink()
    done = subprocess.run([*WATCH, str(part.with_suffix("")), "--json"], capture_output=True, check=False, timeout=60)
    assert json.loads(done.stdout)["ended"] == "Recording complete"
