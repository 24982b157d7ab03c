"""The evaluation page in a real Chromium: choose, grade, look, adjust; reload, two tabs, both languages, a phone."""

import urllib.request
from typing import Any

import pytest


@pytest.fixture
def address(client, dances):
    """The page with the motions chosen."""
    takes, pupil = dances
    references = ",".join(client.upload(path) for path in takes)
    return f"/evaluate?performance={client.upload(pupil)}&references={references}"


def _grade(page: Any) -> str:
    page.wait("return document.querySelector('#grade') && !document.querySelector('#grade').disabled")
    page.find("#grade").click()
    return _wait_report(page)


def _wait_report(page: Any) -> str:
    page.wait("return document.querySelector('#adjust-score')?.textContent")
    page.run("document.querySelector('#analysis').open = true")
    return page.run("return new URLSearchParams(location.search).get('job')")


def _score(page: Any) -> float:
    return float(page.run("return document.querySelector('#adjust-score').textContent"))


def _settled(page: Any) -> None:
    page.wait(
        "return document.querySelector('#adjust-state').dataset.state === 'exact' && "
        "document.querySelector('#report').getAttribute('aria-busy') === 'false'",
        seconds=60,
    )


def _slide(page: Any, name: str, value: float) -> None:
    page.run(
        "const one = document.querySelector(`[data-weight='${arguments[0]}']`); one.value = arguments[1];"
        "for (const name of ['input', 'change']) one.dispatchEvent(new Event(name, {bubbles: true}));",
        name,
        str(value),
    )


def test_from_files_to_a_grade(show, dances):
    takes, pupil = dances
    page = show("/evaluate")
    assert page.run("return document.querySelector('#grade').disabled")
    page.find("#performance-file").send_keys(str(pupil))
    page.wait("return document.querySelector('#performance .motion-name')?.textContent === 'dance_pupil.bvh'")
    page.find("#reference-file").send_keys("\n".join(map(str, takes)))
    page.wait("return document.querySelectorAll('#reference-list .motion').length === 3")
    names = "return [...document.querySelectorAll('#reference-list .motion-name')].map((one) => one.textContent)"
    assert page.run(names) == [take.name for take in takes], "in the order in which they were chosen"
    _grade(page)
    assert page.run("return document.querySelectorAll('#events [data-event]').length") >= 2
    assert "calibrated" in page.run("return document.querySelector('.grade .badge').textContent")
    # A press on an error goes there.
    page.run("document.querySelector('#events [data-event]').click()")
    page.wait("return document.querySelector('#events [data-event]').getAttribute('aria-current') === 'true'")
    assert float(page.run("return document.querySelector('#lanes').getAttribute('aria-valuenow')")) > 0.5


def _compare_counts(page):
    sliders = page.run("return [...document.querySelectorAll('[data-counts^=segment]')].map((e) => e.textContent)")
    shown = page.run("return [...document.querySelectorAll('.segment-table .counts span')].map((e) => e.textContent)")
    assert len(shown) == 9
    assert [text.removeprefix("counts ") for text in sliders] == shown


