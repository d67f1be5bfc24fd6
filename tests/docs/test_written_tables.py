"""Benchmarks write tables of the pages: rows replace their own, and every marked table has a benchmark."""

import ast
import dataclasses
import importlib
import re
import sys

import pytest

from . import examples

BENCHMARKS = examples.ROOT / "benchmarks"
DOCS = examples.ROOT / "docs"
PAGES = ("velocity.md", "accuracy.md", "identification.md")  # of which the benchmarks write the tables
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
PAGE = """# Errors

<!-- begin: race methods; python benchmarks/race.py --write -->

| method | error | CPU |
|---|---|---|
| exact | 1e-14 | 1 |
| rk4 | 1e-3 | 22 |

<!-- end: race methods -->

| method | error | CPU |
|---|---|---|
| exact | by hand | |
"""


def benchmark(name):
    """Import a benchmark, or what benchmarks share."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize("path", sorted(BENCHMARKS.rglob("*.py")), ids=lambda path: path.name)
def test_what_a_benchmark_imports_of_the_packages_is_there(path):
    """Benchmarks are not type-checked: one imported a module by the name that it had before."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in PACKAGES:
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names if not hasattr(module, alias.name)):
                importlib.import_module(f"{node.module}.{name}")


@pytest.fixture(scope="module")
def pages():
    return benchmark("pages")


def test_rows_replace_those_of_their_name_and_no_others(pages, tmp_path):
    (tmp_path / "page.md").write_text(PAGE)
    pages.write("page.md", "race methods", {"exact": ["2e-14", "1"], "heyoka": ["3e-12", "4.4"]}, docs=tmp_path)
    written = (tmp_path / "page.md").read_text()
    assert written == PAGE.replace("| exact | 1e-14 | 1 |", "| exact | 2e-14 | 1 |").replace(
        "| rk4 | 1e-3 | 22 |\n", "| rk4 | 1e-3 | 22 |\n| heyoka | 3e-12 | 4.4 |\n"
    )


def test_a_benchmark_that_has_found_nothing_changes_nothing(pages):
    assert pages.with_rows(PAGE, "race methods", {}) == PAGE


@pytest.mark.parametrize("damage", ["begin: race methods", "end: race methods"])
def test_a_page_without_the_marker_is_refused_and_left_alone(pages, tmp_path, damage):
    (tmp_path / "page.md").write_text(PAGE.replace(damage, "other"))
    with pytest.raises(ValueError, match="race methods"):
        pages.write("page.md", "race methods", {"exact": ["2e-14", "1"]}, docs=tmp_path)
    assert (tmp_path / "page.md").read_text() == PAGE.replace(damage, "other")


def test_a_row_of_another_width_is_refused(pages):
    with pytest.raises(ValueError, match="2 cells; the table has 3"):
        pages.with_rows(PAGE, "race methods", {"exact": ["2e-14"]})


def test_every_marked_table_names_a_benchmark_that_writes_it(pages):
    named = set()
    for path in sorted(DOCS.rglob("*.md")):
        if path.name == "reliability.md":  # its tables are of the campaigns: tests/reliability/page.py
            continue
        text = path.read_text()
        for name, command in pages.marked(text):
            script = BENCHMARKS / f"{name.split()[0]}.py"
            assert script.is_file(), f"{path}: {name}"
            assert "pages.write(" in script.read_text(), script
            if command:
                assert re.fullmatch(rf"python benchmarks/{script.name}( .*)? --write", command), command
            assert pages.with_rows(text, name, {}) == text, f"{path}: {name}"
            named.add((path.relative_to(DOCS).as_posix(), name))
    assert {page for page, _ in named} >= set(PAGES)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0287, 2, "0.029"),
        (0.3, 2, "0.30"),
        (1.0, 3, "1.00"),
        (9362.0, 3, "9 360"),
        (99.7, 2, "100"),
        (0.0, 2, "0"),
        (17012.0, 2, "17 000"),
    ],
)
def test_numbers_are_written_to_their_digits(pages, value, digits, text):
    assert pages.significant(value, digits) == text


def test_slopes_of_ramps_have_a_row_each(pages):
    stiff = benchmark("stiff")
    row = {
        "steps_per_cycle": 9.0,
        "compiled_s": 2e-6,
        "interpreted_s": 2e-4,
        "exact_error": 2e-16,
        "exact_t_error": 1e-15,
    }
    row |= {f"{method}_s": 0.02 for method, _ in stiff.PEERS} | {f"{method}_t_error": 2e-9 for method, _ in stiff.PEERS}
    rows = [row | {"G_stick": slope} for slope in stiff.SLOPES]
    rows[-1] = rows[-1] | {"steps_per_cycle": 10.0, "dop853_t_error": None}
    text = (DOCS / "accuracy.md").read_text()
    exact, peers = stiff.exact_rows(rows), stiff.peer_rows(rows)
    assert list(exact) == ["-5", "-5e2", "-5e4", "-5e6", "-5e8"]
    assert exact["-5e8"] == ["1.111", "1.00", "1.00", "2.0e-16", "1.0e-15"]
    assert peers["-5e8"] == ["10 000, 2.0e-09", "10 000, 2.0e-09", "stopped after 10 000"]
    for name, made in (("stiff exact", exact), ("stiff scipy", peers)):
        assert len(pages.with_rows(text, name, made).splitlines()) == len(text.splitlines())


