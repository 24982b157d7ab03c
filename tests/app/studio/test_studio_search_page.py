"""The page of searching in a browser."""

import re
import urllib.parse
from pathlib import Path

import pytest

from app.studio.test_studio_search import add_take

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"

BACK_AT_START = """
    const problem = document.querySelector('#problem');
    return !problem.hidden && problem.textContent !== '' && document.querySelector('#search').hidden
      && document.querySelector('#query-file') !== null
"""
DRAWN = "return document.querySelectorAll('.hit').length > 3 && document.querySelector('.verdict-words') !== null"
FIGURES = "return dousa.miniatures.count"


def first_clip(running, category="kick_left"):
    return f"clip:{running.app.state.studio.library.clips(category=category)[0].id}"


def find_query_file(bvh):
    """A real recording if there is one here, else a made one."""
    if SHARED.is_dir():
        real = sorted((SHARED / "bandai").rglob("*.bvh")) or sorted(SHARED.rglob("*.bvh"))
        if real:
            return real[0]
    return bvh


def test_a_dropped_file_is_searched_for_and_plays_in_step(show, running, bvh):
    page = show("/search")
    page.find("#query-file").send_keys(str(find_query_file(bvh)))
    page.wait(DRAWN)
    page.wait(f"{FIGURES} > 3")
    assert "motion=file" in page.run("return location.search")
    drawn = page.run("return dousa.miniatures.drawn")
    page.wait("return dousa.miniatures.drawn > arguments[0] + 10", drawn)
    before = page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow')")
    page.wait("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow') !== arguments[0]", before)


def test_a_hit_is_shown_beside_the_query_and_can_be_downloaded(show, running, tmp_path):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("document.querySelector('.hit-open').click()")
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    page.wait("return document.querySelector('#download') !== null")
    assert "hit=clip" in page.run("return location.search")
    address = page.run("return document.querySelector('#download').getAttribute('href')")
    text = page.driver.execute_async_script(
        "const done = arguments[1]; fetch(arguments[0]).then((answer) => answer.text()).then(done);", address
    )
    assert text.startswith("HIERARCHY")
    page.driver.refresh()
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    page.driver.back()
    page.wait("return document.querySelector('#match').hidden")


def test_a_search_is_shown_as_a_command_and_as_python(show):
    page = show("/search?motion=clip:1&k=6")
    page.wait("return document.querySelector('#spelling button')?.offsetParent")
    page.run("document.querySelector('#spelling button').click()")
    page.wait("return document.querySelectorAll('dialog pre').length === 2")
    command, python = page.run("return [...document.querySelectorAll('dialog pre')].map((one) => one.textContent)")
    assert command.startswith("dousa search ") and command.endswith(" 1 -k 6")
    assert "library.search(1, k=6)" in python


def test_reasons_are_told_when_asked_for(show, running):
    page = show(f"/search?motion={first_clip(running, 'squat')}")
    page.wait(DRAWN)
    page.run("document.querySelector('.hit .why summary').click()")
    page.wait("return document.querySelector('.hit .why .reasons li, .hit .why .note:not(:only-child)') !== null")
    page.run("document.querySelector('#verdict .why summary').focus()")
    page.press("\ue007")  # Enter
    page.wait("return document.querySelectorAll('#verdict .reasons li').length > 0")


def test_a_part_is_chosen_by_keyboard_and_by_mouse(show, running):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("document.querySelector('.tl-cursor').focus()")
    page.press("\ue011", *["\ue014"] * 4)  # home, right
    page.press("[")
    page.press(*["\ue014"] * 6)
    page.press("]")
    page.wait("return location.search.includes('start_s=0') && location.search.includes('end_s=')")
    page.press("\ue00c")  # Escape
    page.wait("return !location.search.includes('start_s')")
    page.run("""
        const inner = document.querySelector('.tl-inner'), box = inner.getBoundingClientRect();
        const at = (share) => ({clientX: box.left + share * box.width, clientY: box.top + 50, bubbles: true,
          pointerId: 1, pointerType: 'mouse', button: 0, cancelable: true});
        document.querySelector('.tl-track').dispatchEvent(new PointerEvent('pointerdown', at(0.25)));
        for (const share of [0.3, 0.5, 0.75]) window.dispatchEvent(new PointerEvent('pointermove', at(share)));
        window.dispatchEvent(new PointerEvent('pointerup', at(0.75)));
    """)
    page.wait("return location.search.includes('start_s')")
    page.wait(DRAWN)
    page.driver.back()
    page.wait("return !location.search.includes('start_s')")


