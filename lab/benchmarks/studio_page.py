"""The pages of the studio on a large library, in a real Chromium: how long until they show, how smoothly they move.

    python -m lab.benchmarks.studio_page [--library FILE] [--clips N] [--loads N] [--only NAME ...]

Without ``--library`` one of 10,000 made clips is made first, as in ``search.py``, in a tree of categories
of three levels (a category for every 25 clips), and trained. Prints for the Library page at 1280 x 720: from the click
to the last small figure of the first screen, warm; from the last key of a text, and from a click in the tree of
categories, to the list; frames while it stands and while it scrolls; how many figures run and how many cells exist
then; memory of the page before and after; from the address of a search to its hits; and how long the map of all clips
takes, its frames while it is moved, and from the end of a line drawn around clips to these being chosen.
Goal: first page within 1 s warm, texts and tree 0.2 s, 16.7 ms a frame, no more than a screenful of figures alive.
There is no peer: what is measured is a page. ``MEASUREMENTS`` takes further ones.
"""

from __future__ import annotations

import argparse
import socket
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn

from lab.places import ROOT

sys.path.insert(0, str(ROOT / "tests"))

from app.browser import Page, open_browser
from dousa.app.studio import Settings, create_app
from dousa.library import Library
from dousa.library.store.checksums import LABELS
from dousa.library.store.engine import next_revision, take_clip_ids
from dousa.library.store.rows import update_rows

TOKEN = "benchmark"
WIDTH, HEIGHT = 1280, 720
SPEEDS = (300, 1000, 4000, 40000)  # px/s
SECONDS = 5.0  # of each scroll

# The time when every cell that can be seen shows its figure, ms since the navigation began; null before.
DRAWN = """
const seen = [...document.querySelectorAll('.cell')].filter((cell) => {
  const { top, bottom } = cell.getBoundingClientRect();
  return top < innerHeight && bottom > 0 && cell.style.visibility !== 'hidden';
});
const drawn = seen.filter((cell) => !cell.querySelector('canvas').hidden);
const ready = seen.length > 0 && drawn.length === seen.length && dousa.miniatures.drawn >= seen.length;
return ready ? performance.now() : null;
"""
# The time when the hits stand there, and their figures are drawn, ms since the navigation began; null before.
FOUND = """
const hits = [...document.querySelectorAll('.hit')];
return hits.length ? performance.now() : null;
"""
SCROLL = """
const [speed, seconds, done] = arguments;
const pane = document.querySelector('#grid-scroll');
const [frames, start, from] = [[], performance.now(), pane.scrollTop];
let [last, alive, cells] = [null, 0, 0];
const tick = (now) => {
  if (last !== null) frames.push(now - last);
  last = now;
  alive = Math.max(alive, dousa.miniatures.alive);
  cells = Math.max(cells, document.querySelectorAll('.cell').length);
  const passed = (now - start) / 1000;
  if (passed > seconds) done({ frames, alive, cells });
  else {
    pane.scrollTo({ top: from + passed * speed, behavior: 'instant' });
    requestAnimationFrame(tick);
  }
};
requestAnimationFrame(tick);
"""
# Frames while the map is dragged round and round, and zoomed.
DRAG = """
const [seconds, done] = arguments;
const { view } = document.querySelector('.mp-over').map;
const [frames, start] = [[], performance.now()];
let last = null;
const tick = (now) => {
  if (last !== null) frames.push(now - last);
  last = now;
  const passed = (now - start) / 1000;
  if (passed > seconds) done(frames);
  else {
    view.shift(9 * Math.cos(passed), 9 * Math.sin(passed));
    view.scale(1 + 0.01 * Math.cos(2 * passed));
    requestAnimationFrame(tick);
  }
};
requestAnimationFrame(tick);
"""