def test_the_report_follows_cuts_and_weights(show, address):
    from selenium.webdriver import ActionChains

    page = show(address)
    _grade(page)
    count = page.run("return document.querySelectorAll('.furi-table tbody tr:not(.counts-row)').length")
    # One figure has one grade, here and in the report, which is rounded once.
    texts = "return [...document.querySelectorAll(arguments[0])].map((one) => Number(one.textContent))"
    shown, said = page.run(texts, ".cuts-table .figure-score"), page.run(texts, ".furi-table tbody td.strong")
    assert len(shown) == len(said) and all(abs(a - b) < 0.56 for a, b in zip(shown, said, strict=True))
    # A cut is moved by keyboard, and one is taken away by mouse.
    page.run("document.querySelectorAll('.tl-cut')[1].focus()")
    page.press("\ue014", "\ue014", "\ue014")
    page.wait("return document.querySelector('#adjust-changed').classList.contains('is-changed')")
    _settled(page)
    cut = page.find("#cuts-timeline .tl-cut:nth-child(3)")
    page.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", cut)
    ActionChains(page.driver).double_click(cut).perform()
    page.wait(
        f"return document.querySelectorAll('.furi-table tbody tr:not(.counts-row)').length === {count - 1}", seconds=60
    )
    _settled(page)
    assert page.run("return document.querySelectorAll('.lanes .band').length") == count - 1
    page.find("#reset-cuts").click()
    page.wait(
        f"return document.querySelectorAll('.furi-table tbody tr:not(.counts-row)').length === {count}", seconds=60
    )
    # What does not count does not count.
    before = _score(page)
    _slide(page, "limb-arms", 0)
    page.wait(f"return Number(document.querySelector('#adjust-score').textContent) !== {before}")
    _settled(page)
    assert "Arms 0" in page.run("return document.querySelector('#adjust-changed').textContent")
    shown = float(page.run("return document.querySelector('.grade .number').textContent"))
    assert shown == pytest.approx(_score(page), abs=0.6)
    # Beside the sliders stands what the report says that the segments count.
    _compare_counts(page)
    # Nothing that counts is refused in words, and the report stays.
    for limb in ("trunk", "legs"):
        _slide(page, f"limb-{limb}", 0)
    page.wait("return !document.querySelector('.adjust .problem-box').hidden")
    assert "at least one weight above 0" in page.run(
        "return document.querySelector('.adjust .problem-box').textContent"
    )
    page.find("#reset-weights").click()
    page.wait(f"return Number(document.querySelector('#adjust-score').textContent) === {before}")
    _settled(page)
    # Chromium notes the answer that refused; it was asked for.
    assert [text for text in page.messages() if "422" not in text] == []


def test_reload_keeps_everything_and_two_tabs_do_no_harm(show, address, running):
    page = show(address)
    first = _grade(page)
    _slide(page, "limb-legs", 0.5)
    _settled(page)
    kept = _score(page)
    page.driver.refresh()
    assert _wait_report(page) == first
    assert _score(page) == kept
    assert page.run("return document.querySelector('[data-weight=limb-legs]').value") == "0.5"
    # Another evaluation in another tab, the other way round.
    mine = page.driver.current_window_handle
    page.driver.switch_to.new_window("tab")
    page.resize(1280, 720)
    page.driver.get(f"{running.url}{address}&mirror=1")
    page.wait("return document.querySelector('#mirrored')?.checked")
    second = _grade(page)
    assert second != first
    other = _score(page)
    assert "left and right are the reference's" in page.run("return document.querySelector('.warnings').textContent")
    page.driver.switch_to.window(mine)
    _slide(page, "limb-legs", 0.6)
    _settled(page)
    page.driver.switch_to.window(next(name for name in page.driver.window_handles if name != mine))
    page.driver.refresh()
    assert _wait_report(page) == second and _score(page) == other
    assert page.messages() == []
    page.driver.close()
    page.driver.switch_to.window(mine)


def test_changes_of_figures_and_weights_are_undone_by_keys_and_buttons(show, address):
    page = show(address)
    _grade(page)
    disabled = "return ['undo', 'redo'].map((one) => document.querySelector(`#adjust-${one}`).disabled)"
    arms = "return document.querySelector('[data-weight=limb-arms]').value"
    count = "return document.querySelectorAll('.cuts-table tbody tr').length"
    assert page.run(disabled) == [True, True]
    figures = page.run(count)
    _slide(page, "limb-arms", 0.5)
    _settled(page)
    page.run("document.querySelectorAll('.cuts-table tbody tr')[1].querySelector('td:last-child button').click()")
    _settled(page)
    assert (page.run(count), page.run(arms)) == (figures - 1, "0.5")
    score = _score(page)

    page.run("document.activeElement.blur()")
    page.press("z", held="\ue009")
    assert (page.run(count), page.run(arms)) == (figures, "0.5")
    page.press("z", held="\ue009")
    assert (page.run(count), page.run(arms)) == (figures, "1")
    assert page.run(disabled) == [True, False]
    page.press("y", held="\ue009")
    assert (page.run(count), page.run(arms)) == (figures, "0.5")
    page.find("#adjust-redo").click()
    assert page.run(count) == figures - 1
    assert page.run(disabled) == [False, True]
    _settled(page)
    assert _score(page) == score
    # A field has an undo of its own.
    page.run("document.querySelector('.figure-name').focus()")
    page.press("z", held="\ue009")
    assert page.run(count) == figures - 1


