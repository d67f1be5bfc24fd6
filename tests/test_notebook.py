"""docs/notebooks: the example is stored without outputs, and runs from a file of data_samples to its verdict."""

from pathlib import Path

import nbformat
import pytest

NOTEBOOK = Path(__file__).resolve().parent.parent / "docs" / "notebooks" / "example.ipynb"
LONGEST = 600  # characters of a value's short text


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_the_notebook_is_stored_without_outputs():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert len(code(notebook)) >= 10
    assert all(not cell.outputs and cell.execution_count is None for cell in code(notebook))


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
    assert printed.startswith("law 5 (friction falling hyperbolically)"), printed
    assert "adequate" in printed