def test_places_inside_takes_open_at_their_moment(show, running, tmp_path):
    take = add_take(running.app.state.studio.library, tmp_path)
    page = show(f"/search?motion={first_clip(running)}")
    page.wait("return document.querySelector('.place-open') !== null")
    link = page.run("return document.querySelector('.place a').getAttribute('href')")
    assert link.startswith(f"/takes?motion=clip:{take}&at_s=")
    page.run("document.querySelector('.place-open').click()")
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    assert f"hit=clip%3A{take}" in page.run("return location.search")
    assert "other_start_s=" in page.run("return location.search")


DRAW_VERDICT = """
    const done = arguments[1];
    const core = document.querySelector('script[type=module][src*="/core/"]').src;
    import(core.replace('core/frame.js', 'search/verdict.js')).then(({drawVerdict}) => {
      const place = document.querySelector('#verdict');
      drawVerdict(place, arguments[0], {explain: async () => null, onGo: () => {}});
      done([place.className, place.querySelector('.verdict-head').textContent]);
    });
"""


def test_known_doubtful_and_unknown_are_three_answers(show, running, tmp_path):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait("return document.querySelector('.verdict-words') !== null")
    answer = {"category": None, "guess": "kick", "confidence": 0.31, "histogram": {"kick": 0.6, "march": 0.4}}
    look, said = page.driver.execute_async_script(DRAW_VERDICT, {**answer, "perhaps": True})
    assert "is-doubtful" in look and "is-unknown" not in look
    assert "perhaps kick" in said and "31 %" in said and "Unknown" not in said
    page.driver.save_screenshot(str(tmp_path / "doubtful.png"))
    look, said = page.driver.execute_async_script(DRAW_VERDICT, {**answer, "perhaps": False})
    assert "is-unknown" in look and "is-doubtful" not in look
    assert "Unknown" in said and "perhaps" not in said
    look, said = page.driver.execute_async_script(DRAW_VERDICT, {**answer, "category": "kick", "perhaps": False})
    assert not {"is-unknown", "is-doubtful"} & set(look.split())
    assert "kick, 31" in said and "sure" in said


def test_options_are_kept_in_the_address(show, running):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("""
        const select = document.querySelector('select[name=ranking]');
        select.value = 'pose';
        select.dispatchEvent(new Event('change'));
    """)
    page.wait("return location.search.includes('ranking=pose')")
    page.run("document.querySelector('input[name=mirror]').click()")
    page.wait("return location.search.includes('mirror=1')")
    page.wait(DRAWN)


def test_an_untrained_library_points_to_training(browser, tmp_path):
    from app.studio.conftest import listening
    from dousa.app.studio import Settings

    with listening(Settings(tmp_path / "new.dousa", token="t")) as found:
        browser.driver.get_log("browser")
        browser.driver.get(f"{found.url}/search?token=t&lang=en")
        browser.wait("return document.querySelector('#start .empty a') !== null")
        assert browser.run("return document.querySelector('#start .empty a').getAttribute('href')") == "/library"
        assert browser.messages() == []


def test_words_lead_to_motions(show, running):
    page = show("/search?text=" + urllib.parse.quote("左足で蹴る"), language="ja")
    page.wait("return document.querySelectorAll('.word-hit').length > 3")
    assert "kick_left" in page.run("return document.querySelector('.word-hit').textContent")
    page.find("#export-words").click()  # what words found is taken along
    count = "document.querySelectorAll('dialog .ticks input').length"
    page.wait(f"return {count} === document.querySelectorAll('.word-hit:not(.word-part)').length")
    assert page.run(
        "return [...document.querySelectorAll('#export-format option:disabled')].every((one) => one.value === 'fbx')"
    )
    page.run("document.querySelector('dialog').close()")
    page.run("document.querySelector('.word-hit').click()")
    page.wait(DRAWN)
    assert page.run("return document.querySelector('#words-found').hidden")
    page.find("#words-text").send_keys("xqzzv\n")
    page.wait("return document.querySelectorAll('#words-found .note').length > 1")
    assert "xqzzv" in page.run("return document.querySelector('#words-found').textContent")
    page.driver.back()
    page.wait("return document.querySelector('#words-found').hidden")


