"""`daq demo`: from an installation to a verdict with one command."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_demo_ends_in_a_verdict_and_a_report(tmp_path):
    command = [sys.executable, "-m", "daq.cli.app", "demo", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert "law 5" in answer["verdict"]
    assert [step["exit_code"] for step in answer["steps"]] == [0, 0, 0]
    assert Path(answer["report"]).stat().st_size > 10_000
