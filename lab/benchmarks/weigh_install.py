"""What dousa weighs on the disk: a fresh environment with everything, and the share of each package and extra.

    python -m lab.benchmarks.weigh_install [--keep FOLDER]

Needs the package index. Sizes are what the files occupy, byte code included. A package counts for the first group that
asks for it, in the order plain, film, pictures, studio: a row of the last table says what an extra adds.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from lab.places import ROOT

# Run by the fresh interpreter: what is installed, what it occupies, and what asks for what.
_LOOK = """
import json, os
from importlib import metadata
found = {}
for dist in metadata.distributions():
    paths = {os.path.realpath(dist.locate_file(file)) for file in dist.files or ()}
    size = sum(os.stat(path).st_blocks * 512 for path in paths if os.path.isfile(path))
    found[dist.metadata["Name"]] = [size, dist.requires or []]
print(json.dumps(found))
"""


def plain(name: str) -> str:
    """The name of a package as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def read_requirement(text: str, extra: str) -> str | None:
    """The package that a line of metadata asks for; None if it asks only under another extra, system or Python."""
    from packaging.requirements import Requirement

    wanted = Requirement(text)
    if wanted.marker is not None and not wanted.marker.evaluate({"extra": extra}):
        return None
    return plain(wanted.name)


def reach(found: dict[str, tuple[int, list[str]]], extra: str) -> set[str]:
    """The packages that dousa with one extra (or with none: an empty name) brings."""
    reached: set[str] = set()
    waiting = [("dousa", extra)]
    while waiting:
        name, asked = waiting.pop()
        if name not in found:
            continue
        reached.add(name)
        for text in found[name][1]:
            needed = read_requirement(text, asked)
            if needed == "dousa":
                waiting += [("dousa", other) for other in re.findall(r"[\w-]+", text.partition("]")[0])[1:]]
            elif needed is not None and needed not in reached:
                waiting.append((needed, ""))
    return reached


def weigh(folder: Path) -> dict[str, tuple[int, list[str]]]:
    """What a fresh environment in the folder holds: bytes and requirements of each package."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "-c", ROOT / "constraints.txt", f"{ROOT}[all]"], check=True)
    answer = subprocess.run([python, "-c", _LOOK], check=True, capture_output=True, text=True)
    return {plain(name): (size, needs) for name, (size, needs) in json.loads(answer.stdout).items()}


def print_table(found: dict[str, tuple[int, list[str]]]) -> None:
    """The packages by weight, and what each extra adds."""
    groups = {name: reach(found, "" if name == "plain" else name) for name in ("plain", "film", "pictures", "studio")}
    print(f"{'package':28} {'MB':>6}  in")
    for name, (size, _) in sorted(found.items(), key=lambda item: -item[1][0]):
        where = [group for group, members in groups.items() if name in members]
        where = where[:1] if "plain" in where else where
        if size >= 500_000:
            print(f"{name:28} {size / 1e6:6.1f}  {', '.join(where) or 'every environment'}")
    before: set[str] = set()
    print(f"\n{'group':28} {'MB':>6}")
    for group, members in groups.items():
        print(f"{'+ ' * (group != 'plain') + group:28} {sum(found[n][0] for n in members - before) / 1e6:6.1f}")
        before |= members


def main() -> None:
    """Install, weigh, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="a folder for the environment, which stays")
    folder = parser.parse_args().keep
    if folder is not None:
        print_table(weigh(folder))
        return
    with tempfile.TemporaryDirectory() as temporary:
        print_table(weigh(Path(temporary)))


if __name__ == "__main__":
    main()
