"""Film and music beside the figures of an evaluation: kept, given out in parts, and in step in a real Chromium."""

import io
import math
import struct
import wave

import numpy as np
import pytest

from app.studio.conftest import wait_for
from app.studio.evaluation_cases import upload
from app.studio.studio_client import Client
from dousa.app.studio.jobs.lanes import Reader
from dousa.evaluation import Beats


def make_music(seconds=12.0, rate=8000):
    """A click every half second over silence."""
    values = [
        int(20_000 * math.sin(2 * math.pi * 880 * k / rate)) if (k / rate) % 0.5 < 0.05 else 0
        for k in range(int(seconds * rate))
    ]
    out = io.BytesIO()
    with wave.open(out, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes(struct.pack(f"<{len(values)}h", *values))
    return out.getvalue()


@pytest.fixture(scope="session")
def film(tmp_path_factory):
    """Four seconds whose pictures become lighter, higher than wide."""
    av = pytest.importorskip("av", reason="pip install 'dousa[film]'")
    path = tmp_path_factory.mktemp("film") / "pupil.webm"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libvpx", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 160, "yuv420p"
        for k in range(100):
            picture = np.full((160, 96, 3), 2 * k, np.uint8)
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)
    return path


@pytest.fixture
def reads_here(monkeypatch):
    """Files are read in this process, whose functions the tests replace."""
    monkeypatch.setattr(Reader, "run", lambda self, work, *given, seconds=0: work(*given))


@pytest.fixture
def beats(monkeypatch, reads_here):
    """Beats every half second, without the beat tracker; how often they were looked for."""
    import dousa.evaluation

    looked = []

    def find(path):
        looked.append(path)
        return Beats(np.arange(0.5, 12.0, 0.5))

    monkeypatch.setattr(dousa.evaluation, "find_beats", find)
    return looked


@pytest.fixture
def job(studio, bvh, trained_library):
    takes = upload(studio, bvh, *sorted((trained_library.parent / "motions" / "kick_left").glob("*.bvh"))[1:3])
    request = {"references": takes[1:], "performance": takes[0]}
    found = wait_for(studio, studio.post("/api/jobs/evaluate", json=request).json()["id"])
    assert found["state"] == "done"
    return found["id"]


def send(studio, name, content):
    answer = studio.post("/api/uploads", params={"name": name}, content=content)
    assert answer.status_code == 201, answer.text
    return answer.json()["batch"]


def test_a_companion_is_kept_and_given_out_in_parts(studio, job, film):
    place = f"/api/evaluations/{job}/companions"
    assert studio.get(place).json() == {"film": None, "music": None}
    content = film.read_bytes()
    batch = send(studio, "pupil.webm", content)
    said = studio.put(f"{place}/film", json={"batch": batch, "name": "pupil.webm", "start_s": -1.5}).json()
    assert said["film"] == {"batch": batch, "name": "pupil.webm", "start_s": -1.5}
    whole = studio.get(f"{place}/film/file")
    assert whole.content == content
    assert whole.headers["content-type"] == "video/webm"
    part = studio.get(f"{place}/film/file", headers={"range": "bytes=10-19"})
    assert (part.status_code, part.content) == (206, content[10:20])
    # What is in use is not cleared away with old uploads.
    assert batch not in {path.name for path in studio.app.state.studio.workspace.list_unused("")}
    assert studio.delete(f"{place}/film").json()["film"] is None
    assert studio.get(f"{place}/film/file").status_code == 404


@pytest.mark.parametrize(
    ("kind", "name", "status"),
    [("music", "pupil.webm", 415), ("film", "other.webm", 404), ("film", "../pupil.webm", 422), ("text", "x", 422)],
)
def test_what_is_no_companion_is_refused(studio, job, film, kind, name, status):
    batch = send(studio, "pupil.webm", film.read_bytes())
    answer = studio.put(f"/api/evaluations/{job}/companions/{kind}", json={"batch": batch, "name": name})
    assert answer.status_code == status
    assert answer.json()["problem"]


@pytest.mark.parametrize("name", ["a.wav", "a.mp3", "a.flac", "a.ogg", "a.m4a", "a.aac", "a.opus"])
def test_what_only_calls_itself_music_is_not_taken(studio, name):
    answer = studio.post("/api/uploads", params={"name": name}, content=b"#EXTM3U\nhttp://evil.example/\n" * 20)
    assert answer.status_code == 415


