"""Silhouettes repaired in Chromium: looked through, painted, a part taken away through the film, undone, fitted."""

import io
from pathlib import Path

import numpy as np
import pytest

from app.studio.conftest import TOKEN
from app.studio.estimating_scenes import write_scene
from dousa.estimation import PackedSilhouettes, read_cameras, read_silhouettes, write_silhouettes

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys

N_FRAMES = 16
BLOB = (slice(70, 110), slice(4, 34))  # rows, columns of 120 x 160: a chair that was not there in the empty picture
CAN_START = "return !document.querySelector('#start').disabled"
SHOWN = "return document.querySelector('.masks-stage')?.dataset.shown?.startsWith(arguments[0])"
DONE = "return document.querySelector('#masks-desk').dataset.done === arguments[0]"


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    """Silhouettes in two views."""
    return write_scene(tmp_path_factory.mktemp("masks") / "clean.npz", N_FRAMES)


@pytest.fixture(scope="module")
def spoiled(clean) -> Path:
    """The same, with something beside the person in the first view."""
    found = read_silhouettes(clean)
    masks = np.stack([np.stack(found.read(frame)) for frame in range(N_FRAMES)], axis=1)
    assert not masks[0][:, *BLOB].any()
    masks[0][:, *BLOB] = True
    path = clean.with_name("spoiled.npz")
    with np.load(clean) as file:
        stature = float(file["stature"])
    write_silhouettes(
        path, PackedSilhouettes(masks, found.frame_rate, found.names), read_cameras(clean), stature=stature
    )
    return path


def drag(page, *points: tuple[float, float]) -> None:
    """Press at the first point, px of the silhouette, go through the others, and let go."""
    from selenium.webdriver import ActionChains

    box = page.run(
        "const c = document.querySelector('.masks-canvas'); c.scrollIntoView({block: 'center'});"
        "const b = c.getBoundingClientRect(); return [b.x, b.y, b.width / c.width, b.height / c.height];"
    )
    actions = ActionChains(page.driver, duration=10)
    for number, (x, y) in enumerate(points):
        place = round(box[0] + (x + 0.5) * box[2]), round(box[1] + (y + 0.5) * box[3])
        actions.w3c_actions.pointer_action.move_to_location(*place)
        if number == 0:
            actions.w3c_actions.pointer_action.pointer_down()
    actions.w3c_actions.pointer_action.pointer_up()
    actions.perform()


def fetch(running, path: str) -> bytes:
    import urllib.request

    asked = urllib.request.Request(f"{running.url}{path}", headers={"authorization": f"Bearer {TOKEN}"})
    with urllib.request.urlopen(asked) as answer:
        return answer.read()


def read_export(running, job: str, tmp_path: Path) -> PackedSilhouettes:
    path = tmp_path / "masks.npz"
    path.write_bytes(fetch(running, f"/api/masks/{job}/masks.npz"))
    return read_silhouettes(path)


def differ(one, other, view: int, frame: int) -> int:
    return int((one.read(frame)[view] != other.read(frame)[view]).sum())


def text(page, selector: str) -> str:
    return page.run("return document.querySelector(arguments[0]).textContent", selector)


def wait_overlap(page) -> float:
    """The mean overlap that a finished estimation shows."""
    page.wait("return !document.querySelector('#outcome').hidden")
    said = page.run("return [...document.querySelectorAll('.outcome-facts dd')].map((e) => e.textContent)")
    return float(said[0])


