"""Three users' stories played in a real Chromium: how much somebody has to do, and how long they wait.

    python -m lab.reliability.studio_stories [DATA] [--only animator|teacher|researcher] [--language en|ja] [--most N]
        [--keep FOLDER]

The animator has a folder of mixed files (DATA, ``../shared/data`` by default) and wants a ZIP file of the 40 best kicks
on an own character. The teacher has three takes and a pupil, and wants a PDF. The researcher has four films of
one person and a stature, and wants a BVH and what is doubtful about it; without the films of DATA or without
``dousa keypoints --install`` three made films are taken, with the keypoints of the people in them beside them.

An action is a click, a drop of files, a choice of a list, or a field that is typed. Printed are actions, seconds that
the studio took until the next action was possible, and the longest of these waits; on Linux also the seconds of
processors that the studio and its work took, which a loaded machine does not change much. There is no peer: what is
counted is a page. A person adds their own time; nothing here is typed or clicked at human speed. All three are played
by one command, without anybody.
"""

from __future__ import annotations

import argparse
import base64
import os
import shutil
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

from lab.places import ROOT, SHARED_DATA

sys.path.insert(0, str(ROOT / "tests"))

from app.browser import Page, open_browser
from lab.benchmarks.studio_process import start_studio

DATA = SHARED_DATA
PATIENCE = 1200.0  # s
WIDTH, HEIGHT = 1440, 900
LARGEST = 30_000_000  # bytes of a file of the animator's folder: films are no motions
KICKS = 40


class Person:
    """Somebody at the page, whose actions are counted.

    Parameters
    ----------
    page : in a browser.
    url : of the studio.
    number : of its process.
    """

    def __init__(self, page: Page, url: str, number: int) -> None:
        self.page, self.url, self.number = page, url, number
        self.steps: list[tuple[str, float]] = []

    def _act(self, what: str, action: Callable[[], object], until: str) -> None:
        start, spent = time.monotonic(), read_processor_seconds(self.number)
        action()
        self.page.wait(until, seconds=PATIENCE)
        self.steps.append((what, time.monotonic() - start))
        spent = read_processor_seconds(self.number) - spent
        print(f"  {len(self.steps):3d}  {what}: {self.steps[-1][1]:.1f} s ({spent:.1f} s of processors)", flush=True)

    def open(self, path: str, until: str) -> None:
        """A page; no action of its own."""
        self.page.driver.get(f"{self.url}{path}")
        self.page.wait(until, seconds=PATIENCE)

    def click(self, what: str, selector: str, until: str) -> None:
        """Press what can be seen."""
        self._act(what, lambda: self.page.find(selector).click(), until)

    def choose(self, what: str, selector: str, value: str, until: str) -> None:
        """Choose of a list."""
        script = (
            "const one = document.querySelector(arguments[0]); one.value = arguments[1];"
            "one.dispatchEvent(new Event('change', {bubbles: true}));"
        )
        self._act(what, lambda: self.page.run(script, selector, value), until)

    def type(self, what: str, selector: str, text: str, until: str) -> None:
        """Fill a field."""
        self._act(what, lambda: self.page.find(selector).send_keys(text), until)

    def drop(self, what: str, selector: str, paths: Sequence[Path], until: str) -> None:
        """Files or a folder onto a zone."""
        self._act(what, lambda: self.page.find(selector).send_keys("\n".join(map(str, paths))), until)

    @property
    def summary(self) -> str:
        """Actions and waits."""
        waits = [seconds for _, seconds in self.steps]
        spent = read_processor_seconds(self.number)
        told = f"{len(waits)} actions, {sum(waits):.0f} s of waiting, the longest {max(waits):.0f} s"
        return f"{told}, {spent:.0f} s of processors" if spent else told


def read_processor_seconds(number: int) -> float:
    """What a process and its children that have ended took of processors, s; 0 where that is not told."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def wait_download(folder: Path, suffix: str) -> Path:
    """The file that the browser has fetched, whole."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = [path for path in folder.glob(f"*{suffix}") if path.stat().st_size]
        if found and not list(folder.glob("*.crdownload")):
            return found[0]
        time.sleep(0.05)
    raise SystemExit(f"no {suffix} came")


