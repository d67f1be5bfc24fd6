"""The live view's server: a process of its own that only reads, answers its own page alone, and ends by itself."""

import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from daq.live import assets
from daq.runfile import journal, store

from ...conftest import need

need(find_spec("starlette"), "the extra live is not installed")


class Viewer:
    """`daq watch` on a journal that the test lets grow."""

    def __init__(self, part: Path, content: bytes) -> None:
        self.part, self._content = part, content
        part.write_bytes(content[:4096])
        line = [sys.executable, "-m", "daq.cli.app", "watch", str(part), "--no-browser"]
        self.process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.address = urlsplit(self.url)

    def grow(self, until: float = 1.0) -> None:
        """Write the journal up to a share of it."""
        with self.part.open("ab") as file:
            file.write(self._content[self.part.stat().st_size : round(until * len(self._content))])

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        link = http.client.HTTPConnection("127.0.0.1", self.address.port, timeout=10)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        link.request(method, path, body, named)
        answer = link.getresponse()
        found = answer.status, answer.read()
        link.close()
        return found

    def events(self, after: int, most: int) -> list[tuple[int, dict]]:
        """Return numbered events after a number, until the recording ends or ``most`` came."""
        link = http.client.HTTPConnection("127.0.0.1", self.address.port, timeout=20)
        link.request("GET", f"{self.address.path}events", headers={"Last-Event-ID": str(after)})
        found: list[tuple[int, dict]] = []
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


@contextmanager
def started(line: list[str]) -> Iterator["subprocess.Popen[str]"]:
    """Start a command, and kill it where a test fails: the test would wait for it for ever."""
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def viewer(keep_journal: Callable[..., Path]) -> Iterator[Viewer]:
    part = keep_journal()
    made = Viewer(part.with_name("live.h5.part"), part.read_bytes())
    yield made
    made.process.kill()
    made.process.communicate()


def test_the_page_is_served_to_its_own_computer_and_address_alone(viewer: Viewer) -> None:
    path, own = viewer.address.path, viewer.address.netloc
    assert viewer.address.hostname == "127.0.0.1"
    assert len(path.strip("/")) >= 22
    served = {name: viewer.ask("GET", path + name) for name in ("", *assets.KINDS)}
    assert {status for status, _ in served.values()} == {200}
    assert sum(len(content) for name, (_, content) in served.items() if name) <= 150_000
    refused = {
        "/": viewer.ask("GET", "/"),
        "wrong token": viewer.ask("GET", "/" + "x" * 24 + "/"),
        "no such file": viewer.ask("GET", path + "secret"),
        "outside": viewer.ask("GET", path + "../../../etc/passwd"),
        "escaped": viewer.ask("GET", path + "..%2f..%2fserver.py"),
    }
    assert {name: status for name, (status, _) in refused.items()} == dict.fromkeys(refused, 404)
    assert viewer.ask("GET", path, Host="example.org")[0] == 421
    assert viewer.ask("GET", path, Host=f"127.0.0.1.example.org:{viewer.address.port}")[0] == 421
    assert viewer.ask("GET", path, Host=own, Origin="http://example.org")[0] == 403
    assert viewer.ask("GET", path, Host=own, Origin=f"http://{own}")[0] == 200


def test_a_page_that_connects_again_misses_nothing_and_all_ends_with_the_recording(viewer: Viewer) -> None:
    viewer.grow(0.4)
    before = viewer.events(0, 1)
    viewer.grow(0.7)
    later: list[tuple[int, dict]] = []
    reader = threading.Thread(target=lambda: later.extend(viewer.events(before[-1][0], 10_000)))
    reader.start()
    assert viewer.ask("POST", viewer.address.path + "marker", b" a\nhand ", Content_Type="text/plain") == (
        200,
        b"stored",
    )
    viewer.grow()
    reader.join(20)
    output, errors = viewer.process.communicate(timeout=20)
    assert (viewer.process.returncode, output, errors) == (0, "", "")
    numbers = [number for number, _ in before + later]
    assert numbers == list(range(1, len(numbers) + 1))
    sent = [data for _, data in before + later]
    assert sent[-1]["ended"] == "the recording has ended: complete"
    assert [data["marker"]["text"] for data in sent if "marker" in data] == ["a hand"]
    x = np.concatenate([data["x"] for data in sent if "x" in data])
    run = store.load(viewer.part.with_name("run.h5"))
    parabola = run.position[10:-10]  # a parabola's middle is within the noise of the positions it is fitted to
    np.testing.assert_allclose(x[: parabola.size], parabola, rtol=0, atol=3e-5)
    assert x.size >= parabola.size
    assert sent[-2]["counts"]["samples"] >= run.time.size
    assert [text for _, text in journal.read_markers(journal.markers_path(viewer.part))] == ["a hand"]


