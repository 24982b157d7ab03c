"""The timeline that pages share: cursor, part, cuts, zoom; by mouse and by keyboard."""

import pytest

LEFT, RIGHT, HOME, END, DELETE, ESCAPE = "\ue012", "\ue014", "\ue011", "\ue010", "\ue017", "\ue00c"
SHIFT = "\ue008"

MAKE = """
    const done = arguments[1];
    const module = document.querySelector('script[type=module][src*="/core/"]').src.replace('frame.js', 'timeline.js');
    import(module).then(({Timeline}) => {
      document.querySelector('#main').innerHTML = '<div id="here" style="width: 800px"></div>';
      window.heard = {seek: [], select: [], cuts: []};
      window.timeline = new Timeline(document.querySelector('#here'), {
        ...arguments[0],
        onSeek: (seconds) => heard.seek.push(seconds),
        onSelect: (part, last) => last && heard.select.push(part),
        onCuts: (cuts, last) => last && heard.cuts.push(cuts),
      });
      done(true);
    });
"""
SEGMENTS = [
    {"start": 0, "end": 4, "label": "walk", "kind": "known", "confidence": 0.93},
    {"start": 4, "end": 6, "label": None, "kind": "unknown", "confidence": 0.8},
    {"start": 6, "end": 10, "label": "<b>kick</b>", "kind": "corrected", "confidence": 1},
]


@pytest.fixture
def timeline(show):
    """``timeline(options)``: a page that shows one of ten seconds."""

    def make(**options):
        page = show("/search")
        page.wait("return document.querySelector('#query-file') !== null")
        page.driver.execute_async_script(MAKE, {"duration": 10, "segments": SEGMENTS, **options})
        page.settle()
        return page

    return make


def drag(page, start, end, selector=".tl-track", kind="mouse"):
    """Press at one second, move and let go at another."""
    page.run(
        """
        const [start, end, selector, kind] = arguments;
        const box = document.querySelector('.tl-inner').getBoundingClientRect();
        const target = document.querySelector(selector);
        const at = (seconds) => ({clientX: box.left + seconds / timeline.duration * box.width, clientY: box.top + 50,
          bubbles: true, cancelable: true, pointerId: 1, pointerType: kind, button: 0});
        target.dispatchEvent(new PointerEvent('pointerdown', at(start)));
        for (const share of [0.3, 0.6, 1]) {
          window.dispatchEvent(new PointerEvent('pointermove', at(start + share * (end - start))));
        }
        window.dispatchEvent(new PointerEvent('pointerup', at(end)));
        """,
        start,
        end,
        selector,
        kind,
    )
    page.settle()


def test_labels_are_text_and_say_what_they_are(timeline):
    page = timeline()
    titles = page.run("return [...document.querySelectorAll('.tl-segment')].map((one) => one.title)")
    assert titles[0] == "walk, 93 %, 0.0 s to 4.0 s"
    assert titles[1] == "unknown, 4.0 s to 6.0 s"
    assert "corrected by hand" in titles[2]
    assert page.run("return document.querySelector('.tl-segment b b, .tl-segment span b')") is None
    page.run("timeline.setCursor(2)")
    said = page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuetext')")
    assert said == "2.0 s, walk, 93 %, 0.0 s to 4.0 s"


def test_a_click_seeks_and_dragging_chooses(timeline):
    page = timeline(selectable=True)
    drag(page, 3, 3)
    assert page.run("return heard.seek.at(-1)") == pytest.approx(3, abs=0.05)
    assert page.run("return heard.select.length") == 0
    drag(page, 7, 2)
    part = page.run("return heard.select.at(-1)")
    assert (part["start"], part["end"]) == (pytest.approx(2, abs=0.05), pytest.approx(7, abs=0.05))
    drag(page, 2, 4, ".tl-end-start", "touch")
    assert page.run("return timeline.selection.start") == pytest.approx(4, abs=0.05)
    page.run("document.querySelector('[data-act=timeline_clear]').click()")
    assert page.run("return timeline.selection") is None


def test_dragging_seeks_where_nothing_can_be_chosen(timeline):
    page = timeline()
    drag(page, 2, 8)
    assert page.run("return heard.select.length") == 0
    assert page.run("return timeline.cursor") == pytest.approx(8, abs=0.05)


def test_the_keyboard_does_it_all(timeline):
    page = timeline(selectable=True)
    page.run("document.querySelector('.tl-cursor').focus()")
    page.press(HOME, *[RIGHT] * 5)
    assert page.run("return timeline.cursor") == pytest.approx(0.5)
    page.press(*[RIGHT] * 10, held=SHIFT)
    part = page.run("return timeline.selection")
    assert (part["start"], part["end"]) == (pytest.approx(0.5), pytest.approx(1.5))
    page.press(*[LEFT] * 3, held=SHIFT)
    assert page.run("return timeline.selection.end") == pytest.approx(1.2)
    page.press(ESCAPE)
    assert page.run("return timeline.selection") is None
    page.press("[")
    assert page.run("return timeline.selection.start") == pytest.approx(1.2)
    page.press(END, "]")
    assert page.run("return timeline.selection.end") == pytest.approx(10)
    page.run("document.querySelector('.tl-end-start').focus()")
    page.press(RIGHT)
    assert page.run("return timeline.selection.start") == pytest.approx(1.3)


