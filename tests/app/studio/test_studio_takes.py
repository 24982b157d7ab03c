"""Takes: labels, corrections that are learned and taken back, and the page."""

import csv
import io
import json
import shutil
from pathlib import Path
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import numpy as np
import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")
KEYS, ActionChains = webdriver.Keys, webdriver.ActionChains
STRANGE = "lunge"
ORDER = ("walk", STRANGE, "squat", STRANGE, "kick_left")


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """A take of somebody whom the library does not know, with two motions that it does not know; and what is when."""
    from dousa.app.demo import write_take
    from dousa.motion import canonicalise
    from dousa.motion.synthetic.performers import make_library
    from dousa.retrieval import LabelledClip

    made = {}
    for category, performer, _, moving in make_library(2, seed=7, categories=sorted(set(ORDER))):
        motion = canonicalise(moving)
        made[category, performer.name] = LabelledClip(
            category, category, None, motion.positions, motion.frame_rate, motion.height
        )
    first, second = sorted({name for _, name in made})
    clips = [made[category, second if place == 3 else first] for place, category in enumerate(ORDER)]
    path = tmp_path_factory.mktemp("take") / "session.bvh"
    truth = write_take(clips, ORDER, path).truth
    return path, [(piece.start, piece.stop) for piece in truth]


@pytest.fixture
def strange(recording):
    """Where the unknown motions are, s."""
    return [span for span, category in zip(recording[1], ORDER, strict=True) if category == STRANGE]


def upload(client, recording):
    """Name of the take."""
    answer = client.post("/api/uploads?name=session.bvh", content=recording[0].read_bytes())
    return answer.json()["files"][0]["motion"]


def label(client, motion, wait_job):
    """Labels of a take with corrections."""
    job = client.post("/api/jobs/label", json={"take": {"motion": motion}})
    assert job.status_code == 202, job.text
    done = wait_job(client, job.json()["id"])
    assert done["state"] == "done", done
    answer = client.get("/api/takes/labels", params={"motion": motion}).json()
    assert answer["is_current"]
    return answer["labels"]["segments"]


def said_at(segments, spans):
    """Category in the middle of parts, and whether somebody said so."""
    found = []
    for start, end in spans:
        middle = 0.5 * (start + end)
        own = next(one for one in segments if one["start_s"] <= middle < one["end_s"])
        found.append((own["category"], own["corrected"] is not None))
    return found


def test_a_correction_is_learned_for_the_similar_stretch_exported_and_taken_back(studio, recording, strange, wait_job):
    """One of two unknown motions is named; the other one, of another person, then has that name too."""
    motion = upload(studio, recording)
    assert studio.get("/api/takes/export", params={"motion": motion}).status_code == 409
    before = label(studio, motion, wait_job)
    assert before[0]["start_s"] == 0 and all(one["corrected"] is None for one in before)
    assert studio.get("/api/info").json()["library"]["n_takes"] == 0
    assert STRANGE not in [category for category, _ in said_at(before, strange)]
    start, end = strange[0]
    asked = {"motion": motion, "start_s": start, "end_s": end, "category": STRANGE}
    learned = studio.post("/api/takes/correct", json=asked)
    assert learned.status_code == 201, learned.text
    assert learned.json()["is_learned"] and learned.json()["is_new_category"]
    assert studio.get("/api/info").json()["library"]["categories"][STRANGE] == 1
    after = label(studio, motion, wait_job)
    assert said_at(after, strange) == [(STRANGE, True), (STRANGE, False)]
    known = [span for span in recording[1] if span not in strange]
    assert [one for one, _ in said_at(after, known)] == [one for one, _ in said_at(before, known)]

    table = studio.get("/api/takes/export", params={"motion": motion})
    assert "session.labels.csv" in table.headers["content-disposition"]
    rows = list(csv.DictReader(io.StringIO(table.text)))
    assert len(rows) == len(after) and [row["category"] for row in rows if row["corrected"]] == [STRANGE]
    whole = studio.get("/api/takes/export", params={"motion": motion, "format": "json"}).json()
    assert whole["segments"] == after

    number = learned.json()["correction"]["id"]
    assert studio.delete(f"/api/takes/corrections/{number}").status_code == 200
    assert studio.delete(f"/api/takes/corrections/{number}").status_code == 404
    assert STRANGE not in studio.get("/api/info").json()["library"]["categories"]
    assert STRANGE not in [category for category, _ in said_at(label(studio, motion, wait_job), strange)]
    assert studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"] == []