def test_takes_are_suggested(show, client):
    walk = client.ask("GET", "/api/clips?category=walk")["items"][0]["motion"]
    page = show(f"/evaluate?performance={walk}")
    page.wait("return document.querySelector('#suggest') && !document.querySelector('#suggest').disabled")
    page.find("#suggest").click()
    page.wait("return document.querySelectorAll('#reference-list .motion').length === 5")
    names = page.run(
        "return [...document.querySelectorAll('#reference-list .motion')].map((one) => one.dataset.motion)"
    )
    assert walk not in names
    page.find("#reference-list .motion:nth-child(2) .quiet").click()
    again = page.run(
        "return [...document.querySelectorAll('#reference-list .motion')].map((one) => one.dataset.motion)"
    )
    assert again[0] == names[1] and sorted(again) == sorted(names)
    page.driver.refresh()
    page.wait("return document.querySelectorAll('#reference-list .motion').length === 5")


def test_problems_are_told_and_the_choice_stays(show, client, dances):
    takes, pupil = dances
    motion = client.upload(pupil)
    page = show(f"/evaluate?performance={motion}&references={client.upload(takes[0])}&start_s=3&end_s=3.2")
    page.wait("return document.querySelector('#grade') && !document.querySelector('#grade').disabled")
    page.find("#grade").click()
    page.wait("return !document.querySelector('#problem').hidden")
    said = page.run("return document.querySelector('#problem').textContent")
    assert "dance_pupil.bvh: performance: expected a motion of at least 0.5 s" in said
    page.wait("return document.querySelector('#performance .part input')?.value === '3'")
    assert page.messages() == []
    page = show("/evaluate?job=00000000000000ff")
    page.wait("return !document.querySelector('#problem').hidden")
    assert all("404" in text for text in page.messages())


def test_a_teacher_adds_notes_and_prints_what_a_pupil_needs(show, address, client, running):
    """Two sheets have grade, advice, notes and timeline; the analysis stays folded until it is opened."""
    import base64

    page = show(address, 1440, 900, "light", "en")
    page.run("localStorage.removeItem('dousa_analysis')")
    page.wait("return document.querySelector('#grade') && !document.querySelector('#grade').disabled")
    page.find("#grade").click()
    page.wait("return document.querySelector('#adjust-score')?.textContent")
    job = page.run("return new URLSearchParams(location.search).get('job')")
    assert not page.run("return document.querySelector('#analysis').open")
    field = page.find("#notes")
    field.send_keys("Softer knees. <b>See</b> you Monday.")
    page.wait("return document.querySelector('[data-part=notes] .note').textContent !== ''")
    assert client.ask("GET", f"/api/evaluations/{job}/report")["notes"] == "Softer knees. <b>See</b> you Monday."

    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    seen = page.run("""
        const shown = (one) => document.querySelector(one).getClientRects().length > 0;
        return Object.fromEntries(['.head', '#analysis', '#notes', '.only-print', '[data-part=advice]',
          '[data-part=timeline]', '[data-part=moments]', '#player', 'body > .bar'].map((one) => [one, shown(one)]));
    """)
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert [name for name, shown in seen.items() if shown] == [
        ".only-print",
        "[data-part=advice]",
        "[data-part=timeline]",
    ]
    sheet = page.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
    assert 1 <= base64.b64decode(sheet["data"]).count(b"/Type /Page\n") <= 2

    # They are still there after a reload, and in the report that is downloaded, as text.
    page.driver.refresh()
    page.wait("return document.querySelector('#notes')?.value")
    assert page.run("return document.querySelector('#notes').value") == "Softer knees. <b>See</b> you Monday."
    headers = {"authorization": f"Bearer {running.token}"}
    request = urllib.request.Request(f"{running.url}/api/evaluations/{job}/report.html", headers=headers)
    with urllib.request.urlopen(request) as answer:
        assert "Softer knees. &lt;b&gt;See&lt;/b&gt; you Monday." in answer.read().decode()

    # What lies open is remembered; nothing of the report lies over the rest.
    page.run("document.querySelector('#analysis').open = true")
    page.driver.refresh()
    page.wait("return document.querySelector('#analysis')?.open")
    over = """
        return [...document.querySelectorAll('#report :is(td, th)')]
          .filter((one) => ['absolute', 'fixed'].includes(getComputedStyle(one).position)).length
    """
    assert page.run(over) == 0
