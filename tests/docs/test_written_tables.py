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


@pytest.mark.parametrize("damage", ["begin: race methods", "end: race methods"])
def test_a_page_without_the_marker_is_refused_and_left_alone(pages, tmp_path, damage):
    (tmp_path / "page.md").write_text(PAGE.replace(damage, "other"))
    with pytest.raises(ValueError, match="race methods"):
        pages.write("page.md", "race methods", {"exact": ["2e-14", "1"]}, docs=tmp_path)
    assert (tmp_path / "page.md").read_text() == PAGE.replace(damage, "other")


def test_every_marked_table_names_a_benchmark_that_writes_it(pages):
    named = set()
    for path in sorted(DOCS.rglob("*.md")):
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


VALUE = {"value": 1.01, "truth": 1.0, "lo": 0.9, "hi": 1.1}
SCENES = [
    {"scene": "nominal", "law": 3, "set": [3]},
    {"scene": "nominal", "law": 5, "set": [5, 6]},
    {"scene": "nominal", "law": 5, "set": [6]},
]
TRACKS = [
    {"noise_mm": 0.2, "law": 5, "sets": [[5]], "covered": True},
    {"noise_mm": 0.2, "law": 4, "sets": [[4, 6]], "covered": False},
    {"noise_mm": 0.2, "law": 3, "sets": [[]]},
]


def identified(identify):
    made = identify.page_rows(SCENES)
    rows = [
        {"scene": scene, "law": law, "parameters": {"k/m": VALUE, "d": VALUE | {"hi": 1.0, "lo": 1.005}}}
        for scene, law in (("nominal", 2), ("nominal", 2), ("nominal", 4), ("harsh", 2))
    ]
    return made | {("identification.md", "identify parameters"): identify.parameter_rows(rows)}


def ramps(stiff):
    row = {"steps_per_cycle": 9.0, "compiled_s": 2e-6, "interpreted_s": 2e-4}
    row |= {"exact_error": 2e-16, "exact_t_error": 1e-15}
    row |= {f"{method}_s": 0.02 for method, _ in stiff.PEERS} | {f"{method}_t_error": 2e-9 for method, _ in stiff.PEERS}
    rows = [row | {"G_stick": slope} for slope in stiff.SLOPES]
    rows[-1] |= {"steps_per_cycle": 10.0, "dop853_t_error": None}
    tables = {"stiff exact": stiff.exact_rows(rows), "stiff scipy": stiff.peer_rows(rows)}
    return {("accuracy.md", name): made for name, made in tables.items()}


def methods(race):
    from rig_sim.comparison.error_vs_time import Comparison, MethodResult

    cpu = {("exact", "compiled"): 1e-5, ("exact", "interpreted"): 1e-3}
    rows = tuple(
        MethodResult(*key, 1e-9, cpu.get(key, 0.01), 1.0, "")
        for key in (*race.ROWS, ("heyoka", "tol 1e-18"))
        if key != race.TIGHTEST
    )
    rows += (MethodResult(*race.TIGHTEST, None, 0.02, 1.0, "other events from t = 8.5"),)
    others = {field.name: None for field in dataclasses.fields(Comparison) if field.name != "results"}
    made = race.tables({"law 5": Comparison(results=rows, **others)})
    return {("accuracy.md", name): rows for name, rows in made.items()}


def seeds(seeds):
    quantities = ("rms", "largest", "rms near re-sticks", "rms in sticks", "coverage", "coverage near re-sticks")
    rows = [{f"{case}: {key}": value for case in seeds.CASES for key in quantities} for value in (0.02, 0.04)]
    lost = [f"{size} counts over {width}" for size, width in seeds.LOST]
    found = [{f"{name}: {key}": 1.0 for name in lost for key in ("recall", "size right", "false")} for _ in range(3)]
    del found[0]["3 counts over 1: size right"], found[1]["3 counts over 1: size right"]
    tables = {"velocity_seeds errors": seeds.error_rows(rows), "velocity_seeds losses": seeds.loss_rows(found)}
    return {("velocity.md", name): made for name, made in tables.items()}


# What a benchmark makes of what it found, and rows of it: page, table, name of the row, cells.
MADE = {
    "identify": (
        identified,
        [
            ("identification.md", "identify", "nominal", ["2/3", "2/3", "1/3", "1/2"]),
            ("identification.md", "identify laws", "nominal", ["0/0", "0/0", "1/1", "0/0", "0/2", "0/0"]),
            ("explanation/how-sure.md", "identify", None, ["2 of 3", "1 of 2"]),
            ("identification.md", "identify parameters", "k/m", ["", "1.0 (2/2)", "", "1.0 (1/1)", "", ""]),
            ("identification.md", "identify parameters", "d", ["", "1.0 (0/2)", "", "1.0 (0/1)", "", ""]),
        ],
    ),
    "stiff": (
        ramps,
        [
            ("accuracy.md", "stiff exact", "-5e8", ["1.111", "1.00", "1.00", "2.0e-16", "1.0e-15"]),
            (
                "accuracy.md",
                "stiff scipy",
                "-5e8",
                ["10 000, 2.0e-09", "10 000, 2.0e-09", "stopped after 10 000"],
            ),
        ],
    ),
    "error_vs_time": (
        methods,
        [
            ("accuracy.md", "error_vs_time scenes", "law 5", ["1.0e-09", "other events", "2 000", "20"]),
            ("accuracy.md", "error_vs_time heyoka", "law 5", ["1.0e-09", "1 000"]),
            ("accuracy.md", "error_vs_time methods", "exact, interpreted", ["1.0e-09", "100"]),
        ],
    ),
    "velocity_seeds": (
        seeds,
        [
            ("velocity.md", "velocity_seeds errors", "rms, mm/s", [*["0.030 (0.020 to 0.040)"] * 3, "-"]),
            ("velocity.md", "velocity_seeds losses", "10 over 3 samples", ["1.000", "1.000", "3"]),
        ],
    ),
    "camera": (
        lambda camera: camera.page_rows(TRACKS),
        [
            ("identification.md", "camera", "0.2 mm", ["2/3", "1/1", "1/3"]),
            ("explanation/how-sure.md", "identify", None, ["2 of 3", "1 of 1"]),
        ],
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_a_benchmark_writes_what_it_found_into_rows_of_its_tables(pages, name):
    make, expected = MADE[name]
    made = make(benchmark(name))
    for page, table, row, cells in expected:
        rows = made[page, table]
        assert rows[row or next(iter(rows))] == cells, (table, row)
    for (page, table), rows in made.items():
        text = (DOCS / page).read_text()
        written = pages.with_rows(text, table, rows).splitlines()
        assert len(written) == len(text.splitlines())
        changed = {line for line in written if line not in text.splitlines()}
        assert changed <= {f"| {' | '.join([row, *cells])} |" for row, cells in rows.items()}
    with pytest.raises(ValueError, match="1 cells; the table has"):
        pages.with_rows(text, table, {next(iter(rows)): []})
