"""The main ways through the studio in a real Firefox: files added and searched, a take labelled, an evaluation and its
comparison, silhouettes repaired and fitted."""

import shutil

import pytest

from app.studio.estimating_scenes import write_scene
from app.studio.evaluation_cases import write_dances
from app.studio.studio_client import Client
from dousa.estimation import PackedSilhouettes, read_cameras, read_silhouettes, write_silhouettes

pytestmark = [pytest.mark.browser, pytest.mark.slow]

CONTROL = "\ue009"
PATIENCE = 180.0  # s


@pytest.fixture
def go(firefox, running, one_address):
    """``go("library")``: a page of a studio in the browser; it ends without a word in the console."""

    def open_page(path):
        joint = "&" if "?" in path else "?"
        firefox.open(f"{running.url}/{path}{joint}token={running.token}&lang=en")
        return firefox

    firefox.said.clear()
    firefox.resize(1440, 900)
    yield open_page
    said = list(firefox.said)
    one_address.leave_firefox(firefox)
    assert said == []


def appear(page, selector: str) -> None:
    """Wait for an element."""
    page.wait(f"document.querySelector({selector!r}) !== null", PATIENCE)


def click(page, selector: str) -> None:
    page.wait(f"document.querySelector({selector!r})?.checkVisibility()", PATIENCE)
    page.run(f"document.querySelector({selector!r}).click()")


def test_files_are_added_and_searched(go, bvh, tmp_path):
    mine = tmp_path / "mine.bvh"
    shutil.copy(bvh, mine)
    with mine.open("a") as file:
        file.write("\n")  # another file, so that it is no duplicate to the byte
    page = go("library")
    click(page, "#add-button")
    appear(page, "#add-files")
    page.put_files("#add-files", mine)
    click(page, "#add-go:not(:disabled)")
    appear(page, "#add-report")
    click(page, "dialog .foot .primary")
    click(page, ".cell")
    click(page, "#actions a[href^='/search']")
    assert page.wait("document.querySelectorAll('.hit').length", PATIENCE) > 3
    appear(page, "#player canvas")


def test_a_take_is_labelled(go, running, tmp_path):
    from dousa.app.demo import write_take
    from dousa.motion import canonicalise
    from dousa.motion.synthetic.performers import make_library
    from dousa.retrieval import LabelledClip

    order = ("squat", "kick_left", "walk")
    made = {category: canonicalise(moving) for category, _, _, moving in make_library(1, seed=5, categories=order)}
    clips = [
        LabelledClip(name, name, None, made[name].positions, made[name].frame_rate, made[name].height) for name in order
    ]
    take = tmp_path / "session.bvh"
    write_take(clips, order, take)
    page = go("takes")
    appear(page, "#take-file")
    page.put_files("#take-file", take)
    page.wait("document.querySelectorAll('.tl-segment').length", PATIENCE)
    assert page.wait("document.querySelectorAll('#segments tbody tr').length", PATIENCE) >= 2


def test_an_evaluation_and_its_comparison(go, running, tmp_path):
    takes, pupil = write_dances(tmp_path)
    client = Client(running)
    names = [client.upload(path) for path in (*takes, pupil)]
    other = {"references": [{"motion": names[0]}], "performance": {"motion": names[2]}}
    client.wait(client.ask("POST", "/api/jobs/evaluate", other)["id"], PATIENCE)
    page = go(f"evaluate?performance={names[3]}&references={names[0]}")
    click(page, "#grade:not(:disabled)")
    page.wait("document.querySelector('#adjust-score')?.textContent", PATIENCE)
    assert page.run("document.querySelectorAll('#events [data-event]').length") >= 2
    page.run("document.querySelector('#events [data-event]').click()")
    click(page, "#compare-open")
    page.wait("document.querySelectorAll('.compare-table tbody tr').length > 10", PATIENCE)
    appear(page, ".compare-player canvas")


def test_silhouettes_are_repaired_and_fitted(go, tmp_path):
    seen = read_silhouettes(write_scene(tmp_path / "seen.npz", 8))
    masks = [[seen.read_view(view, frame).copy() for frame in range(8)] for view in (0, 1)]
    for mask in masks[0]:
        mask[70:110, 4:34] = True
    spoiled = PackedSilhouettes(masks, seen.frame_rate, seen.names)
    write_silhouettes(tmp_path / "spoiled.npz", spoiled, read_cameras(tmp_path / "seen.npz"), stature=1.7)
    page = go("estimate")
    appear(page, "#material")
    page.put_files("#material", tmp_path / "spoiled.npz")
    page.wait("!document.querySelector('#start').disabled", PATIENCE)
    page.run("document.querySelector('[name=overlay_video]').click()")
    click(page, "#repair")
    page.wait("document.querySelector('.masks-stage')?.dataset.shown", PATIENCE)
    page.press("t")
    place = "(() => { const b = document.querySelector('.masks-canvas').getBoundingClientRect();"
    place += " return [b.x + b.width * 20.5 / 160, b.y + b.height * 90.5 / 120]; })()"
    page.drag(tuple(page.run(place)))
    page.wait("document.querySelector('#masks-desk').dataset.done === '1'")
    page.press(CONTROL, "z")
    page.wait("document.querySelector('#masks-desk').dataset.done === '0'")
    page.press(CONTROL, "y")
    page.wait("document.querySelector('#masks-desk').dataset.done === '1'")
    click(page, "#masks-estimate")
    page.wait("(location.search.includes('job=') && !document.querySelector('#outcome').hidden)", PATIENCE)