def test_beats_are_found_once_and_stand_in_the_report(studio, job, beats):
    place = f"/api/evaluations/{job}"
    assert studio.get(f"{place}/beats").json()["times_s"] is None
    batch = send(studio, "dance.wav", make_music())
    body = {"batch": batch, "name": "dance.wav", "start_s": -4.0}
    assert studio.put(f"{place}/companions/music", json=body).status_code == 200
    for _ in range(2):
        found = studio.get(f"{place}/beats").json()
        assert found["times_s"][:3] == [0.5, 1.0, 1.5]
        assert found["tempo_bpm"] == 120.0
    assert len(beats) == 1
    assert bool(found["timing"]) != bool(found["problem"])
    page = studio.get(f"{place}/report.html").text
    assert ('id="beats"' in page) == bool(found["timing"])


def test_without_the_beat_tracker_the_pip_line_is_told(studio, job, monkeypatch, reads_here):
    import dousa.evaluation
    from dousa.errors import MissingExtraError

    def find(path):
        raise MissingExtraError("librosa", "music")

    monkeypatch.setattr(dousa.evaluation, "find_beats", find)
    batch = send(studio, "dance.wav", make_music())
    studio.put(f"/api/evaluations/{job}/companions/music", json={"batch": batch, "name": "dance.wav"})
    answer = studio.get(f"/api/evaluations/{job}/beats")
    assert answer.status_code == 501
    assert "dousa[music]" in answer.json()["problem"]
    assert studio.get(f"/api/evaluations/{job}/report.html").status_code == 200


def test_film_and_music_go_in_step(show, running, dances, film, beats, tmp_path):
    client = Client(running)
    takes, pupil = dances
    request = {
        "references": [{"motion": client.upload(path)} for path in takes],
        "performance": {"motion": client.upload(pupil)},
    }
    job = client.ask("POST", "/api/jobs/evaluate", request)["id"]
    assert client.wait(job)["state"] == "done"
    music = tmp_path / "dance.wav"
    music.write_bytes(make_music())
    page = show(f"/evaluate?job={job}")
    page.wait("return document.querySelector('#add-film')")
    page.find("#film-file").send_keys(str(film))
    page.wait("return document.querySelector('.beside-film')?.readyState >= 2")
    assert page.run("return document.querySelector('.player-card').classList.contains('upright')")
    page.find("#music-file").send_keys(str(music))
    page.wait("return document.querySelector('.waveform')?.dataset.drawn === 'sound'")
    page.wait("return document.querySelector('.waveform').dataset.beats === '23'")

    # The film stands where the player stands, less where it begins.
    seek = "const f = document.querySelector('.dp-scrub'); f.value = arguments[0]; f.dispatchEvent(new Event('input'))"
    page.run(seek, "2")
    page.wait("return Math.abs(document.querySelector('.beside-film').currentTime - 2) < 0.06")
    page.run(
        "const f = document.querySelector('#film-start'); f.value = '0.5';"
        "f.dispatchEvent(new Event('change', {bubbles: true}))"
    )
    page.wait("return Math.abs(document.querySelector('.beside-film').currentTime - 1.5) < 0.06")
    assert client.ask("GET", f"/api/evaluations/{job}/companions")["film"]["start_s"] == 0.5
    # By hand: the film is moved alone, and what is seen is said to be the same moment.
    page.find("#match-film").click()
    page.wait("return document.querySelector('.beside-film').controls")
    page.run("document.querySelector('.beside-film').currentTime = 1.2")
    page.wait("return !document.querySelector('.beside-film').seeking")
    page.find("#match-film").click()
    page.wait("return Number(document.querySelector('#film-start').value) === 0.8")
    # A press in the waveform goes there; both play with the player and stop with it.
    page.run(
        "const w = document.querySelector('.waveform'), b = w.getBoundingClientRect();"
        "w.dispatchEvent(new PointerEvent('pointerdown', {clientX: b.left + b.width * 1.5 /"
        "Number(document.querySelector('.dp-scrub').max), bubbles: true}))"
    )
    page.run("document.querySelector('.dousa-player').focus()")
    page.press(" ")
    page.wait("return !document.querySelector('.beside-film').paused")
    page.wait("return document.querySelector('.beside-film').currentTime > 1")
    page.press(" ")
    page.wait("return document.querySelector('.beside-film').paused")
    page.settle()
    page.wait(
        "const film = document.querySelector('.beside-film'), now = Number(document.querySelector('.dp-scrub').value);"
        "return Math.abs(film.currentTime - Math.min(now - 0.8, film.duration)) < 0.06"
    )
    # They are there again after a reload, and gone when they are taken away.
    page.driver.refresh()
    page.wait("return document.querySelector('.beside-film') && document.querySelector('.waveform')")
    page.run("document.querySelector('[data-kind=film] button.icon').click()")
    page.wait("return !document.querySelector('.beside-film')")
    assert client.ask("GET", f"/api/evaluations/{job}/companions")["film"] is None
