"""Pictures of the pages of the studio, from a real Chromium on the demo's library.

The demonstration is made first (``--demo DIR`` takes one that is there). ``--looks DIR`` takes, instead of the pictures
of the documents, every page at three widths, light and dark, in both languages: a sheet for each of the twelve, to look
at. Needs chromium with chromedriver; without them the pictures stay as they are.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from lab.places import DOCS

FIGURES = DOCS / "figures"
sys.path.insert(0, str(DOCS.parent / "tests"))

DATA, PHONES = DOCS.parent.parent / "shared" / "data" / "pose2sim" / "videos", ("01", "04")
SETTLE = 2.5  # s: figures move, so that a picture has somebody in the middle of something
SIZES = ((390, 844), (1440, 900), (2560, 1440))  # CSS px of the looks
SHEET, SHEET_WIDTH = 620, 2300  # px: height of a page on a sheet, most of a sheet's width
COLOURS = 256  # of a picture: few bytes, and shades without steps
SCROLLED = {"evaluate": 330, "films": 335}
SCRIPTS = {
    "films": "const f = document.querySelector('#film-frame'); f.value = 44; f.dispatchEvent(new Event('input'))"
}  # px: advice and player say more than the grade


@dataclass(frozen=True, slots=True)
class Studio:
    """A studio that listens.

    Parameters
    ----------
    url, token : of its address.
    """

    url: str
    token: str

    def ask(self, path: str, body: Any = None) -> Any:
        """The answer of an address below /api; bytes are sent as they are, the rest as JSON."""
        headers = {"authorization": f"Bearer {self.token}"}
        if body is not None and not isinstance(body, bytes):
            body, headers["content-type"] = json.dumps(body).encode(), "application/json"
        request = urllib.request.Request(f"{self.url}/api{path}", body, headers)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)

    def finish(self, job: dict[str, Any]) -> str:
        """Wait for a job; its number."""
        while (now := self.ask(f"/jobs/{job['id']}"))["state"] in ("queued", "running"):
            time.sleep(0.2)
        if now["state"] != "done":
            raise SystemExit(f"{now['kind']}: {now['state']}: {now['problem']}")
        return str(job["id"])

    def clip(self, **filters: str) -> str:
        """The first clip or take of a filter, as other addresses name it."""
        query = "&".join(f"{name}={value}" for name, value in filters.items())
        return str(self.ask(f"/clips?limit=1&{query}")["items"][0]["motion"])


@contextmanager
def listening(library: Path) -> Iterator[Studio]:
    """A studio in a thread."""
    import socket

    import uvicorn

    from dousa.app.studio import Settings, create_app

    with socket.socket(proto=socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        settings = replace(Settings(library), port=listener.getsockname()[1])
        server = uvicorn.Server(uvicorn.Config(create_app(settings), log_level="warning", access_log=False))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        while not server.started:
            time.sleep(0.01)
        try:
            yield Studio(f"http://127.0.0.1:{settings.port}", settings.token)
        finally:
            server.should_exit = True
            thread.join()


def addresses(studio: Studio, demo: Path) -> dict[str, tuple[str, str]]:
    """Page and, in CSS, what is there once it shows what it should; by the name of the picture."""
    upload = studio.ask("/uploads?name=seen.npz", (demo / "seen.npz").read_bytes())
    estimated = studio.finish(studio.ask("/jobs/estimate", {"batch": upload["batch"], "body": {"stature_m": 1.77}}))
    pupil = studio.clip(kind="take", text="dance_pupil")
    model = studio.clip(kind="take", text="dance_reference")
    wanted = {"references": [{"motion": model}], "performance": {"motion": pupil}}
    judged = studio.finish(studio.ask("/jobs/evaluate", wanted))
    studio.finish(studio.ask("/jobs/label", {"take": {"motion": studio.clip(kind="take", text="take.bvh")}}))
    take = studio.clip(kind="take", text="take.bvh")
    pages = {
        "library": ("/library", ".cell canvas"),
        "search": (f"/search?motion=job:{estimated}", "canvas.dousa-miniature"),
        "takes": (f"/takes?motion={take}&at_s=6", ".dousa-player canvas"),
        "evaluate": (f"/evaluate?job={judged}", ".dousa-player canvas"),
        "estimate": (f"/estimate?job={estimated}", ".dousa-player canvas"),
    }
    films = estimate_films(studio)
    return pages if films is None else {**pages, "films": (f"/estimate?job={films}", "#film-figure canvas")}


def estimate_films(studio: Studio) -> str | None:
    """The man of Pose2Sim by two phones and his stature; None where the recordings or the models are not here."""
    from dousa.app.pipelines.film_scene import has_models

    films = [DATA / f"cam{number}.mp4" for number in PHONES]
    if not has_models() or not all(film.is_file() for film in films):
        print("no picture of films: models or ../shared/data/pose2sim are not here")
        return None
    wanted = {"batch": upload(studio, films)[0]["batch"], "body": {"stature_m": 1.75}, "overlay_video": False}
    return studio.finish(studio.ask("/jobs/estimate", wanted))


def estimate_made_films(studio: Studio, folder: Path) -> str:
    """Three made films, whose keypoints lie beside them: where no models are."""
    from app.studio.film_scenes import write_film_scene

    with tempfile.TemporaryDirectory(dir=folder) as made:
        write_film_scene(Path(made))
        batch = upload(studio, sorted(Path(made).iterdir()))[0]["batch"]
    wanted = {"batch": batch, "body": {"stature_m": 1.75}, "overlay_video": False}
    return studio.finish(studio.ask("/jobs/estimate", wanted))


def judge_twice(studio: Studio, folder: Path) -> list[str]:
    """Two evaluations against the same reference."""
    from app.studio.evaluation_cases import write_dances

    with tempfile.TemporaryDirectory(dir=folder) as made:
        takes, pupil = write_dances(Path(made))
        first, second, third, own = [{"motion": one["motion"]} for one in upload(studio, [*takes, pupil])]
    asked = [{"references": [first, second], "performance": performance} for performance in (own, third)]
    return [studio.finish(studio.ask("/jobs/evaluate", wanted)) for wanted in asked]


def upload(studio: Studio, paths: list[Path]) -> list[dict[str, Any]]:
    """Files in one batch; what the studio says of each."""
    batch, came = "", []
    for path in paths:
        answer = studio.ask(f"/uploads?name={path.name}{batch and '&batch='}{batch}", path.read_bytes())
        batch = answer["batch"]
        came.append({"batch": batch, **answer["files"][-1]})
    return came


def save(picture: bytes, path: Path) -> None:
    """As a PNG of few colours."""
    from PIL import Image

    with Image.open(io.BytesIO(picture)) as image:
        image.convert("RGB").quantize(COLOURS).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


def take_pictures(studio: Studio, demo: Path, page: Any) -> None:
    """Every page in light; the library as a phone shows it, dark and in Japanese."""
    for name, (address, shown) in addresses(studio, demo).items():
        from_top = SCROLLED.get(name, 0)
        save(shoot(studio, page, address, shown, from_top, SCRIPTS.get(name, "")), FIGURES / f"studio_{name}.png")
    phone = shoot(studio, page, "/library?lang=ja", ".cell canvas", size=(390, 844), scheme="dark")
    save(phone, FIGURES / "studio_phone.png")


def take_looks(studio: Studio, demo: Path, page: Any, folder: Path) -> None:
    """A sheet with all pages for each look: width, colours, language."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    shown = addresses(studio, demo)
    if "films" not in shown:
        shown["films"] = (f"/estimate?job={estimate_made_films(studio, folder)}", "#film-figure canvas")
    shown["map"] = ("/library?view=map", ".mp-legend button")
    shown["compare"] = (f"/evaluate?compare={','.join(judge_twice(studio, folder))}", ".compare-table tbody tr")
    shown |= {
        f"{name}_start": (f"/{name}", "main") for name in ("search", "takes", "evaluate", "estimate", "live", "api")
    }
    for size, scheme, language in product(SIZES, ("light", "dark"), ("en", "ja")):
        pictures = []
        for address, there in shown.values():
            joint = "&" if "?" in address else "?"
            data = shoot(studio, page, f"{address}{joint}lang={language}", there, size=size, scheme=scheme)
            with Image.open(io.BytesIO(data)) as image:
                pictures.append(image.convert("RGB").resize((size[0] * SHEET // size[1], SHEET)))
        columns = max(SHEET_WIDTH // pictures[0].width, 1)
        sheet = Image.new("RGB", (columns * pictures[0].width, -(-len(pictures) // columns) * SHEET), "#888888")
        for place, picture in enumerate(pictures):
            sheet.paste(picture, (place % columns * picture.width, place // columns * SHEET))
        sheet.save(folder / f"{size[0]}_{scheme}_{language}.png")
        print(f"{size[0]} {scheme} {language}: {len(pictures)} pages", flush=True)


def shoot(
    studio: Studio,
    page: Any,
    address: str,
    shown: str,
    from_top: int = 0,
    script: str = "",
    size: tuple[int, int] = (1280, 800),
    scheme: str = "light",
) -> bytes:
    """What the browser shows of a page."""
    page.resize(*size)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    page.driver.get(f"{studio.url}{address}{'&' if '?' in address else '?'}token={studio.token}")
    page.wait("return document.querySelector(arguments[0]) !== null", shown, seconds=60)
    time.sleep(SETTLE / 2)
    page.run(script)
    page.run("scrollTo({top: arguments[0], behavior: 'instant'})", from_top)
    time.sleep(SETTLE / 2)
    with tempfile.TemporaryDirectory() as folder:
        return bytes(page.screenshot(Path(folder) / "page.png").read_bytes())


def make_demo(folder: Path) -> None:
    """What ``dousa demo`` leaves behind."""
    from dousa.app.cli.main import make_application

    make_application()(["demo", "-o", str(folder)], standalone_mode=False)


def make_all(demo: Path | None = None, looks: Path | None = None) -> None:
    """Take all pictures, of a demonstration that was run into a folder or of a new one; looks: see the module."""
    import pytest

    from app.browser import open_browser
    from dousa.app.cli.studio import prepare_studio

    with tempfile.TemporaryDirectory() as name:
        if demo is None:
            demo = Path(name)
            make_demo(demo)
        try:
            with listening(prepare_studio(demo)) as studio, open_browser(Path(name) / "profile") as page:
                if looks is None:
                    take_pictures(studio, demo, page)
                else:
                    take_looks(studio, demo, page, looks)
        except pytest.skip.Exception as reason:
            print(f"no pictures of the studio: {reason}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--demo", type=Path, help="folder of a demonstration that was run already")
    parser.add_argument(
        "--looks", type=Path, help="folder for a sheet of each look, instead of the documents' pictures"
    )
    asked = parser.parse_args()
    make_all(asked.demo, asked.looks)