def stage_folder(data: Path, folder: Path, most: int) -> int:
    """Copies of the files of a data folder, as an animator may have them; how many. Browsers follow no links."""
    count = 0
    for path in sorted(data.rglob("*")):
        if count >= most or not path.is_file() or path.stat().st_size > LARGEST or path.suffix == ".mp4":
            continue
        place = folder / path.relative_to(data)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
        count += 1
    return count


def play_animator(person: Person, data: Path, work: Path, downloads: Path, most: int) -> str:
    """A folder of files to a ZIP of the best kicks on the own character."""
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic import draw_performer, make_motion

    hero = work / "hero.glb"
    write_motion(make_motion("bow", draw_performer(31)), hero)
    count = stage_folder(data, work / "mixed", most)
    cells = "return [...document.querySelectorAll('.cell')].filter((cell) => cell.checkVisibility()).length > 0"
    person.open("/library", "return document.querySelector('#add-button')?.checkVisibility()")
    person.click("Add", "#add-button", "return document.querySelector('#add-files-folder')")
    ready = "return document.querySelector('#add-go:not(:disabled)')"
    person.drop(f"drop a folder of {count} files", "#add-files-folder", [work / "mixed"], ready)
    person.click("add them", "#add-go", "return document.querySelector('#add-report')")
    person.click("close", "dialog .foot .primary", f"if (document.querySelector('dialog')) return false; {cells}")
    person.click("Train", "#train-button", "return document.querySelector('#train-go:not(:disabled)')")
    ended = "return !document.querySelector('#train-go, dialog progress')"
    trained = f"{ended} && document.querySelector('dialog .foot .primary')"
    person.click("train", "#train-go", trained)
    person.click("close", "dialog .foot .primary", "return !document.querySelector('dialog')")
    found = (
        "const cells = [...document.querySelectorAll('.cell')].filter((cell) => cell.checkVisibility());"
        "return cells.length > 0 && cells.every((cell) => /kick/i.test(cell.textContent + cell.title));"
    )
    person.type("type kick", "#text", "kick", found)
    # The first of the folder that is called so: of the others one lacks joints.
    person.page.run(
        "const cells = [...document.querySelectorAll('.cell')].filter((cell) => cell.checkVisibility());"
        "(cells.find((cell) => cell.textContent.includes(arguments[0])) ?? cells[0]).dataset.mine = '';",
        "kickLFront",
    )
    chosen = "return document.querySelector('#actions a[href^=\"/search\"]')"
    person.click("choose a kick", ".cell[data-mine]", chosen)
    hits = "return document.querySelectorAll('.hit').length > 0"
    person.click("Search with it", '#actions a[href^="/search"]', hits)
    person.click("options", ".options summary", "return document.querySelector('[name=k]')?.checkVisibility()")
    hits = f"return document.querySelectorAll('.hit').length >= {KICKS - 1}"  # the query is left out
    person.choose(f"{KICKS} hits", "[name=k]", str(KICKS), hits)
    person.click("Export", "#export-hits", "return document.querySelector('#character-file')")
    named = "return document.querySelector('.character-name')?.textContent === 'hero.glb'"
    person.drop("drop the character", "#character-file", [hero], named)
    person.click("export", "#export-go", "return document.querySelector('#export-file')")
    path = wait_download(downloads, ".zip")
    with zipfile.ZipFile(path) as archive:
        made = [name for name in archive.namelist() if name.endswith(".glb")]
    return f"{len(made)} GLB files in a ZIP of {path.stat().st_size / 1e6:.1f} MB"


def play_teacher(person: Person, work: Path, downloads: Path) -> str:
    """Three takes and a pupil to a PDF."""
    from app.studio.evaluation_cases import write_dances

    takes, pupil = write_dances(work)
    rows = "return document.querySelectorAll('{} .motion').length === {}".format
    person.open("/evaluate", "return document.querySelector('#performance-file')")
    person.drop("drop the pupil", "#performance-file", [pupil], rows("#performance", 1))
    person.drop("drop three takes", "#reference-file", takes, rows("#reference-list", 3))
    shown = "return document.querySelector('#print')?.checkVisibility() && document.querySelector('#player canvas')"
    person.click("Grade", "#grade", shown)
    person.page.run("window.print = () => { window.printed = true; }")
    person.click("Print or PDF", "#print", "return window.printed")
    answer = person.page.driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    content = base64.b64decode(answer["data"])
    (downloads / "report.pdf").write_bytes(content)
    return (
        f"a PDF of {len(content) / 1e3:.0f} kB, {content.count(b'/Type /Page') - content.count(b'/Type /Pages')} pages"
    )


