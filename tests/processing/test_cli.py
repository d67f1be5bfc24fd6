"""`process` as it is typed: what it prints and what it writes."""

import csv
import json

import pytest
from matplotlib.image import imread

from daq.runfile import store
from processing import plot
from processing.cli import app
from stickslip.console import application
from stickslip.output.plot import figure


@pytest.fixture
def path(tmp_path, motion, run_data):
    target = tmp_path / "run.h5"
    store.write(target, run_data(motion(5, 6.0, start=0.5), with_truth=True))
    return target


@pytest.fixture
def typed(capsys):
    def run(*arguments):
        code = application.run(app, [str(argument) for argument in arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


def document(typed, *arguments):
    code, out, err = typed(*arguments, "--json")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_smooth_says_what_it_chose_and_found(typed, path):
    data = document(typed, "smooth", path)
    assert {"method", "window", "order", "sticks", "slips", "belt_speed", "lost_counts", "cpu_s"} <= set(data)
    assert (data["method"], data["lost_counts"]) == ("segment", 0)
    assert data["window"] % 2 == 1
    assert data["belt_speed"] == pytest.approx(0.22, abs=2e-4)
    assert (data["sticks"], data["slips"]) == (4, 4)
    code, out, err = typed("smooth", path, "--window", "41")
    assert (code, err) == (0, "")
    assert "Savitzky-Golay, window 41 samples (40 ms), order 4; recorded time stamps used" in out
    assert "4 sticks and 4 slips" in out


def test_an_unknown_belt_speed_is_null(typed, tmp_path, motion, run_data):
    target = tmp_path / "still.h5"
    store.write(target, run_data(motion(5, 0.4, start=0.5)))
    data = document(typed, "smooth", target)
    assert data["belt_speed"] is None
    assert data["warnings"] == ["the mass never moves in this record"]


def test_settings_are_carried_out(typed, path):
    data = document(typed, "smooth", path, "--method", "fd", "--times", "nominal", "--belt-speed", "-0.22")
    assert (data["method"], data["window"], data["order"], data["times"]) == ("fd", 2, 1, "nominal")
    assert (data["belt_speed"], data["sticks"]) == (-0.22, 0)
    assert document(typed, "smooth", path, "--window", "20ms", "--order", "2")["window"] == 21


def test_compare_states_true_errors_only_where_truth_was_recorded(typed, path, tmp_path, motion, run_data):
    rows = document(typed, "compare", path)["rows"]
    assert {"method", "setting", "cpu_s", "sigma_v", "rms_error", "max_error"} <= set(rows[0])
    by_name = {(row["method"], row["setting"]): row for row in rows}
    rough, smooth = by_name["fd", "recorded"], next(row for row in rows if row["setting"].startswith("auto"))
    default = by_name["auto", "recorded = segment"]
    assert default["rms_error"] == by_name["segment", "recorded"]["rms_error"] < smooth["rms_error"]
    assert 3e-3 < rough["rms_error"] < 4e-3
    assert (
        next(row for row in rows if row["setting"].startswith("auto") and "recorded" in row["setting"])["rms_error"]
        < 0.1 * rough["rms_error"]
    )
    assert smooth["max_error"] > smooth["rms_error"]
    silent = tmp_path / "silent.h5"
    store.write(silent, run_data(motion(5, 6.0, start=0.5)))
    for row in document(typed, "compare", silent)["rows"]:
        assert row["rms_error"] is None
        assert row["sigma_v"] > 0
    code, out, _ = typed("compare", silent)
    assert code == 0
    assert "does not contain the exact motion" in out


def test_smoothing_does_not_look_at_the_truth(typed, path, tmp_path, motion, run_data):
    silent = tmp_path / "silent.h5"
    store.write(silent, run_data(motion(5, 6.0, start=0.5)))
    printed, kept = (document(typed, "smooth", target) for target in (path, silent))
    assert {**printed, "cpu_s": 0} == {**kept, "cpu_s": 0}


def test_inspect_draws_the_run_smoothed_or_not(typed, path, tmp_path):
    data = document(typed, "inspect", path)
    assert data["smoothed_in_memory"] is True
    assert data["sticks"] == 4
    picture = imread(path.with_name("run.inspect.png"))
    assert picture.shape[1] > 1200
    typed("smooth", path)
    target = tmp_path / "mine.svg"
    store.annotate(path, {"title": "$x^{$"})  # read as a formula, the title was a traceback
    assert document(typed, "inspect", path, "--plot", target)["smoothed_in_memory"] is False
    drawn = target.read_text()
    for words in ("$x^{$", "time (s)", "x (mm)", "v (m/s)", "phase portrait", "stick", "belt", "break-away level (mm)"):
        assert words in drawn


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the pictures of `process inspect` empty, where a test is about their files: one costs 0.8 s of CPU."""
    monkeypatch.setattr(plot, "draw_inspection", lambda *_: figure(1.0, 1.0))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("ending", ["png", "svg"])
def test_a_run_s_own_picture_is_drawn_again_and_that_of_another_run_kept(
    typed, path, tmp_path, run_data, motion, ending
):
    # The default picture was replaced whatever it was, and the one that --plot names needed --force every time.
    picture = tmp_path / f"picture.{ending}"
    for _ in range(2):
        assert typed("inspect", path, "--plot", picture)[0] == 0
    other = path.with_name("other.h5")
    store.write(other, run_data(motion(5, 5.0, start=0.5)))
    before = picture.read_bytes()
    assert typed("inspect", other, "--plot", picture)[0] == 2
    assert picture.read_bytes() == before
    other.with_name("other.inspect.png").write_text("precious")
    assert typed("inspect", other)[0] == 2
    assert other.with_name("other.inspect.png").read_text() == "precious"
    assert typed("inspect", other, "--plot", picture, "--force")[0] == 0


def test_export_writes_what_reads_back(typed, path, tmp_path):
    target = tmp_path / "motion.csv"
    data = document(typed, "export", path, "--csv", target)
    assert data["rows"] == 6000
    with target.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == data["columns"]
    assert {row["phase"] for row in rows} == {"rest", "slip", "stick"}
    assert float(rows[2000]["velocity_m_per_s"]) == pytest.approx(0.22, abs=0.7)
    code, _, err = typed("export", path, "--csv", target)
    assert code == 2
    assert "exists" in err
    assert typed("export", path)[0] == 2
