"""The page of estimation in Chromium: files in, silhouettes looked at, frames appear, stop, reload, go on, send on."""

from pathlib import Path

import numpy as np
import pytest

from app.studio.estimating_scenes import write_scene

N_FRAMES = 120

SHOWN = "return document.querySelectorAll('.view[data-frame]').length === 2"
CAN_START = "return !document.querySelector('#start').disabled"


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> Path:
    """An npz of silhouettes: four seconds in two views."""
    return write_scene(tmp_path_factory.mktemp("page") / "seen.npz", N_FRAMES)


def text(page, selector: str) -> str:
    return page.run("return document.querySelector(arguments[0]).textContent", selector)


def is_within(page) -> bool:
    """Whether nothing stands out at the side."""
    return page.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_from_silhouettes_to_a_search(show, seen):
    page = show("/estimate")
    page.find("#material").send_keys(str(seen))
    page.wait(CAN_START)
    assert page.run("return document.querySelectorAll('.pictures img').length") == 2
    assert "2 views, 120 frames at 30 Hz" in text(page, "#preview")
    page.run("document.querySelector('#options details').open = true")
    page.run("document.querySelector('[name=overlay_video]').checked = false")
    assert is_within(page)
    page.find("#start").click()

    page.wait(SHOWN)
    page.wait("return document.querySelector('.curve.open')")
    page.wait("return Number(document.querySelector('.view').dataset.frame) >= 33")
    page.find("#watch-stop").click()
    page.wait("return document.querySelector('#watch-resume')")
    assert text(page, "#watch-state") == "stopped" and "nothing is lost" in text(page, "#watch-what")

    address = page.driver.current_url
    page.driver.refresh()
    page.wait(SHOWN)
    page.wait("return document.querySelector('#watch-resume')")
    assert page.driver.current_url == address
    page.wait("return document.querySelector('#figure canvas')")
    page.run(
        "const f = document.querySelector('#frame'); f.value = 10; f.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    page.wait("return document.querySelector('.view').dataset.frame === '10'")
    assert text(page, "#time-now").startswith("frame 11 of 120")

    page.find("#watch-resume").click()
    page.wait("return !document.querySelector('#outcome').hidden")
    page.wait("return !document.querySelector('.curve.open')")
    assert text(page, "#watch-state") == "done" and "Mean overlap" in text(page, "#outcome")
    links = page.run("return [...document.querySelectorAll('#outcome a')].map((a) => a.getAttribute('href'))")
    job = address.split("job=")[1].split("&")[0]
    assert f"/search?motion=job%3A{job}" in links and f"/evaluate?performance=job%3A{job}" in links
    assert f"/api/estimations/{job}/files/motion.bvh" in links
    assert page.messages() == []

    page.find("#add-it").click()
    page.run("document.querySelector('dialog [name=name]').value = 'mine'")
    page.find("dialog button.primary").click()
    page.wait("return document.querySelector('.notice:not(.problem)')")
    assert "mine" in text(page, ".notice")

    for width, height, scheme in ((390, 844, "dark"), (1280, 720, "light")):
        page = show(f"/estimate?job={job}", width, height, scheme, "ja")
        page.wait(SHOWN)
        page.wait("return !document.querySelector('#outcome').hidden")
        assert "平均の重なり" in text(page, "#outcome") and is_within(page)
    page.find("#search-it").click()
    page.wait("return location.pathname === '/search' && document.readyState === 'complete'")
    assert page.run("return new URLSearchParams(location.search).get('motion')") == f"job:{job}"


def test_what_is_missing_is_said_and_put_right(show, seen, tmp_path):
    with np.load(seen) as file:
        masks = {"mask_packed": file["mask_packed"][:, :3], "width": file["width"], "height": file["height"]}
        cameras = {key: file[key] for key in file if key.startswith(("camera", "world")) or key in ("width", "height")}
    np.savez(tmp_path / "masks.npz", **masks)
    np.savez(tmp_path / "calib.npz", **cameras)
    (tmp_path / "notes.pdf").write_bytes(b"%PDF")
    page = show("/estimate", 390, 844)
    page.find("#material").send_keys(f"{tmp_path / 'masks.npz'}\n{tmp_path / 'notes.pdf'}")
    page.wait("return document.querySelector('#missing')")
    assert "calibration file required" in text(page, "#missing")
    assert "notes.pdf" in text(page, "#material-refused")
    assert page.run("return document.querySelector('#start').disabled") and is_within(page)
    page.messages()  # the file that was refused is an answer of 415, which browsers write down

    page.find("#material").send_keys(str(tmp_path / "calib.npz"))
    page.wait(CAN_START)
    roles = page.run("return [...document.querySelectorAll('.files select')].map((s) => [s.dataset.name, s.value])")
    assert dict(roles) == {"masks.npz": "source", "calib.npz": "cameras"}
    page.run(
        "const s = document.querySelector('[data-name=\"calib.npz\"]'); s.value = 'unused';"
        "s.dispatchEvent(new Event('change'))"
    )
    page.wait("return document.querySelector('#missing')")
    page.driver.refresh()
    page.wait(CAN_START)  # the files are still there, and find their parts again


CHART = """
const done = arguments[0];
const base = document.querySelector('script[src*="core/frame"]').src.replace('core/frame.js', '');
import(`${base}estimate/chart.js`).then(({ Chart }) => {
  const place = document.querySelector('main').appendChild(document.createElement('div'));
  place.className = 'chart';
  place.id = 'tried';
  const chart = new Chart(place, (frame) => { window.went = frame; });
  const states = ['', '', 'unsure', 'unsure', '', 'lost', 'lost', 'lost', '', ''];
  const is = (state) => ({ overlap: 0.8, lost: state === 'lost', unsure: state === 'unsure', stage: 2 });
  const rows = states.map((state, frame) => [frame, is(state)]);
  chart.draw(new Map(rows), states.length);
  const bands = [...place.querySelectorAll('.trust-band')];
  done(bands.map((band) => [band.classList[1], getComputedStyle(band).fill]));
});
"""


def test_the_timeline_marks_how_far_each_frame_is_to_be_trusted_and_a_press_goes_there(show):
    page = show("/estimate")
    bands = page.driver.execute_async_script(CHART)
    assert [trust for trust, _ in bands] == ["good", "unsure", "good", "lost", "good"]
    assert len({colour for _, colour in bands}) == 3
    press = """
    const drawing = document.querySelector('#tried svg');
    const box = drawing.getBoundingClientRect();
    drawing.setPointerCapture = () => {};
    const at = { clientX: box.x + (box.width * 6) / 9, clientY: box.y + box.height - 2, bubbles: true };
    drawing.dispatchEvent(new PointerEvent('pointerdown', at));
    return window.went;
    """
    assert page.run(press) == 6  # in the middle of the lost ones