def test_cuts_are_moved_added_and_taken_away(timeline):
    page = timeline(editable=True, cuts=[3, 6])
    drag(page, 3, 4.5, ".tl-cut")
    assert page.run("return heard.cuts.at(-1)")[0] == pytest.approx(4.5, abs=0.05)
    drag(page, 4.5, 9, ".tl-cut")  # not beyond the next
    assert page.run("return heard.cuts.at(-1)")[0] == pytest.approx(5.9, abs=0.01)
    page.run("timeline.setCursor(1)")
    page.run("document.querySelector('.tl-cursor').focus()")
    page.press("c")
    assert page.run("return heard.cuts.at(-1)") == [pytest.approx(1), pytest.approx(5.9), 6]
    page.press("c")
    assert page.run("return timeline.cuts.length") == 3
    page.run("document.querySelectorAll('.tl-cut')[1].focus()")
    page.press(DELETE)
    assert page.run("return heard.cuts.at(-1)") == [pytest.approx(1), 6]
    page.press(LEFT)
    assert page.run("return heard.cuts.at(-1)") == [pytest.approx(1), pytest.approx(5.9)]
    names = page.run("return [...document.querySelectorAll('.tl-cut')].map((one) => one.getAttribute('aria-label'))")
    assert names == ["Cut 1", "Cut 2"]


def test_a_long_take_is_zoomed_and_overlooked(timeline):
    segments = [
        {"start": 3 * k, "end": 3 * k + 3, "label": f"kind {k % 30}", "kind": "known", "confidence": 0.9}
        for k in range(200)
    ]
    page = timeline(duration=600, segments=segments)
    page.run("timeline.show(300, 330)")
    page.settle()
    width, whole, left = page.run("""
        const scroll = document.querySelector('.tl-scroll');
        return [scroll.clientWidth, scroll.scrollWidth, scroll.scrollLeft];
    """)
    assert whole == pytest.approx(20 * width, rel=0.05)
    assert left == pytest.approx(whole / 2, rel=0.05)
    assert not page.run("return document.querySelector('.tl-overview').hidden")
    page.run("timeline.setCursor(500)")
    page.settle()
    assert page.run("return document.querySelector('.tl-scroll').scrollLeft") > left
    page.run("document.querySelector('[data-act=timeline_fit]').click()")
    page.wait("return document.querySelector('.tl-overview').hidden")
    letters = page.run("return new Set([...document.querySelectorAll('.tl-segment b')].map((b) => b.textContent)).size")
    assert letters == 30


def test_what_is_doubtful_says_so_and_looks_another_way_without_colour(timeline):
    page = timeline(
        segments=[
            {"start": 0, "end": 4, "label": "kick", "kind": "known", "confidence": 0.93},
            {"start": 4, "end": 10, "label": "kick", "kind": "perhaps", "confidence": 0.31},
        ]
    )
    shown = page.run(
        "return [...document.querySelectorAll('.tl-segment')].map((one) => { const style = getComputedStyle(one);"
        " return [one.textContent, style.borderTopStyle, style.backgroundImage === 'none', style.fontStyle]; })"
    )
    assert shown == [["Akick", "solid", True, "normal"], ["A?perhaps kick", "dashed", False, "italic"]]
    assert "perhaps kick, 31 %" in page.run("return document.querySelector('.tl-perhaps').title")


def test_labels_at_one_time_lie_one_below_the_other(timeline):
    rows = (0, 4, "walk"), (4, 8, "sit"), (4, 8, "talk"), (5, 6, "nod"), (8.002, 10, "stand")
    segments = [{"start": s, "end": e, "label": label, "kind": "known", "confidence": None} for s, e, label in rows]
    page = timeline(segments=segments, selectable=True)
    walk, sit, talk, nod, stand = page.run(
        "return [...document.querySelectorAll('.tl-segment')].map((one) => { const box = one.getBoundingClientRect();"
        " return [box.top, box.bottom]; })"
    )
    assert walk == stand and walk[1] - walk[0] > 60
    assert sit[0] == walk[0] and nod[1] == walk[1]
    for above, below in ((sit, talk), (talk, nod)):
        assert above[1] <= below[0] + 0.5 and below[1] - below[0] >= 25
    page.run("timeline.setCursor(5.5)")
    said = page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuetext')")
    assert [name for name in ("sit", "talk", "nod", "walk") if f"{name}, " in said] == ["sit", "talk", "nod"]
    for number, span in ((2, [4, 8]), (3, [5, 6])):
        page.run(
            "const one = document.querySelectorAll('.tl-segment')[arguments[0]], box = one.getBoundingClientRect();"
            "one.dispatchEvent(new MouseEvent('dblclick', {bubbles: true, clientX: box.left + box.width / 2,"
            " clientY: box.top + 5}))",
            number,
        )
        assert page.run("return [timeline.selection.start, timeline.selection.end]") == span
    page.run("timeline.setSegments([{start: 0, end: 4, label: 'walk', kind: 'known'}])")
    assert page.run("return document.querySelector('.tl-inner').offsetHeight") == 76