# From an action to the list that follows from it, ms; the field of texts waits 80 ms for another key.
ACT = """
const [action, value, done] = arguments;
const count = document.querySelector('#count');
const [before, start] = [count.textContent, performance.now()];
const field = (selector, text) => {
  const one = document.querySelector(selector);
  one.value = text;
  one.dispatchEvent(new Event('input'));
};
const look = () => {
  if (action === 'search the tree') {
    if (document.querySelector('.tree-rows').dataset.asked !== 'before') return done(performance.now() - start);
  } else if (count.textContent !== before) return done(performance.now() - start);
  requestAnimationFrame(look);
};
if (action === 'text') field('#text', value);
else if (action === 'tree') document.querySelectorAll('.tree-rows input')[value].click();
else {
  document.querySelector('.tree-rows').dataset.asked = 'before';
  field('#tree-field', value);
}
requestAnimationFrame(look);
"""
# From the end of a line drawn around the clips of the map to these being chosen and drawn, ms; and how many they are.
LASSO = """
const [part, done] = arguments;
const over = document.querySelector('.mp-over');
const box = over.getBoundingClientRect();
const send = (type, turn) => {
  const reach = (part * Math.min(box.width, box.height)) / 2;
  const [x, y] = [box.width / 2 + reach * Math.cos(turn), box.height / 2 + reach * Math.sin(turn)];
  const place = { clientX: box.left + x, clientY: box.top + y, pointerId: 1, pointerType: 'mouse', button: 0 };
  over.dispatchEvent(new PointerEvent(type, { ...place, bubbles: true }));
};
over.setPointerCapture = () => {};
send('pointerdown', 0);
const steps = 120;
for (let k = 1; k < steps; k += 1) send('pointermove', (2 * Math.PI * k) / steps);
requestAnimationFrame(() => requestAnimationFrame(() => {
  const start = performance.now();
  send('pointerup', 2 * Math.PI);
  requestAnimationFrame(() => requestAnimationFrame(() =>
    done([performance.now() - start, document.querySelector('.chosen-count')?.textContent ?? 'none'])));
}));
"""


@dataclass(frozen=True, slots=True)
class Studio:
    """A running studio and a browser that looks at it.

    Parameters
    ----------
    url : without a slash at its end.
    page : the browser.
    """

    url: str
    page: Page

    def show(self, path: str) -> None:
        """Open a page of the studio."""
        self.page.driver.get(f"{self.url}{path}")

    def metrics(self) -> dict[str, float]:
        """What the browser counts of the page: seconds of work and bytes."""
        answer = self.page.driver.execute_cdp_cmd("Performance.getMetrics", {})
        return {item["name"]: item["value"] for item in answer["metrics"]}

    def script_bytes(self) -> float:
        """Memory of the page's scripts without what nobody needs any more."""
        self.page.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
        return self.metrics()["JSHeapUsedSize"]


@contextmanager
def running(library: Path, home: Path) -> Iterator[Studio]:
    """A studio on a free port, and a fresh browser that knows its token."""
    with socket.socket(proto=socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        app = create_app(Settings(library, port=port, token=TOKEN, home=home / "studio"))
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.01)
        try:
            with open_browser(home / "profile") as page:
                page.resize(WIDTH, HEIGHT)
                page.driver.set_script_timeout(60)
                page.driver.execute_cdp_cmd("Performance.enable", {})
                studio = Studio(f"http://127.0.0.1:{port}", page)
                studio.show(f"/library?token={TOKEN}")
                yield studio
        finally:
            server.should_exit = True
            thread.join(timeout=20)


def measure_first_page(studio: Studio, loads: int) -> None:
    """Navigation until all figures of the first screen are drawn."""
    cold = studio.page.wait(DRAWN, seconds=60)
    print(f"library, first page, cold (list read, figures made): {cold:.0f} ms")
    times = []
    for _ in range(loads):
        studio.show("/library")
        times.append(studio.page.wait(DRAWN))
    print(f"library, first page, warm: median {statistics.median(times):.0f} ms, worst {max(times):.0f} ms")


def measure_choosing(studio: Studio, loads: int) -> None:
    """Texts that are typed and categories that are chosen, until the list is there."""
    studio.show("/library")
    studio.page.wait(DRAWN)
    texts = ["kind 07", "0012", "kinnd 03", "kick", "set 2 kind 11", "nothing of the kind"]
    values: dict[str, list[Any]] = {"text": texts, "tree": [1, 2, 3, 1, 2, 3], "search the tree": ["kind 1", "07", "s"]}
    for action, own in values.items():
        if action == "search the tree" and not studio.page.run("return document.querySelector('#tree-field') !== null"):
            print("search in the tree: too few categories")
            continue
        times = []
        for value in own:
            times.append(studio.page.driver.execute_async_script(ACT, action, value))
            if action == "text":
                studio.page.driver.execute_async_script(ACT, action, "")
        told = ", ".join(f"{value} {time:.0f}" for value, time in zip(own, times, strict=True))
        print(f"{action}: median {statistics.median(times):.0f} ms, worst {max(times):.0f} ms ({told})")