def test_methods_are_written_with_their_ratio_to_the_exact_one(pages):
    race = benchmark("error_vs_time")
    from rig_sim.comparison.error_vs_time import Comparison, MethodResult

    keys = [*race.ROWS, race.TIGHTEST, ("heyoka", "tol 1e-18")]
    cpu = {("exact", "compiled"): 1e-5, ("exact", "interpreted"): 1e-3}
    rows = tuple(
        MethodResult(*key, 1e-9, cpu.get(key, 0.01), 1.0, "") if key != race.TIGHTEST
        else MethodResult(*key, None, 0.02, 1.0, "other events from t = 8.5")
        for key in keys
    )  # fmt: skip
    found = race.tables({"law 5": Comparison(rows=rows, **_others(Comparison))})
    assert found["error_vs_time scenes"] == {"law 5": ["1.0e-09", "other events", "2 000", "20"]}
    assert found["error_vs_time heyoka"] == {"law 5": ["1.0e-09", "1.0e-09", "1 000"]}
    assert found["error_vs_time methods"]["exact, interpreted"] == ["1.0e-09", "100"]
    text = (DOCS / "accuracy.md").read_text()
    for name, made in found.items():
        assert len(pages.with_rows(text, name, made).splitlines()) == len(text.splitlines())


def _others(kind):
    return {field.name: None for field in dataclasses.fields(kind) if field.name != "rows"}


def test_results_over_seeds_are_written_with_their_span(pages):
    seeds = benchmark("velocity_seeds")
    quantities = ("rms", "largest", "rms near re-sticks", "rms in sticks", "coverage", "coverage near re-sticks")
    rows = [{f"{case}: {key}": value for case in seeds.CASES for key in quantities} for value in (0.02, 0.04)]
    errors = seeds.error_rows(rows)
    assert errors["rms, mm/s"] == [*["0.030 (0.020 to 0.040)"] * 3, "-"]
    lost = {f"{size} counts over {width}": (size, width) for size, width in seeds.LOST}
    found = [{f"{name}: {key}": 1.0 for name in lost for key in ("recall", "size right", "false")} for _ in range(3)]
    del found[0]["3 counts over 1: size right"], found[1]["3 counts over 1: size right"]
    losses = seeds.loss_rows(found)
    assert losses["10 over 3 samples"] == ["1.000", "1.000", "3"]
    text = (DOCS / "velocity.md").read_text()
    for name, made in (("velocity_seeds errors", errors), ("velocity_seeds losses", losses)):
        assert len(pages.with_rows(text, name, made).splitlines()) == len(text.splitlines())


def test_camera_tracks_are_counted_by_their_noise(pages):
    camera = benchmark("camera")
    rows = [
        {"noise_mm": 0.2, "law": 5, "sets": [[5]], "covered": True},
        {"noise_mm": 0.2, "law": 4, "sets": [[4, 6]], "covered": False},
        {"noise_mm": 0.2, "law": 3, "sets": [[]]},
    ]
    made = camera.page_rows(rows)
    assert made["identification.md", "camera"] == {"0.2 mm": ["2/3", "1/1", "1/3"]}
    assert list(made["explanation/how-sure.md", "identify"].values()) == [["2 of 3", "1 of 1"]]
    for (page, name), cells in made.items():
        text = (DOCS / page).read_text()
        assert len(pages.with_rows(text, name, cells).splitlines()) == len(text.splitlines())


def test_errors_of_parameters_are_those_of_nine_runs_in_ten(pages):
    identify = benchmark("identify")
    value = {"value": 1.01, "truth": 1.0, "lo": 0.9, "hi": 1.1}
    rows = [
        {"scene": "nominal", "law": law, "parameters": {"k/m": value, "d": value | {"hi": 1.0, "lo": 1.005}}}
        for law in (2, 2, 4)
    ]
    made = identify.parameter_rows([*rows, {"scene": "harsh", "law": 2, "parameters": {"k/m": value}}])
    assert made == {"k/m": ["", "1.0 (2/2)", "", "1.0 (1/1)", "", ""], "d": ["", "1.0 (0/2)", "", "1.0 (0/1)", "", ""]}
    text = (DOCS / "identification.md").read_text()
    assert len(pages.with_rows(text, "identify parameters", made).splitlines()) == len(text.splitlines())
