"""docs/notebooks: the example is stored with its outputs, and runs from a file of data_samples to its verdict."""

import re
from pathlib import Path

import nbformat
import pytest

NOTEBOOK = Path(__file__).resolve().parent.parent / "docs" / "notebooks" / "example.ipynb"
LONGEST = 600  # characters of a value's short text


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_the_notebook_is_stored_with_the_outputs_of_one_run():
    """It had none: who read it without running it saw neither a table nor a picture."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert [cell.execution_count for cell in code(notebook)] == list(range(1, len(code(notebook)) + 1))
    assert all(cell.outputs for cell in code(notebook)[1:])  # the first one imports
    outputs = [output for cell in code(notebook) for output in cell.outputs]
    assert {output.output_type for output in outputs} == {"execute_result", "stream"}  # no error, no warning
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3


def test_the_notebook_names_no_place_of_the_machine_that_ran_it():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    shown = [output.get("text", "") for cell in code(notebook) for output in cell.outputs]
    shown += [
        text
        for cell in code(notebook)
        for output in cell.outputs
        for kind, text in output.get("data", {}).items()
        if kind != "image/png"
    ]
    assert not [text for text in shown if re.search(r"(?<![\w.<])/\w+/|[A-Z]:\\\\", text)]


def test_the_links_of_the_notebook_exist():
    """The link to "From Python" led to a page that is not there."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    words = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    links = re.findall(r"\]\(([^)#]+)", words)
    assert links
    for link in links:
        assert (NOTEBOOK.parent / link).is_file(), link


@pytest.mark.slow
def test_the_notebook_runs_from_a_file_to_its_verdict():
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    place = {"metadata": {"path": str(NOTEBOOK.parent)}}
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources=place).execute()
    outputs = [output for cell in code(notebook) for output in cell.outputs]
    shown = [output.data for output in outputs if output.output_type == "execute_result"]
    assert sum("image/png" in data for data in shown) == 3  # plot() of the run, the motion and the ranking
    assert sum("text/html" in data for data in shown) >= 5  # the three values and two tables
    values = [data["text/plain"] for data in shown if data["text/plain"].startswith("<") and "text/html" in data]
    assert len(values) == 3
    assert all(len(text) < LONGEST for text in values)
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    stored = nbformat.read(NOTEBOOK, as_version=4)
    assert printed.split("\n")[0] == code(stored)[-2].outputs[0].text.split("\n")[0]
    assert printed.startswith("law 5 (friction falling hyperbolically)"), printed
    assert "adequate" in printed
