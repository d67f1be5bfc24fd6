"""Look the versions of constraints.txt, or of the file named, up among known vulnerabilities, with pip-audit.

A vulnerability that was found is an error.  Where the advisory service does not answer, as on a machine without a
network, nothing is audited; a line reports this, and the exit code is 0.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
# Words of pip-audit's error where the service does not answer.  Every other failure is an error.
UNREACHABLE = ("ConnectionError", "Could not connect", "timed out", "Timeout", "ProxyError", "SSLError", "503 ", "502 ")


def main() -> int:
    """Run pip-audit; return the exit code."""
    versions = sys.argv[1] if len(sys.argv) > 1 else str(ROOT / "constraints.txt")
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "audit.json"
        line = [sys.executable, "-m", "pip_audit", "-r", versions, "--no-deps", "--disable-pip"]
        line += ["--progress-spinner", "off", "--format", "json", "--output", str(found)]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        content = found.read_text(encoding="utf-8") if found.exists() else ""
    if not content:
        if any(word in done.stderr for word in UNREACHABLE):
            sys.stdout.write("audit: the advisory service does not answer: nothing was audited\n")
            return 0
        sys.stderr.write(done.stderr)
        return 1
    return report(json.loads(content)["dependencies"])


def report(dependencies: list[dict[str, Any]]) -> int:
    """Print what was found; return 1 if any dependency has a known vulnerability."""
    skipped = [str(each["name"]) for each in dependencies if "skip_reason" in each]
    audited = [each for each in dependencies if "skip_reason" not in each]
    bad = [each for each in audited if each["vulns"]]
    for each in bad:
        for one in each["vulns"]:
            fixed = ", ".join(one["fix_versions"]) or "no version"
            sys.stderr.write(f"audit: {each['name']} {each['version']}: {one['id']}, fixed in {fixed}\n")
    unknown = f"; the advisory service does not know {', '.join(skipped)}" if skipped else ""
    if skipped and not audited:
        unknown = ": the advisory service answers for none of them"
    sys.stdout.write(f"audit: {len(audited)} of {len(dependencies)} versions audited, {len(bad)} vulnerable{unknown}\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