def measure_scrolling(studio: Studio, loads: int) -> None:
    """Frames at several speeds, from the top each time."""
    studio.show("/library")
    studio.page.wait(DRAWN)
    before = studio.script_bytes()
    for speed in (0, *SPEEDS):
        studio.page.run("document.querySelector('#grid-scroll').scrollTo(0, 0)")
        studio.page.wait(DRAWN)
        start = studio.metrics()
        seen = studio.page.driver.execute_async_script(SCROLL, speed, SECONDS)
        end = studio.metrics()
        work = 1e3 * (end["ThreadTime"] - start["ThreadTime"]) / len(seen["frames"])
        print(
            f"library, {speed} px/s: {describe(seen['frames'])}; main thread {work:.1f} ms of CPU a frame; "
            f"{seen['alive']} figures run, {seen['cells']} cells"
        )
    after = studio.script_bytes()
    print(f"library, memory of scripts: {before / 1e6:.1f} MB before, {after / 1e6:.1f} MB after scrolling")


def measure_map(studio: Studio, loads: int) -> None:
    """The job that makes the map, its page, and frames while it is moved."""
    start = time.perf_counter()
    studio.show("/library?view=map")
    shown = "return document.querySelector('.mp-over')?.map.ids.length > 0 ? performance.now() : null"
    studio.page.wait(shown, seconds=600)
    print(f"map, made and shown: {time.perf_counter() - start:.0f} s")
    times = []
    for _ in range(loads):
        studio.show("/library?view=map")
        times.append(studio.page.wait(shown))
    print(
        f"map, from the address to the dots, warm: median {statistics.median(times):.0f} ms, worst {max(times):.0f} ms"
    )
    before = studio.metrics()
    frames = studio.page.driver.execute_async_script(DRAG, SECONDS)
    work = 1e3 * (studio.metrics()["ThreadTime"] - before["ThreadTime"]) / len(frames)
    print(f"map, moved and zoomed: {describe(frames)}; main thread {work:.1f} ms of CPU a frame")
    studio.show("/library?view=map")
    studio.page.wait(shown)
    for part in (0.3, 1.4):
        found = [studio.page.driver.execute_async_script(LASSO, part) for _ in range(loads)]
        median = statistics.median(time for time, _ in found)
        print(f"map, lasso: {found[0][1]}: median {median:.0f} ms, worst {max(time for time, _ in found):.0f} ms")


def measure_search(studio: Studio, loads: int) -> None:
    """Navigation to a search until the hits stand there: the page, the question and the answer."""
    ids = studio.page.run("return fetch('/api/clips?limit=200').then((answer) => answer.json())")
    clips = [item["motion"] for item in ids["items"] if item["kind"] == "clip"]
    times = []
    for number in range(loads + 1):
        studio.show(f"/search?motion={clips[17 * number % len(clips)]}")
        times.append(studio.page.wait(FOUND, seconds=60))
    first, later = times[0], times[1:]
    print(
        f"search, from the address to the hits: first {first:.0f} ms, then median {statistics.median(later):.0f} ms, "
        f"worst {max(later):.0f} ms"
    )


def describe(frames: Sequence[float]) -> str:
    """Frame times in words."""
    ordered = sorted(frames)
    late = sum(frame > 17.5 for frame in frames)
    return (
        f"median {statistics.median(ordered):.1f} ms, 99 of 100 within {ordered[int(0.99 * len(ordered))]:.1f} ms, "
        f"{late} of {len(ordered)} frames late"
    )


MEASUREMENTS: tuple[Callable[[Studio, int], None], ...] = (
    measure_first_page,
    measure_choosing,
    measure_scrolling,
    measure_map,
    measure_search,
)
"""What is measured, one after the other, on the same studio."""


def name_category(number: int) -> str:
    """A category of three levels, of which there is one for every 25 clips."""
    kind = (number - 1) % 40
    return f"set {kind // 8}/kind {kind:02}/way {(number - 1) // 1000:03}"


def make_library(path: Path, n_clips: int) -> None:
    from lab.benchmarks.search import make_library as make

    make(path, n_clips, 40)
    with Library.open(path) as library, library.database.writing() as connection:
        next_revision(connection)
        ids = take_clip_ids(connection, 1)[0]
        places = {number: {"category": name_category(number)} for number in range(1, ids)}
        update_rows(connection, LABELS, places)
    with Library.open(path) as library:
        library.train()  # for the search


def main(arguments: Sequence[str] | None = None) -> Any:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path, help="a trained library; nothing is changed in it")
    parser.add_argument("--clips", type=int, default=10_000, help="of the library that is made")
    parser.add_argument("--loads", type=int, default=9, help="of the first page")
    names = [measure.__name__.removeprefix("measure_") for measure in MEASUREMENTS]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="what is measured")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        library = options.library
        if library is None:
            library = Path(folder, "large.dousa")
            make_library(library, options.clips)
        with running(library, Path(folder)) as studio:
            for measure in (one for name, one in zip(names, MEASUREMENTS, strict=True) if name in options.only):
                measure(studio, options.loads)


if __name__ == "__main__":
    main()
