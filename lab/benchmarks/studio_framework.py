"""Why the studio's pages are not made with NiceGUI: one screen of 60 cards in both, in one run.

NiceGUI keeps the elements of every open page on the server and sends changes over a web socket; the studio's pages are
plain modules that ask the interface. Ours is the Library page on 10,000 clips, with 60 figures at most alive; the
peer's is a page of 60 cards with an empty canvas, a name and a badge, and the fields above them: less work for it.
Printed: bytes of scripts and styles, time until shown (warm), and how the server's memory grows with page loads.

    make peers        # or: .venv-peers/bin/python -m lab.benchmarks.studio_framework
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from lab.places import ROOT

sys.path.insert(0, str(ROOT / "tests"))

from app.browser import open_browser
from lab.benchmarks.studio_process import start_studio

PEER = """
import sys
from nicegui import ui

@ui.page("/")
def cards():
    with ui.header():
        for name in ("Library", "Search", "Takes", "Evaluate", "Estimate"):
            ui.link(name, "/" + name)
    with ui.row():
        ui.input("Search"), ui.select(["a", "b"], label="Category"), ui.upload()
    with ui.grid(columns=6):
        for number in range(60):
            with ui.card():
                ui.html('<canvas width="150" height="150"></canvas>', sanitize=False)
                ui.label(f"clip {number}")
                ui.badge("kick")
    ui.label("ready").props("id=ready")

ui.run(host="127.0.0.1", port=int(sys.argv[1]), show=False, reload=False)
"""
SHOWN = {
    "NiceGUI": "return document.querySelector('#ready') && document.querySelectorAll('canvas').length === 60",
    "dousa": "return [...document.querySelectorAll('.cell canvas')].filter((canvas) => !canvas.hidden).length > 9",
}
SCRIPTS = r"""return performance.getEntriesByType('resource').filter((one) => /\.(m?js|css)(\?|$)/.test(one.name))
  .reduce((sum, one) => sum + one.decodedBodySize, 0)"""


def resident(pid: int) -> float:
    """MB of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(page: Any, address: str, shown: str, pid: int, loads: int) -> tuple[float, float, float]:
    """MB of scripts and styles, s until shown (median of warm loads), kB the server keeps for each load."""
    for _ in range(3):
        page.driver.get(address)
        page.wait(shown, seconds=60)
    size = page.run(SCRIPTS) / 1e6
    before, times = resident(pid), []
    for _ in range(loads):
        started = time.perf_counter()
        page.driver.get(address)
        page.wait(shown, seconds=60)
        times.append(time.perf_counter() - started)
    return size, statistics.median(times), 1000 * (resident(pid) - before) / loads


def run_peer(port: int, folder: Path) -> tuple[subprocess.Popen[str], str]:
    script = folder / "peer.py"
    script.write_text(PEER)
    process = subprocess.Popen([sys.executable, str(script), str(port)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if "ready to go" in line:
            return process, f"http://127.0.0.1:{port}/"
    raise SystemExit("NiceGUI did not start; is it installed? pip install nicegui")


def run_ours(library: Path) -> tuple[subprocess.Popen[str], str]:
    process, port, token = start_studio(library)
    return process, f"http://127.0.0.1:{port}/library?token={token}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path, required=True, help="of some 10,000 clips; see studio_page.py")
    parser.add_argument("--loads", type=int, default=40)
    chosen = parser.parse_args()
    print(f"{'':8} scripts MB  shown s  server kB a load")
    found = {}
    with tempfile.TemporaryDirectory() as name, open_browser(Path(name) / "profile") as page:
        page.resize(1280, 720)
        library = chosen.library or Path(name) / "large.dousa"
        if chosen.library is None:
            from lab.benchmarks.search import make_library

            make_library(library, 10_000, 40)
        for who in ("NiceGUI", "dousa"):
            start = run_peer(8890, Path(name)) if who == "NiceGUI" else run_ours(library)
            process, address = start
            try:
                found[who] = measure(page, address, SHOWN[who], process.pid, chosen.loads)
            finally:
                process.terminate()
                process.wait()
            print(f"{who:8} {found[who][0]:10.2f} {found[who][1]:8.2f} {found[who][2]:17.0f}")
    ratios = [theirs / ours for theirs, ours in zip(found["NiceGUI"], found["dousa"], strict=True)]
    print(f"{'ratio':8} {ratios[0]:10.1f} {ratios[1]:8.1f}")


if __name__ == "__main__":
    main()