def test_markers_that_cannot_be_kept_are_refused(viewer: Viewer) -> None:
    path = viewer.address.path + "marker"
    assert viewer.ask("POST", path, b"x", Content_Type="application/x-www-form-urlencoded")[0] == 415
    assert viewer.ask("POST", path, b"x" * 2000, Content_Type="text/plain")[0] == 413
    assert viewer.ask("GET", path)[0] in (404, 405)
    assert not journal.markers_path(viewer.part).exists()


def test_a_viewer_of_no_recording_says_so(tmp_path: Path) -> None:
    (tmp_path / "note.h5").write_text("a note")
    (tmp_path / "note.h5.part").write_text("a note")
    for name, what in (
        ("run.h5.part", "no such journal"),
        ("run.h5", "no such file"),
        ("note.h5", "is not a"),
        ("note.h5.part", "is not a journal"),
    ):
        line = [sys.executable, "-m", "daq.cli.app", "watch", str(tmp_path / name), "--no-browser"]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert what in done.stderr


def test_a_viewer_waits_for_the_first_record(keep_journal: Callable[..., Path], tmp_path: Path) -> None:
    content = keep_journal().read_bytes()
    part = tmp_path / "live.h5.part"
    part.write_bytes(content[:5])  # as a recorder leaves it for a moment
    line = [sys.executable, "-m", "daq.cli.app", "watch", str(part), "--no-browser", "--wait"]
    done = subprocess.run([*line, "0.2"], capture_output=True, text=True, check=False)
    assert (done.returncode, "is not a journal of daq" in done.stderr) == (2, True)
    with started([*line, "30"]) as process:
        time.sleep(2.0)
        assert process.poll() is None
        with part.open("ab") as file:
            file.write(content[5:])
        output, errors = process.communicate(timeout=30)
    assert (process.returncode, output[:17], errors) == (0, "http://127.0.0.1:", "")