def play_researcher(person: Person, data: Path, work: Path, downloads: Path) -> str:
    """Four films to a BVH and its doubts."""
    films = sorted((data / "pose2sim" / "videos").glob("*.mp4"))
    if not can_research(data):
        from app.studio.film_scenes import write_film_scene

        print("  no films or models here: made films, whose keypoints are known")
        (work / "films").mkdir()
        write_film_scene(work / "films")
        films = sorted((work / "films").iterdir())
    ready = "return !document.querySelector('#start').disabled || document.querySelector('#missing')"
    person.open("/estimate", "return document.querySelector('#material')")
    person.drop(f"drop {len(films)} files", "#material", films, ready)
    person.type("type the stature", "[name=stature]", "172", "return !document.querySelector('#start').disabled")
    person.click("Start", "#start", "return !document.querySelector('#outcome').hidden")
    doubts = person.page.run("return [...document.querySelectorAll('#outcome .says li')].map((one) => one.textContent)")
    person.click("Motion (BVH)", '#outcome a[download="motion.bvh"]', "return true")
    path = wait_download(downloads, ".bvh")
    return f"a BVH of {path.stat().st_size / 1e6:.1f} MB, {len(doubts)} doubts: {doubts[0][:90]} ..."


def can_research(data: Path) -> bool:
    """Whether there are films, and models that find people in them."""
    from dousa.app.pipelines.film_scene import has_models

    return len(list((data / "pose2sim" / "videos").glob("*.mp4"))) == 4 and has_models()


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?", default=DATA, help="folder of recordings")
    parser.add_argument("--only", choices=("animator", "teacher", "researcher"), help="one story")
    parser.add_argument("--language", choices=("en", "ja"), default="en", help="of the pages")
    parser.add_argument("--most", type=int, default=2500, help="files of the animator's folder")
    parser.add_argument("--keep", type=Path, help="folder for what comes out")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        work = Path(folder)
        stories: dict[str, Callable[[Person, Path], str]] = {
            "animator": lambda person, to: play_animator(person, asked.data, work, to, asked.most),
            "teacher": lambda person, to: play_teacher(person, work, to),
            "researcher": lambda person, to: play_researcher(person, asked.data, work / "researcher", to),
        }
        for name, play in stories.items():
            if asked.only not in (None, name):
                continue
            if name == "animator" and not asked.data.is_dir():
                print(f"{name}: left out, there are no recordings for it")
                continue
            tell_story(name, play, work / name, asked.keep, asked.language)


def tell_story(name: str, play: Callable[[Person, Path], str], work: Path, keep: Path | None, language: str) -> None:
    """One story on a new library in a new browser."""
    downloads = work / "downloads"
    downloads.mkdir(parents=True)
    process, port, token = start_studio(work / "moves.dousa", "--port", "0", folder=work)
    try:
        with open_browser(work / "profile") as page:
            page.resize(WIDTH, HEIGHT)
            behaviour = {"behavior": "allow", "downloadPath": str(downloads), "eventsEnabled": False}
            page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", behaviour)
            page.driver.get(f"http://127.0.0.1:{port}/library?token={token}")
            page.driver.add_cookie({"name": "dousa_lang", "value": language, "path": "/"})
            person = Person(page, f"http://127.0.0.1:{port}", process.pid)
            print(f"{name} ({language})", flush=True)
            came = play(person, downloads)
            print(f"{name}: {person.summary}: {came}", flush=True)
    finally:
        process.terminate()
        process.wait(timeout=30)
    if keep is not None:
        shutil.copytree(downloads, keep / name, dirs_exist_ok=True)


if __name__ == "__main__":
    main()
