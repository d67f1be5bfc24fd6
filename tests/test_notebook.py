"""docs/notebooks: stored with their outputs, they run from arrays to a verdict, and to bifurcations."""

import re
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "notebooks"
PICTURES = {"example.ipynb": 4, "bifurcations.ipynb": 5}
NOTEBOOKS = pytest.mark.parametrize("path", [FOLDER / name for name in PICTURES], ids=lambda path: path.stem)
NOTEBOOK = FOLDER / "example.ipynb"
LONGEST = 600  # characters of a value's short text


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_every_notebook_is_tested():
    assert {path.name for path in FOLDER.glob("*.ipynb")} == set(PICTURES)


@NOTEBOOKS
def test_a_notebook_is_stored_with_the_outputs_of_one_run_and_links_that_lead_somewhere(path):
    """It had no outputs: who read it without running it saw neither a table nor a picture."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert [cell.execution_count for cell in code(notebook)] == list(range(1, len(code(notebook)) + 1))
    assert all(cell.outputs for cell in code(notebook)[1:])  # the first one imports
    outputs = [output for cell in code(notebook) for output in cell.outputs]
    assert {output.output_type for output in outputs} == {"execute_result", "stream"}  # no error, no warning
    assert sum("image/png" in output.get("data", {}) for output in outputs) == PICTURES[path.name]
    # It names no place of the machine that ran it.
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    shown = [{"text": output.get("text", ""), **output.get("data", {})} for output in outputs]
    texts = [text for data in shown for kind, text in data.items() if kind != "image/png"]
    assert [text for text in texts if re.search(r"(?<![\w.<])/\w+/|[A-Z]:\\\\", text)] == []
    words = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    links = re.findall(r"\]\(([^)#]+)", words)
    assert links
    assert [link for link in links if not (FOLDER / link).is_file()] == []


def outputs_of_a_run(path):
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources=place).execute()
    return [output for cell in code(notebook) for output in cell.outputs]


@pytest.mark.slow
def test_bifurcations_of_a_fitted_contact_are_where_the_notebook_says():
    path = FOLDER / "bifurcations.ipynb"
    outputs = outputs_of_a_run(path)
    shown = [output.data for output in outputs if output.output_type == "execute_result"]
    assert sum("image/png" in data for data in shown) == PICTURES[path.name]
    stored = nbformat.read(path, as_version=4)
    kept = [output.data for cell in code(stored) for output in cell.outputs if output.output_type == "execute_result"]
    points, as_stored = (
        [data["text/plain"] for data in found if "hopf" in data["text/plain"]] for found in (shown, kept)
    )
    assert len(points) == 2
    for text, expected in zip(points, as_stored, strict=True):
        found, wanted = ([float(number) for number in re.findall(r"\d\.\d+", one)] for one in (text, expected))
        assert found == pytest.approx(wanted, rel=1e-4)
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "exact: log 2" in printed
    assert "outcome        locked" in printed


@pytest.mark.slow
def test_the_notebook_runs_from_arrays_to_its_verdict():
    outputs = outputs_of_a_run(NOTEBOOK)
    shown = [output.data for output in outputs if output.output_type == "execute_result"]
    assert (
        sum("image/png" in data for data in shown) == 4
    )  # of the run, the motion, the ranking, and the fit over the run
    assert sum("text/html" in data for data in shown) >= 5  # the three values and two tables
    values = [data["text/plain"] for data in shown if data["text/plain"].startswith("<") and "text/html" in data]
    assert len(values) == 3
    assert all(len(text) < LONGEST for text in values)
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    stored = nbformat.read(NOTEBOOK, as_version=4)
    assert printed.split("\n")[0] == code(stored)[-2].outputs[0].text.split("\n")[0]
    assert printed.startswith("law 5 (hyperbolic)"), printed
    assert "adequate" in printed