@pytest.mark.slow  # it records in real time
def test_a_viewer_that_is_killed_leaves_the_recording_alone(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"  # the whole path, so that pkill finds no viewer of a test that runs beside this one
    line = [sys.executable, "-m", "daq.cli.app", "record", "--live", "--no-browser", "--duration", "6", "--json"]
    line += ["--output", str(run)]
    with started(line) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        url = urlsplit(next(text.strip() for text in lines if text.startswith("http")))
        subprocess.run(["pkill", "-KILL", "-f", f"watch {run}.part"], check=True)
        assert url.port is not None
        while is_listening(url.port):  # as long as the kill takes
            time.sleep(0.01)
        output, _ = process.communicate(timeout=60)
    found = json.loads(output)
    assert (process.returncode, found["samples"], found["lost"], found["ended"]) == (0, 6000, 0, "complete")


def is_listening(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    except ConnectionRefusedError:
        return False
    return True


def test_an_address_that_is_no_views_says_so_in_a_page(viewer: Viewer) -> None:
    for path in ("/" + "x" * 24 + "/", "/"):
        status, answer = viewer.ask("GET", path)
        assert status == 404
        assert b"There is no live view at this address" in answer
        assert viewer.address.path.strip("/").encode() not in answer


def test_only_the_page_itself_may_stop_a_recording(viewer: Viewer) -> None:
    path, own = viewer.address.path + "stop", f"http://{viewer.address.netloc}"
    asked = journal.stop_path(viewer.part)
    text = {"Content_Type": "text/plain"}
    assert viewer.ask("POST", path, b"stop", **text)[0] == 403  # no page says where it is from
    assert viewer.ask("POST", path, b"stop", Origin="http://example.org", **text)[0] == 403
    assert viewer.ask("POST", path, b"stop", Origin="null", **text)[0] == 403
    assert viewer.ask("POST", path, b"stop", Origin=own, Content_Type="application/x-www-form-urlencoded")[0] == 415
    assert viewer.ask("POST", path, b"", Origin=own, **text)[0] == 409
    assert viewer.ask("GET", path, Origin=own)[0] in (404, 405)
    assert viewer.ask("POST", "/" + "x" * 24 + "/stop", b"stop", Origin=own, **text)[0] == 404
    assert not asked.exists()
    assert viewer.ask("POST", path, b"stop", Origin=own, **text) == (200, b"stored")
    assert asked.exists()
    viewer.grow()
    viewer.process.communicate(timeout=20)


def test_a_stretch_of_the_past_is_read_again_from_the_journal(viewer: Viewer) -> None:
    viewer.grow(0.9)
    viewer.events(0, 2)
    status, answer = viewer.ask("GET", viewer.address.path + "stretch?from=1.0&to=1.5")
    found = json.loads(answer)
    run = store.load(viewer.part.with_name("run.h5"))
    own = (run.time >= 1.0) & (run.time <= 1.5)
    assert status == 200
    np.testing.assert_allclose(found["t"], run.time[own], atol=1e-6)
    np.testing.assert_allclose(found["x"], run.position[own], rtol=1e-6)
    assert found["exact"]
    for wrong in ("stretch", "stretch?from=1", "stretch?from=a&to=b", "stretch?from=nan&to=1"):
        assert viewer.ask("GET", viewer.address.path + wrong)[0] == 400
    empty = json.loads(viewer.ask("GET", viewer.address.path + "stretch?from=70&to=80")[1])
    assert empty["t"] == []


def test_a_journal_that_vanishes_or_is_replaced_ends_the_view_with_a_reason(viewer: Viewer) -> None:
    viewer.grow(0.5)
    viewer.part.rename(viewer.part.with_name("elsewhere.h5.part"))
    (_, last) = viewer.events(0, 10_000)[-1]
    assert "has been moved or removed" in last["ended"]
    viewer.process.communicate(timeout=20)


def test_a_finished_run_is_served_until_it_is_interrupted(keep_journal: Callable[..., Path]) -> None:
    run = keep_journal(duration_s=12.0).with_suffix("")
    line = [sys.executable, "-m", "daq.cli.app", "watch", str(run), "--no-browser"]
    with started(line) as process:
        assert process.stdout is not None
        address = urlsplit(process.stdout.readline().strip())
        viewer = Viewer.__new__(Viewer)
        viewer.address, viewer.process = address, process
        sent = viewer.events(0, 1)
        while sent[-1][1]["progress"] < 1.0:  # on a busy machine the first event comes before all is read
            sent = viewer.events(sent[-1][0], 1)
        loaded = store.load(run)
        assert sent[-1][1]["counts"]["samples"] == loaded.time.size
        assert sent[-1][1]["summary"]["cycles"] >= 4
        found = json.loads(viewer.ask("GET", address.path + "stretch?from=2&to=3")[1])
        np.testing.assert_allclose(found["t"], loaded.time[(loaded.time >= 2) & (loaded.time <= 3)], atol=1e-6)
        for path in ("marker", "stop"):
            status, words = viewer.ask(
                "POST", address.path + path, b"stop", Content_Type="text/plain", Origin=f"http://{address.netloc}"
            )
            assert status == 409
            assert b"there is no recording" in words
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, "")


def test_a_run_that_is_still_recorded_is_followed_by_the_name_of_its_run_file(
    keep_journal: Callable[..., Path],
) -> None:
    part = keep_journal()
    part.with_suffix("").unlink()
    line = [sys.executable, "-m", "daq.cli.app", "watch", str(part.with_suffix("")), "--no-browser", "--json"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    assert json.loads(done.stdout)["ended"] == "the recording has ended: complete"