def test_a_wrong_part_is_taken_away_and_the_model_fits_better(show, running, clean, spoiled, tmp_path):
    page = show("/estimate", 1440, 900)
    page.find("#material").send_keys(str(spoiled))
    page.wait(CAN_START)
    page.run("document.querySelector('[name=overlay_video]').checked = false")
    page.find("#start").click()
    before = wait_overlap(page)

    page.find("#watch-repair").click()
    page.wait(SHOWN, "0/")
    job = page.run("return new URLSearchParams(location.search).get('masks')")
    assert "a second part" in text(page, "#masks-now")
    assert int(text(page, "#masks-left").split()[2].rstrip(";")) >= N_FRAMES

    page.press("t")
    drag(page, (20, 90))
    page.wait(DONE, "1")
    assert f"repaired: {N_FRAMES}" in text(page, "#masks-left")
    truth = read_silhouettes(clean)
    repaired = read_export(running, job, tmp_path)
    assert [differ(repaired, truth, view, frame) for view in (0, 1) for frame in range(N_FRAMES)] == [0] * 2 * N_FRAMES

    page.press("z", held=KEYS.CONTROL)
    page.wait(DONE, "0")
    spoilt = read_silhouettes(spoiled)
    assert differ(read_export(running, job, tmp_path), spoilt, 0, 3) == 0
    page.press("y", held=KEYS.CONTROL)
    page.wait(DONE, "1")

    page.find("#masks-estimate").click()
    page.wait("return location.search.includes('job=')")
    after = wait_overlap(page)
    assert after > before + 0.05, (before, after)
    estimated = page.run("return new URLSearchParams(location.search).get('job')")
    kept = tmp_path / "kept.npz"
    kept.write_bytes(fetch(running, f"/api/estimations/{estimated}/files/masks.npz"))
    assert differ(read_silhouettes(kept), truth, 0, 5) == 0


def test_painting_keys_and_phones(show, running, spoiled, tmp_path, faults):
    page = show("/estimate", 1440, 900)
    page.find("#material").send_keys(str(spoiled))
    page.wait(CAN_START)
    page.find("#repair").click()
    page.wait(SHOWN, "0/0")
    job = page.run("return new URLSearchParams(location.search).get('masks')")
    spoilt = read_silhouettes(spoiled)

    page.press("2")  # the second view
    page.press(KEYS.ARROW_RIGHT, KEYS.ARROW_RIGHT)
    page.wait(SHOWN, "1/2")
    page.press("b", "]", "]")
    size = int(page.run("return document.querySelector('#masks-size').value"))
    drag(page, (10, 10), (30, 10))
    page.wait(DONE, "1")
    repaired = read_export(running, job, tmp_path)
    added = repaired.read(2)[1] & ~spoilt.read(2)[1]
    columns = np.nonzero(added)[1]
    assert abs(columns.min() - (10 - size)) <= 2 and abs(columns.max() - (30 + size)) <= 2
    assert differ(repaired, spoilt, 1, 3) == 0 and differ(repaired, spoilt, 0, 2) == 0

    page.press("e")
    drag(page, (10, 10), (30, 10))
    page.wait(DONE, "2")
    assert read_export(running, job, tmp_path).read(2)[1][10, 10:31].sum() == 0

    page.driver.refresh()  # what was repaired is kept, and can still be undone
    page.wait(SHOWN, "0/")
    page.press("z", held=KEYS.CONTROL)
    page.wait(DONE, "1")
    page.wait(SHOWN, "1/2")  # what was undone is seen
    assert read_export(running, job, tmp_path).read(2)[1][10, 12:28].all()

    page.press("x")
    drag(page, (80, 2))  # nothing there
    page.wait("return document.querySelector('.notice.problem')")
    assert "no silhouette at this point" in text(page, ".notice.problem")
    for width, scheme in ((390, "dark"), (2560, "light")):
        page = show(f"/estimate?masks={job}", width, 900, scheme, "ja")
        page.wait(SHOWN, "0/")
        assert page.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")
        assert "フレーム" in text(page, "#masks-now")
        assert faults(page) == []


def test_silhouettes_without_cameras_are_repaired_and_saved_only(show, running, clean, tmp_path):
    with np.load(clean) as file:
        np.savez(tmp_path / "bare.npz", **{key: file[key] for key in ("mask_packed", "width", "height")})
    page = show("/estimate", 1280, 800)
    page.find("#material").send_keys(str(tmp_path / "bare.npz"))
    page.wait("return !document.querySelector('#repair').hidden")
    page.find("#repair").click()
    page.wait(SHOWN, "0/")
    assert page.run("return document.querySelector('#masks-estimate').disabled")
    assert "no calibration" in text(page, "#masks-problem")
    with np.load(
        io.BytesIO(fetch(running, page.run("return document.querySelector('#masks-save').getAttribute('href')")))
    ) as file:
        assert "camera_matrix" not in file and file["mask_packed"].shape[1] == N_FRAMES