def test_a_dropped_take_is_split_and_joined_in_one_change_each(studio, recording, strange):
    """A take that was only dropped joins the library; what was replaced comes back, and a refusal changes nothing."""
    motion = upload(studio, recording)
    start, end = strange[0]
    middle = round(0.5 * (start + end), 3)

    def correct(**more):
        asked = {"motion": motion, "start_s": start, "end_s": end, "category": STRANGE, **more}
        return studio.post("/api/takes/correct", json=asked)

    def spans():
        known = studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"]
        return [(round(one["start_s"], 2), round(one["end_s"], 2)) for one in known]

    whole, halves = (
        [(round(start, 2), round(end, 2))],
        [(round(start, 2), round(middle, 2)), (round(middle, 2), round(end, 2))],
    )
    correct()
    split = correct(
        split_s=middle,
        replaces=[studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"][0]["id"]],
    )
    assert split.status_code == 201, split.text
    assert spans() == halves
    ids = [one["id"] for one in split.json()["corrections"]]
    for wrong, status in (
        ({"replaces": ["nothing"]}, 404),
        ({"split_s": start + 0.05}, 422),
        ({"split_s": end + 1}, 422),
    ):
        assert correct(**wrong).status_code == status
    assert spans() == halves
    assert correct(replaces=ids).status_code == 201
    assert spans() == whole
    for step, expected in (("undo", halves), ("undo", whole), ("redo", halves), ("redo", whole)):
        assert studio.post(f"/api/journal/{step}", json={"number": None}).status_code == 200
        assert spans() == expected
    number = studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"][0]["id"]
    change = studio.delete(f"/api/takes/corrections/{number}").json()["change"]
    assert spans() == []
    assert studio.post("/api/journal/undo", json={"number": change}).status_code == 200
    assert spans() == whole


def test_the_last_word_on_a_part_counts(studio, recording, strange):
    motion = upload(studio, recording)
    start, end = strange[0]
    for category in ("hop", STRANGE):
        asked = {"motion": motion, "start_s": start, "end_s": end, "category": category}
        assert studio.post("/api/takes/correct", json=asked).status_code == 201
    known = studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"]
    assert [one["category"] for one in known] == [STRANGE]
    assert "hop" not in studio.get("/api/info").json()["library"]["categories"]


def test_corrections_survive_a_new_start_and_the_way_into_the_library(library_copy, recording, strange, wait_job):
    from starlette.testclient import TestClient

    from dousa.app.studio import Settings, create_app

    def client():
        made = TestClient(create_app(Settings(library_copy, token="t")), "http://127.0.0.1:8765")
        made.headers["authorization"] = "Bearer t"
        return made

    with client() as first:
        motion = upload(first, recording)
        asked = {"motion": motion, "start_s": strange[0][0], "end_s": strange[0][1], "category": STRANGE}
        assert first.post("/api/takes/correct", json=asked).status_code == 201
    with client() as second:
        job = second.post("/api/jobs/add", json={"batch": motion[5:21], "kind": "take", "category_from": None})
        assert wait_job(second, job.json()["id"])["result"]["unchanged"]  # it joined with its first correction
        take = next(clip for clip in second.app.state.studio.library.clips() if clip.kind == "take")
        segments = label(second, f"clip:{take.id}", wait_job)
        assert said_at(segments, strange) == [(STRANGE, True), (STRANGE, False)]


_SENSELESS = [
    ({"category": " "}, 422),
    ({"category": "a\nb"}, 422),
    ({"category": ""}, 422),
    ({"start_s": 5, "end_s": 1}, 422),
    ({"end_s": 0.0}, 422),
    ({"end_s": 0.1}, 422),
    ({"motion": "file:0123456789abcdef/x.bvh"}, 404),
    ({"motion": "clip:99999"}, 404),
    ({"surprise": 1}, 422),
]


def test_corrections_that_make_no_sense_are_refused(studio, recording):
    """A table of labels takes words such as unknown for no category; here, too, none is made of them."""
    asked = {"motion": upload(studio, recording), "start_s": 0, "end_s": 1.0, "category": "hop"}
    for changes, status in _SENSELESS:
        answer = studio.post("/api/takes/correct", json={**asked, **changes})
        assert answer.status_code == status, (changes, answer.text)
    for word in ("unknown", " Unknown ", "(nothing)", "不明", "未知"):
        answer = studio.post("/api/takes/correct", json={**asked, "category": word})
        assert answer.status_code == 422, answer.text
        assert f"'{word.strip()}'" in answer.json()["problem"]
    categories = studio.get("/api/info").json()["library"]["categories"]
    assert categories.keys().isdisjoint({"hop", "unknown", "Unknown", "(nothing)", "不明", "未知"})
    asked = {"take": {"motion": asked["motion"], "start_s": 1, "end_s": 2}}
    assert studio.post("/api/jobs/label", json=asked).status_code == 422  # a part of a take alone
    assert studio.get("/api/takes/strips", params={"motion": "clip:99999"}).status_code == 404
    assert studio.get("/api/takes/strips").status_code == 422


def test_names_with_slashes_and_quotes_stay_names(studio, recording, strange):
    motion = upload(studio, recording)
    name = '../"kick", 蹴り'
    asked = {"motion": motion, "start_s": strange[0][0], "end_s": strange[0][1], "category": name}
    assert studio.post("/api/takes/correct", json=asked).status_code == 201
    assert name in studio.get("/api/info").json()["library"]["categories"]


def test_doubtful_names_are_told_apart_in_strips_and_tables(studio, recording, wait_job, monkeypatch):
    from dousa.app.studio.api import takes

    def doubt(labels, corrections):
        first, *rest = ({**one, "corrected": None} for one in labels)
        return [{**first, "category": None, "unknown": True, "perhaps": True, "guess": "kick"}, *rest]

    name = upload(studio, recording)
    label(studio, name, wait_job)
    monkeypatch.setattr("dousa.app.studio.api.takes.lay_over", doubt)
    told = studio.get("/api/takes/strips", params={"motion": name}).json()["takes"][name]["segments"]
    assert told[0].items() >= {"category": None, "unknown": True, "perhaps": True, "guess": "kick"}.items()
    assert not any(one["perhaps"] for one in told[1:])
    segments = studio.get("/api/takes/labels", params={"motion": name}).json()["labels"]["segments"]
    rows = list(csv.DictReader(io.StringIO(takes._format_csv(segments))))
    assert (rows[0]["category"], rows[0]["perhaps"]) == ("", "kick")
    assert not any(row["perhaps"] for row in rows[1:])


def test_corrections_are_laid_over_labels():
    from dousa.app.studio.content.corrections import Correction, lay_over

    def segment(start, end, category):
        return {
            "start_s": start,
            "end_s": end,
            "category": category,
            "unknown": category is None,
            "confidence": 0.9,
            "repetitions": 3,
        }

    labels = [segment(0, 4, "walk"), segment(4, 6, None), segment(6, 9, "kick")]
    first = Correction("clip:1", 3.0, 7.0, "hop", 5, "5")
    second = Correction("clip:1", 6.5, 6.8, "skip", 6, "6")
    spans = [(one["start_s"], one["end_s"], one["category"]) for one in lay_over(labels, [second, first])]
    often = [one.get("repetitions") for one in lay_over([*labels, segment(9, 12, "squat")], [second, first])]
    assert often == [*[None] * 5, 3], "of what was cut nobody knows how often"
    assert spans == [(0, 3.0, "walk"), (3.0, 6.5, "hop"), (6.5, 6.8, "skip"), (6.8, 7.0, "hop"), (7.0, 9, "kick")]


# --- the page

SEEK = """
const inner = document.querySelector('.tl-inner').getBoundingClientRect();
const place = {clientX: inner.left + inner.width * arguments[0], clientY: inner.top + 50};
const event = {...place, bubbles: true, pointerId: 1, pointerType: 'mouse', button: 0};
document.querySelector('.tl-track').dispatchEvent(new PointerEvent('pointerdown', event));
window.dispatchEvent(new PointerEvent('pointerup', event));
"""
LABELLED = "return document.querySelectorAll('#segments tbody tr').length > 2"


def test_a_take_is_labelled_corrected_learned_and_taken_back(show, running, recording, strange):
    page = show("/takes")
    page.find("#take-file").send_keys(str(recording[0]))
    page.wait(LABELLED, seconds=60)
    assert page.run("return document.querySelector('.tl-segment') !== null")
    inside = 0.5 * sum(strange[0])
    page.run(SEEK, inside / sum(end - start for start, end in recording[1]))
    time = float(page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow')"))
    assert time == pytest.approx(inside, abs=0.2)
    page.run("document.querySelector('#choose-stretch').click()")
    page.find("#category").send_keys(STRANGE)
    page.run("document.querySelector('#correct').click()")
    page.wait("return document.querySelectorAll('.corrections li').length === 1", seconds=60)
    page.wait("return document.querySelector('.tl-corrected') !== null")
    page.wait(
        "return [...document.querySelectorAll('.notice')].some((one) => one.textContent.includes('Learned'))",
        seconds=60,
    )
    names = page.run("return [...document.querySelectorAll('#segments tbody th')].map((one) => one.innerText)")
    assert sum(STRANGE in name for name in names) >= 2, names
    page.run("document.querySelector('.undo').click()")
    page.wait("return document.querySelectorAll('.corrections li').length === 0", seconds=60)
    page.wait("return document.querySelector('.tl-corrected') === null", seconds=60)


def ask(running, path, **asked):
    """An answer of a studio that listens."""
    address = f"{running.url}/api{path}?{urlencode(asked)}"
    with urlopen(Request(address, headers={"authorization": f"Bearer {running.token}"}), timeout=60) as answer:
        return json.load(answer)


# What can be used and lies under a message.
COVERED = """
const notices = document.querySelector('#notices');
const own = notices.getBoundingClientRect();
return [...document.querySelectorAll('button, a[href], input, select')].filter((one) => {
  const box = one.getBoundingClientRect();
  return one.checkVisibility() && !notices.contains(one)
    && box.left < own.right && box.right > own.left && box.top < own.bottom && box.bottom > own.top;
}).map((one) => one.outerHTML.slice(0, 80));
"""


CORRECTED = "return document.querySelectorAll('.tl-segment.tl-corrected').length"


def check_steps_back(page, running, motion, known, place):
    """Each correction was one change: keys take it back and do it again; so does the button of the message."""
    kept = "return document.querySelectorAll('.corrections li').length"
    ready = "return !document.querySelector('#review-join').disabled && !document.querySelector('#progress progress')"
    for key, held, count in (("z", KEYS.CONTROL, 2), ("z", KEYS.CONTROL, 1), ("y", KEYS.CONTROL, 2)):
        page.wait(ready, seconds=60)
        page.press(key, held=held)
        page.wait(f"{kept} === {count}", seconds=60)
        page.wait(f"{CORRECTED} === {count}", seconds=60)
    spans = [(one["start_s"], one["end_s"]) for one in ask(running, "/takes/labels", motion=motion)["corrections"]]
    assert spans[0][0] == pytest.approx(known["start_s"], abs=0.05)
    assert spans[0][1] == pytest.approx(spans[1][0]) and spans[1][1] == pytest.approx(known["end_s"], abs=0.05)

    # So was a stretch whose end was dragged; and the button of the message does the same.
    page.wait(ready, seconds=60)
    page.run("document.querySelector('.tl-inner').scrollIntoView({block: 'center'})")
    page.run(SEEK, place)
    page.run("document.querySelector('#choose-stretch').click()")
    end = page.find(".tl-end-end")
    ActionChains(page.driver, duration=0).click_and_hold(end).move_by_offset(-12, 0).release().perform()
    chosen = float(end.get_attribute("aria-valuenow"))
    assert spans[0][0] < chosen < spans[0][1] - 0.05
    page.run("document.querySelector('#notices').replaceChildren()")
    page.find("#correct").click()
    page.wait("return document.querySelector('.notice:last-child [data-act=undo]')", seconds=60)
    assert page.run(COVERED) == []
    (short, _) = ask(running, "/takes/labels", motion=motion)["corrections"]
    assert short["end_s"] == pytest.approx(chosen, abs=0.02)
    page.wait(ready, seconds=60)
    page.find(".notice:last-child [data-act=undo]").click()
    page.wait("return document.querySelector('.notice:last-child [data-act=redo]')", seconds=60)
    now = ask(running, "/takes/labels", motion=motion)["corrections"]
    assert [(one["start_s"], one["end_s"]) for one in now] == spans


def test_stretches_are_gone_through_split_and_joined(show, running, recording):
    library = running.app.state.studio.library
    library.add(recording[0], kind="take")
    take = next(clip for clip in library.clips() if clip.kind == "take")
    page = show(f"/takes?motion=clip:{take.id}")
    page.wait(LABELLED, seconds=60)
    shown = ask(running, "/takes/labels", motion=f"clip:{take.id}")["labels"]["segments"]
    press = "document.dispatchEvent(new KeyboardEvent('keydown', {key: arguments[0], bubbles: true}))"
    cursor = "return Number(document.querySelector('.tl-cursor').getAttribute('aria-valuenow'))"

    # The least sure first; then the next.
    order = sorted(shown, key=lambda one: one["confidence"])
    for one in order[:2]:
        page.run(press, "u")
        assert page.run(cursor) == pytest.approx(one["start_s"], abs=0.02)
        assert page.run("return document.querySelector('#category').value") == (one["category"] or "")
    assert page.run("return document.querySelectorAll('.tl-sure').length") == len(shown)

    # One that has a name is right: it is learned.
    known = next(one for one in shown if one["category"] and one["end_s"] - one["start_s"] > 1.0)
    go = "document.querySelector(`#segments tr[data-start='${arguments[0]}'] .go`).click()"
    page.run(go, known["start_s"])
    page.run(press, "y")
    page.wait(f"{CORRECTED} === 1", seconds=60)
    page.wait("return !document.querySelector('#review-split').disabled", seconds=60)

    # It is split in its middle, and made whole again.
    page.run("document.querySelector(`#segments tr[aria-current]`)?.removeAttribute('aria-current')")
    start = page.run("return document.querySelector('.tl-corrected').style.left")
    share = float(start.removesuffix("%")) / 100
    width = float(page.run("return document.querySelector('.tl-corrected').style.width").removesuffix("%")) / 100
    page.run(SEEK, share + 0.5 * width)
    page.run(press, "x")
    page.wait(f"{CORRECTED} === 2", seconds=60)
    page.wait("return !document.querySelector('#review-join').disabled", seconds=60)
    page.run(SEEK, share + 0.25 * width)
    page.run(press, "j")
    page.wait(f"{CORRECTED} === 1", seconds=60)
    page.wait("return !document.querySelector('#review-join').disabled", seconds=60)
    (whole,) = ask(running, "/takes/labels", motion=f"clip:{take.id}")["corrections"]
    assert (whole["start_s"], whole["end_s"]) == pytest.approx((known["start_s"], known["end_s"]), abs=0.05)
    assert whole["category"] == known["category"]

    check_steps_back(page, running, f"clip:{take.id}", known, share + 0.25 * width)


def test_takes_are_listed_and_their_stretches_exported_and_searched_for(show, running, recording, downloads):
    from dousa.formats.registry import read_motion

    library = running.app.state.studio.library
    library.add(recording[0], kind="take")
    take = next(clip for clip in library.clips() if clip.kind == "take")
    name = f"clip:{take.id}"
    assert ask(running, "/takes/strips", motion=name)["takes"][name]["segments"] is None
    page = show(f"/takes?motion={name}")
    page.wait(LABELLED, seconds=60)
    page = show("/takes")
    page.wait("return document.querySelectorAll('.take-strip i').length > 2")
    labels = ask(running, "/takes/labels", motion=name)["labels"]["segments"]
    assert page.run("return document.querySelectorAll('.take-strip i').length") == len(labels)
    assert str(len(labels)) in page.run("return document.querySelector('.take-row .note').textContent")
    assert page.messages() == []

    page = show(f"/takes?motion={name}&at_s=3")
    page.wait(LABELLED, seconds=60)
    assert float(page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow')")) == 3
    start, end = page.run(
        "const row = document.querySelectorAll('#segments tbody tr')[1]; row.querySelector('.export').click();"
        "const next = row.nextElementSibling;"
        "return [Number(row.dataset.start), next ? Number(next.dataset.start) : null]"
    )
    page.wait("return document.querySelector('#export-format option')")
    page.run("const one = document.querySelector('#export-format'); one.value = 'bvh';"
             "one.dispatchEvent(new Event('change'))")  # fmt: skip
    page.find("#export-go").click()
    part = read_motion(downloads(".bvh"))
    assert part.duration == pytest.approx(end - start, abs=0.3)
    # What is chosen on the timeline is exported by the same button as any other part.
    assert page.run("return document.querySelector('#export-part').disabled")
    page.run("document.querySelector('#choose-stretch').click()")
    page.wait("return !document.querySelector('#export-part').disabled")
    page.find("#export-part").click()
    page.wait("return document.querySelectorAll('dialog[open]').length")
    assert page.messages() == []

    page = show(f"/takes?motion={name}&at_s=3")
    page.wait(LABELLED, seconds=60)
    page.run("document.querySelector('.acts a').click()")
    page.wait("return location.pathname === '/search'")
    page.wait("return document.querySelector('.verdict-words') !== null")
    assert "start_s=" in page.run("return location.search")


def test_a_dropped_take_is_added(show, running, recording):
    page = show("/takes")
    page.find("#take-file").send_keys(str(recording[0]))
    page.wait("return document.querySelector('#add-take') !== null")
    page.wait(LABELLED, seconds=60)
    page.run("document.querySelector('#add-take').click()")
    page.wait("return location.search.includes('motion=clip')", seconds=60)
    page.wait(LABELLED, seconds=60)


def test_the_clip_of_a_correction_moves_as_the_take_did(studio, recording, strange):
    motion = upload(studio, recording)
    start, end = strange[0]
    asked = {"motion": motion, "start_s": start, "end_s": end, "category": STRANGE}
    clip = studio.post("/api/takes/correct", json=asked).json()["clip"]
    library = studio.app.state.studio.library
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise

    whole = canonicalise(read_motion(Path(recording[0])))
    first = round(start * whole.frame_rate)
    kept = library.trajectories(int(clip[5:])).positions
    np.testing.assert_allclose(kept, whole.positions[first : first + len(kept)], atol=1e-3)


BACK_AT_START = """
    const problem = document.querySelector('#problem');
    return !problem.hidden && problem.textContent !== '' && document.querySelector('#take').hidden
      && document.querySelector('#take-file') !== null
"""


@pytest.mark.parametrize("asked", ["motion=clip:99999", "job=0123456789abcdef"])
def test_a_take_that_is_gone_leads_back_to_the_start(show, running, asked):
    page = show(f"/takes?{asked}")
    page.wait(BACK_AT_START)
    page.messages()  # the browser tells of the refused requests itself


# --- labels that were given


@pytest.fixture
def table(recording):
    """A table of labels of the take."""
    rows = [f"{start:.3f},{end:.3f},{name}" for (start, end), name in zip(recording[1], ORDER, strict=True)]
    return "\n".join(["start_s,end_s,category", *rows[:-1]])


def add_take(client, recording, wait_job, table=None):
    """Name of the take in the library."""
    batch = upload(client, recording)[5:21]
    if table is not None:
        answer = client.post(f"/api/uploads?name=session.labels.csv&batch={batch}", content=table.encode())
        assert answer.json()["files"][0]["motion"] is None
    request = {"batch": batch, "kind": "take", "category_from": None, "labels": table is not None}
    job = wait_job(client, client.post("/api/jobs/add", json=request).json()["id"])
    assert job["state"] == "done", job
    take = next(clip for clip in client.app.state.studio.library.clips() if clip.kind == "take")
    return f"clip:{take.id}", job["result"]


def get_given(client, motion):
    return client.get("/api/takes/labels", params={"motion": motion}).json()["given"]


def test_takes_are_added_with_tables_that_are_downloaded_as_they_are_read(studio, recording, table, wait_job, tmp_path):
    from dousa.formats.motion_files import FoundFile
    from dousa.library.annotations.matching import find_labels

    motion, result = add_take(studio, recording, wait_job, table)
    assert (len(result["labelled"]), result["n_segments"]) == (1, len(ORDER) - 1)
    given = get_given(studio, motion)
    assert given["source"] == "session.labels.csv"
    assert [one["category"] for one in given["segments"]] == [*ORDER[:-1], None]
    for format, name in (("csv", "session.labels.csv"), ("eaf", "session.eaf")):
        answer = studio.get("/api/takes/export", params={"motion": motion, "format": format, "given": True})
        assert answer.status_code == 200
        assert f'filename="{name}"' in answer.headers["content-disposition"]
        folder = tmp_path / format
        folder.mkdir()
        (folder / name).write_bytes(answer.content)
        take = Path(shutil.copy(recording[0], folder))
        (found,) = find_labels([FoundFile(folder, take)], "beside", None).values()  # without another name
        assert [one.category for one in found.tiers[0].spans if one.category] == list(ORDER[:-1])
        came = studio.post(f"/api/uploads?name=other.{format}", content=answer.content).json()
        asked = {"motion": motion, "batch": came["batch"], "name": f"other.{format}"}
        again = studio.post("/api/takes/annotate", json=asked)
        assert again.status_code == 201 and again.json()["notes"] == []
        assert get_given(studio, motion)["segments"] == given["segments"]
    segments = label(studio, motion, wait_job)
    for format in ("csv", "eaf"):
        recognised = studio.get("/api/takes/export", params={"motion": motion, "format": format})
        assert recognised.status_code == 200 and segments


def test_what_is_wrong_with_a_dropped_table_is_said(studio, recording, wait_job):
    dropped = upload(studio, recording)
    came = studio.post("/api/uploads?name=a.labels.csv", content=b"start_s,end_s,category\n2,1,hop\n").json()
    asked = {"batch": came["batch"], "name": "a.labels.csv"}
    answer = studio.post("/api/takes/annotate", json={"motion": dropped, **asked})
    assert answer.status_code == 409, answer.text
    motion, _ = add_take(studio, recording, wait_job)
    answer = studio.post("/api/takes/annotate", json={"motion": motion, **asked})
    assert answer.status_code == 422 and "a.labels.csv:2: 'hop' ends at 1" in answer.text
    assert str(studio.app.state.studio.workspace.root) not in answer.text
    assert get_given(studio, motion) is None


def drop_table(client, motion, content):
    """The answer to a table of labels that is dropped onto a take."""
    came = client.post("/api/uploads?name=a.labels.csv", content=f"start_s,end_s,category\n{content}".encode()).json()
    return client.post("/api/takes/annotate", json={"motion": motion, "batch": came["batch"], "name": "a.labels.csv"})


def test_tables_of_labels_are_dropped_onto_a_take(studio, recording, table, wait_job):
    motion, _ = add_take(studio, recording, wait_job, table)
    before = get_given(studio, motion)
    for rows, said in (("2067,6667,hop\n", "milliseconds"), ("900.5,901.5,hop\n", "none lies within the take")):
        answer = drop_table(studio, motion, rows)
        assert answer.status_code == 422 and "a.labels.csv:2: 'hop'" in answer.text and said in answer.text
        assert str(studio.app.state.studio.workspace.root) not in answer.text
    assert get_given(studio, motion) == before

    answer = drop_table(studio, motion, "0,2,hop\n0,2,clap\n0,2,hop\n3,4,unknown\n")
    assert answer.status_code == 201 and answer.json()["n_segments"] == 2
    said = " ".join(answer.json()["notes"])
    assert "there twice" in said and "read as no category" in said and "earlier segments removed" in said
    answer = drop_table(studio, motion, "")
    assert answer.status_code == 201 and (answer.json()["n_segments"], answer.json()["given"]) == (0, None)
    said = " ".join(answer.json()["notes"])
    assert "a.labels.csv has no labels" in said and "2 earlier segments removed" in said
    assert not [clip for clip in studio.app.state.studio.library.clips() if clip.take_id is not None]

    # two labels at one time are both kept, and one of them can be corrected
    drop_table(studio, motion, "0,2,hop\n0,2,clap\n2.5,4,walk\n")
    for category, meant in (("wave", "clap"), ("bow", "wave")):
        asked = {"motion": motion, "start_s": 0.1, "end_s": 2.0, "category": category, "instead_of": meant}
        assert studio.post("/api/takes/correct", json=asked).status_code == 201
        named = [one["category"] for one in get_given(studio, motion)["segments"] if one["category"]]
        assert sorted(named) == sorted(["hop", category, "walk"])

    drop_table(studio, motion, "0,2,hop\n0,2,clap\n2.5,4,walk\n3,3.5,nod\n")
    told = [(one["start_s"], one["end_s"], one["category"]) for one in get_given(studio, motion)["segments"]]
    named = [(0.0, 2.0, "hop"), (0.0, 2.0, "clap"), (2.5, 4.0, "walk"), (3.0, 3.5, "nod")]
    assert sorted(one for one in told if one[2]) == sorted(named)
    got = studio.get("/api/takes/export", params={"motion": motion, "format": "csv", "given": True}).text
    rows = [(float(row["start_s"]), float(row["end_s"]), row["category"]) for row in csv.DictReader(io.StringIO(got))]
    assert sorted(row for row in rows if row[2]) == sorted(named)
    library = studio.app.state.studio.library
    library.remove([one.clip_id for one in library.annotations.read()[0].segments if one.category == "walk"])
    got = studio.get("/api/takes/export", params={"motion": motion, "format": "csv", "given": True}).text
    rows = list(csv.DictReader(io.StringIO(got)))
    assert {row["perhaps"] for row in rows if 2.5 <= float(row["start_s"]) < 4 and not row["category"]} == {"?"}


def test_both_labels_at_one_time_are_seen_and_chosen(show, running, recording, tmp_path):
    library = running.app.state.studio.library
    labels = tmp_path / "labels"
    labels.mkdir()
    rows = "0,2,hop\n0,2,clap\n2.5,4,walk\n3,3.5,nod\n"
    (labels / f"{recording[0].stem}.labels.csv").write_text(f"start_s,end_s,category\n{rows}")
    library.add(recording[0], kind="take", labels_from=f"folder:{labels}")
    take = next(clip for clip in library.clips() if clip.kind == "take")
    page = show(f"/takes?motion=clip:{take.id}&at_s=1")
    page.wait("return document.querySelectorAll('.tl-segment').length === 4", seconds=60)
    page.wait("return document.querySelectorAll('.now-one').length === 2", seconds=60)
    assert page.run("return document.querySelectorAll('#segments tr[aria-current]').length") == 2
    names = page.run("return [...document.querySelectorAll('.choices button')].map((one) => one.textContent)")
    assert ["hop" in names[0], "clap" in names[1], len(names)] == [True, True, 2]
    for number, name in enumerate(("hop", "clap")):
        button = page.run("return document.querySelectorAll('.choices button')[arguments[0]]", number)
        button.send_keys(KEYS.ENTER)
        assert page.run("return document.querySelector('#category').value") == name
    page.run("document.querySelector('.tl-cursor').focus()")
    page.find(".tl-cursor").send_keys(*[KEYS.ARROW_RIGHT] * 21)  # walk with nod in it
    page.wait("return document.querySelector('.now-what').textContent.includes('nod')")
    page.find(".tl-cursor").send_keys(KEYS.HOME, *[KEYS.ARROW_RIGHT] * 27)
    page.wait("return document.querySelectorAll('.choices button').length === 1")
    page.find(".tl-cursor").send_keys(KEYS.HOME, *[KEYS.ARROW_RIGHT] * 7)
    page.wait("return document.querySelectorAll('.choices button').length === 2")
    page.run("document.querySelectorAll('.choices button')[1].click()")
    page.run("document.querySelector('#category').value = ''")
    page.find("#category").send_keys("stamp", KEYS.ENTER)
    page.wait(
        "return [...document.querySelectorAll('.tl-segment')].some((one) => one.title.includes('stamp'))", seconds=60
    )
    assert {one.category for one in library.annotations.read()[0].segments} == {"hop", "stamp", "walk", "nod"}


def test_a_correction_of_a_take_of_the_library_is_a_segment_of_it(studio, recording, strange, wait_job):
    motion, _ = add_take(studio, recording, wait_job)
    start, end = strange[0]
    asked = {"motion": motion, "start_s": start, "end_s": end, "category": STRANGE}
    answer = studio.post("/api/takes/correct", json=asked).json()
    assert answer["is_learned"] and answer["is_new_category"]
    library = studio.app.state.studio.library
    (clip,) = [clip for clip in library.clips() if clip.take_id is not None]
    assert answer["clip"] == f"clip:{clip.id}" and f"clip:{clip.take_id}" == motion
    segments = label(studio, motion, wait_job)
    assert said_at(segments, strange) == [(STRANGE, True), (STRANGE, False)]
    number = studio.get("/api/takes/labels", params={"motion": motion}).json()["corrections"][0]["id"]
    assert studio.delete(f"/api/takes/corrections/{number}").status_code == 200
    assert not [clip for clip in library.clips() if clip.take_id is not None]


def test_labels_are_dropped_onto_a_take_and_shown(show, running, recording, table, tmp_path):
    labels = tmp_path / "session.labels.csv"
    labels.write_text(table)
    page = show("/takes")
    page.find("#take-file").send_keys(str(recording[0]))
    page.wait("return document.querySelector('#labels-file') !== null")
    page.wait(LABELLED, seconds=60)
    page.find("#labels-file").send_keys(str(labels))
    page.wait("return document.querySelector('#show-given')?.getAttribute('aria-pressed') === 'true'", seconds=60)
    names = "return [...document.querySelectorAll('#segments tbody th')].map((one) => one.innerText)"
    assert [name.split()[-1] for name in page.run(names)] == list(ORDER[:-1])
    assert "session.labels.csv" in page.run("return document.querySelector('#take-facts').textContent")
    page.run("document.querySelector('#show-given').click()")
    page.wait("return document.querySelector('#show-given')?.getAttribute('aria-pressed') === 'false'", seconds=60)
    assert "given=false" in page.run("return document.querySelector('#export-eaf').href")


def test_a_take_that_comes_with_its_table_is_added_with_its_labels(show, running, recording, table, tmp_path, faults):
    """A table of the same name, in any case, preselects takes; one of another name is said to be unread."""
    for name in ("SESSION.labels.csv", "other.labels.csv"):
        (tmp_path / name).write_text(table)
    page = show("/library")
    page.wait("return document.querySelector('.cell canvas') !== null")
    page.run("document.querySelector('#add-button').click()")
    page.wait("return document.querySelector('#add-files') !== null")
    names = [str(recording[0]), str(tmp_path / "SESSION.labels.csv"), str(tmp_path / "other.labels.csv")]
    page.find("#add-files").send_keys("\n".join(names))
    page.wait("return document.querySelector('#add-go') !== null")
    assert page.run("return document.querySelector('#add-kind-take').checked")
    assert page.run("return document.querySelector('#add-labels').checked")
    text = "return document.querySelector('dialog[open]').innerText"
    assert "Table of labels (1): SESSION.labels.csv" in page.run(text)
    assert "no motion has the same name: other.labels.csv" in page.run(text)
    assert "Read the labels beside them (1 table)" in page.run(text)
    assert "Other files" not in page.run(text) and "left aside" not in page.run(text)
    assert faults(page) == []
    page.run("document.querySelector('#add-kind-clip').click()")
    assert "left aside" in page.run(text)
    page.run("document.querySelector('#add-kind-take').click()")
    page.screenshot(tmp_path / "tables.png")
    page.run("document.querySelector('#add-go').click()")
    page.wait("return document.querySelector('#add-labelled') !== null", seconds=60)
    labelled = page.run("return document.querySelector('#add-labelled').textContent")
    assert labelled == f"1 take labelled, {len(ORDER) - 1} new segments: these are clips now."


@pytest.mark.parametrize(
    ("name", "content", "take"),
    [
        ("a/Day.Labels.CSV", "start_s,end_s,category\n", "a/Day"),
        ("day.csv", "start_s;end_s;category\n", "day"),
        ("day.eaf", "<ANNOTATION_DOCUMENT/>", "day"),
        ("day.TextGrid", "File type", "day"),
        ("day.boris.csv", "Observation id,x\n", "day"),
        ("day.csv", "file,stature\n", None),
        ("session.bvh", None, None),
    ],
)
def test_an_upload_says_which_take_a_table_belongs_to(studio, recording, name, content, take):
    body = recording[0].read_bytes() if content is None else content.encode()
    (file,) = studio.post("/api/uploads", params={"name": name}, content=body).json()["files"]
    assert file["labels_of"] == take and (file["motion"] is None) == (content is not None)


def open_annotated(show, running, recording, table, tmp_path):
    """The page of a take with given labels, which are shown."""
    library = running.app.state.studio.library
    take = tmp_path / "annotated" / "session.bvh"
    take.parent.mkdir()
    take.write_bytes(recording[0].read_bytes())
    take.with_name("session.labels.csv").write_text(table)
    library.add([take], kind="take", labels_from="beside")
    number = library.clips([take])[0].id
    page = show(f"/takes?motion=clip:{number}")
    page.wait(f"{GIVEN} === 'true'")
    # The labels are asked for once more when the job is over: before, its progress may not be shown yet.
    asked = "performance.getEntriesByType('resource').filter((one) => one.name.includes('/takes/labels?')).length"
    page.wait(f"return {asked} > 1", seconds=60)
    page.wait("return document.querySelector('#progress').children.length === 0", seconds=60)
    assert ask(running, "/takes/labels", motion=f"clip:{number}")["is_current"]
    page.settle()
    return page


GIVEN = "return document.querySelector('#show-given')?.getAttribute('aria-pressed')"
NOTICE = "return [...document.querySelectorAll('.notice')].find((one) => one.textContent.includes(arguments[0]))"


def test_labels_that_are_asked_for_again_are_shown(show, running, recording, table, tmp_path, faults):
    page = open_annotated(show, running, recording, table, tmp_path)
    assert "4 stretches from session.labels.csv" in page.run("return document.querySelector('#take-facts').textContent")
    page.run("document.querySelector('#label-again').click()")
    page.wait(f"{GIVEN} === 'false'", seconds=60)
    page.wait("return document.querySelector('#segments .sure') !== null")  # how sure each is: recognised ones
    page.wait(NOTICE, "Labelled again")
    assert faults(page) == []
    page.run(f"{NOTICE.removeprefix('return ')}.querySelector('button').click()", "Labelled again")
    page.wait(f"{GIVEN} === 'true'")


def test_what_was_learned_leads_to_the_other_place(show, running, recording, strange, table, tmp_path, faults):
    """Given labels hide what the library recognises; the message of a correction leads there."""
    head, *rows = table.splitlines()
    unsaid = [f"{row.removesuffix(STRANGE)},{STRANGE}" if row.endswith(STRANGE) else f"{row}," for row in rows]
    known = "\n".join([f"{head},perhaps", *unsaid])  # nobody can say what the unknown motions are
    page = open_annotated(show, running, recording, known, tmp_path)
    whole = recording[1][-1][1]
    page.run(
        """
        const box = document.querySelector('.tl-inner').getBoundingClientRect();
        const at = (share) => ({clientX: box.left + share * box.width, clientY: box.top + 50, bubbles: true,
          pointerId: 1, pointerType: 'mouse', button: 0, cancelable: true});
        const [start, end] = arguments;
        document.querySelector('.tl-track').dispatchEvent(new PointerEvent('pointerdown', at(start)));
        for (const to of [0.5 * (start + end), end]) window.dispatchEvent(new PointerEvent('pointermove', at(to)));
        window.dispatchEvent(new PointerEvent('pointerup', at(end)));
        """,
        *(seconds / whole for seconds in strange[0]),
    )
    page.find("#category").send_keys(STRANGE)
    page.run("document.querySelector('#correct').click()")
    page.wait(NOTICE, "Learned", seconds=60)
    assert page.run(f"{NOTICE}.querySelector('p').textContent", "Learned").endswith("1 other place is called that now.")
    assert page.run(GIVEN) == "true"
    page.screenshot(tmp_path / "learned.png")
    assert faults(page) == []
    page.run(f"{NOTICE.removeprefix('return ')}.querySelector('[data-act=show]').click()", "Learned")
    page.wait(f"{GIVEN} === 'false'")
    page.wait(f"return document.querySelector('#category').value === '{STRANGE}'")
    time = float(page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow')"))
    assert strange[1][0] - 1.5 < time < strange[1][1]


def test_a_table_that_is_refused_is_told_with_its_line(show, running, recording, table, tmp_path, faults):
    """In the dialog, which goes back to the questions: the mended table takes the place of the other one."""
    labels = tmp_path / "session.labels.csv"
    labels.write_text("start_s,end_s,category\n2,1,hop\n")
    page = show("/library")
    page.wait("return document.querySelector('.cell canvas') !== null")
    page.run("document.querySelector('#add-button').click()")
    page.find("#add-files").send_keys(f"{recording[0]}\n{labels}")
    page.wait("return document.querySelector('#add-go') !== null")
    page.run("document.querySelector('#add-go').click()")
    page.wait("return document.querySelector('dialog .problem-box') !== null", seconds=60)
    said = page.run("return document.querySelector('dialog .problem-box').textContent")
    assert said.startswith("session.labels.csv:2: 'hop' ends at 1"), said
    page.screenshot(tmp_path / "refused.png")
    assert faults(page) == []
    assert not [clip for clip in running.app.state.studio.library.clips() if clip.kind == "take"]
    page.run("document.querySelector('#add-back').click()")
    page.wait("return document.querySelector('#add-labels')?.checked")
    labels.write_text(table)
    page.run(
        "const files = new DataTransfer(); files.items.add(new File([arguments[0]], 'session.labels.csv'));"
        "document.documentElement.dispatchEvent("
        "new DragEvent('drop', {bubbles: true, cancelable: true, dataTransfer: files}));",
        table,
    )
    page.wait("return document.querySelector('#add-go') !== null && document.querySelector('#came-tables') !== null")
    page.wait("return document.querySelector('dialog progress') === null")
    assert "(1)" in page.run("return document.querySelector('#came-tables').textContent")
    page.run("document.querySelector('#add-go').click()")
    page.wait("return document.querySelector('#add-labelled') !== null", seconds=60)