def test_the_address_names_its_motion_safely(show, running):
    page = show("/search?" + urllib.parse.urlencode({"motion": "file:0123456789abcdef/<img src=x>.bvh"}))
    page.wait(BACK_AT_START)
    assert page.run("return document.querySelector('main img')") is None
    page.messages()  # the browser tells of the 404 itself


def test_a_clip_that_is_gone_leads_back_to_the_start(show, running):
    page = show("/search?motion=clip:99999")
    page.wait(BACK_AT_START)
    assert "not in the library any more" in page.run("return document.querySelector('#problem').textContent")
    page.messages()  # the browser tells of the 404 itself


def test_files_that_are_no_motions_are_told(show, running, bvh, tmp_path):
    """A text file is said to be none; a damaged one leads back to the start; then a good one is searched for."""
    text, damaged = tmp_path / "notes.txt", tmp_path / "damaged.bvh"
    text.write_text("hello")
    damaged.write_text("\n".join(bvh.read_text().splitlines()[:9]))
    page = show("/search")
    page.find("#query-file").send_keys(str(text))
    page.wait("return document.querySelector('.notice.problem') !== null")
    page.find("#query-file").send_keys(str(damaged))
    page.wait(BACK_AT_START)
    page.find("#query-file").send_keys(str(bvh))
    page.wait(DRAWN)
    assert page.run("return document.querySelector('#problem').hidden")
    page.messages()  # the browser tells of the refused requests itself


def test_a_whole_take_asks_for_a_part(show, running, tmp_path):
    take = add_take(running.app.state.studio.library, tmp_path)
    page = show(f"/search?motion=clip:{take}")
    page.wait("return document.querySelector('#ask-part') !== null")
    page.wait("return document.querySelector('.dousa-player canvas') !== null")
    page.wait("return document.querySelector('.tl-cursor') !== null")
    page.run("document.querySelector('.tl-cursor').focus()")
    page.press("\ue011", "[", *["\ue00f"] * 2, "]")  # home, page down
    page.wait("return location.search.includes('end_s=')")
    page.wait(DRAWN)
    page.driver.back()
    page.wait("return document.querySelector('#ask-part') !== null")


def test_words_lead_to_the_part_of_a_take(show, running, tmp_path, faults):
    """A card of a take says when; a click plays that part, chosen on the timeline; going back shows words and list."""
    take = add_take(running.app.state.studio.library, tmp_path)
    page = show("/search?text=crouching")
    hit = "[...document.querySelectorAll('.word-hit')].find((one) => one.textContent.includes('take.bvh'))"
    page.wait(f"return {hit}")
    times = re.search(r"(\d+):(\d+\.\d) – (\d+):(\d+\.\d)", page.run(f"return {hit}.textContent"))
    start, end = (60 * int(times[at]) + float(times[at + 1]) for at in (1, 3))
    assert 0 < start < end
    assert faults(page) == []
    page.screenshot(tmp_path / "words.png")
    n_hits = page.run("return document.querySelectorAll('.word-hit').length")
    page.run(f"{hit}.click()")
    page.wait("return document.querySelector('.tl-cursor') && document.querySelector('.dousa-player canvas')")
    asked = urllib.parse.parse_qs(urllib.parse.urlsplit(page.run("return location.href")).query)
    assert asked["motion"] == [f"clip:{take}"] and asked["from"] == ["crouching"]
    assert [float(asked[name][0]) for name in ("start_s", "end_s")] == pytest.approx([start, end], abs=0.06)
    now = "Number(document.querySelector('.tl-cursor').getAttribute('aria-valuenow'))"
    page.wait(f"return {now} >= arguments[0] && {now} <= arguments[1]", start - 0.1, end + 0.1)
    assert page.run("return document.querySelector('#ask-part')") is None
    assert page.run("return document.querySelector('.tl-part:not([hidden])') !== null")
    page.screenshot(tmp_path / "part.png")
    assert faults(page) == []
    for back in (page.driver.back, lambda: page.run("document.querySelector('#back-to-words').click()")):
        back()
        page.wait("return document.querySelectorAll('.word-hit').length === arguments[0]", n_hits)
        page.wait("return document.activeElement.textContent.includes('take.bvh')")
        assert page.run("return document.querySelector('#words-text').value") == "crouching"
        assert page.run("return document.querySelector('#search').hidden")
        page.run("document.activeElement.click()")
        page.wait("return document.querySelector('#back-to-words') !== null")
