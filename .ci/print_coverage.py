"""Print how much of each room the tests ran, lines and branches, from the data that ``pytest --cov`` left."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

COUNTS = ("covered_lines", "num_statements", "covered_branches", "num_branches")


def main() -> None:
    """The table by rooms, and the total as the last line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "coverage.json"
        subprocess.run([sys.executable, "-m", "coverage", "json", "--quiet", "-o", path], check=True)
        report = json.loads(path.read_text(encoding="utf-8"))
    rooms: dict[str, Counter[str]] = defaultdict(Counter)
    for name, file in report["files"].items():
        parts = Path(name).parts
        inside = parts[parts.index("dousa") + 1 : -1]
        for room in {"/".join(inside[:2]) or "dousa", "total"}:
            rooms[room].update({count: file["summary"][count] for count in COUNTS})
    print(f"{'covered':24} {'lines':>8} {'branches':>9}")
    for room in sorted(rooms, key=lambda name: (name == "total", name)):
        lines, of_lines, branches, of_branches = (rooms[room][count] for count in COUNTS)
        print(f"{room:24} {share(lines, of_lines):>8} {share(branches, of_branches):>9}")


def share(part: int, whole: int) -> str:
    """Per cent, or a dash of nothing."""
    return f"{100.0 * part / whole:.1f} %" if whole else "-"


if __name__ == "__main__":
    main()
