"""The terminal: whatever goes wrong in a command is one document under --json."""

import json

from daq import terminal
from daq.errors import EXIT_DEVICE


def test_a_system_error_without_a_file_name_is_a_json_document_too(capsys):
    # It used to be taken for a stdout that cannot be written to, and told on stderr alone.
    app = terminal.application("rig", "A rig.", "rig fail")

    @app.command
    def fail(*, json: terminal.Json = False) -> terminal.Answer:
        """Fail.  Example: rig fail."""
        raise OSError(5, "Input/output error")

    assert terminal.run(app, ["fail", "--json"]) == EXIT_DEVICE
    out, err = capsys.readouterr()
    assert json.loads(out)["error"]["what"] == "Input/output error"
    assert err == ""
