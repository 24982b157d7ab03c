"""The 3D player: what its data hold, and what it does in a real browser."""

import dataclasses
import json
import re

import numpy as np
import pytest

from app.fake_assessment import HOSTILE_WORDS, make_assessment
from app.player_pages import decode, heading_of, picture, positions_of, write_player_page
from dousa.app.player.data import (
    SCRIPT_PARTS,
    encode_player_data,
    format_player_data,
    read_player_script,
    read_player_style,
)
from dousa.errors import OptionError
from dousa.messages import load_section
from dousa.motion import JOINT_INDEX as J

_HIPS = [J["left_hip"], J["right_hip"]]
_FEET = [J[f"{side}_{end}"] for side in ("left", "right") for end in ("ankle", "toe")]


@pytest.fixture(scope="module")
def assessment():
    return make_assessment()


# --- data


def test_figures_stand_on_the_floor_about_their_hips_and_look_the_same_way(assessment):
    data = encode_player_data(assessment)
    headings = []
    for name in ("reference", "performance"):
        positions = positions_of(data[name])
        assert positions.shape == (600, 20, 3)
        assert np.abs(positions[:, _HIPS][..., [0, 2]].mean(axis=1)).max() < 0.002
        assert abs(np.percentile(positions[:, _FEET, 1].min(axis=1), 0.5)) < 0.003
        headings.append(heading_of(positions))
    assert abs(headings[1]) < 0.02  # rad: the performance looks at the viewer on average
    assert abs(headings[0] - headings[1]) < 0.1
    assert data["performance"]["stature"] == pytest.approx(0.92 * data["reference"]["stature"], rel=0.01)


def test_bones_keep_their_length_and_the_way_is_there(assessment):
    figure = encode_player_data(assessment)["performance"]
    positions = positions_of(figure)
    path = decode(figure["path"], "<i4").reshape(-1, 2) / 1000
    world = assessment.performance.positions
    for start, end in (("left_knee", "left_ankle"), ("neck", "head")):
        stored = np.linalg.norm(positions[:, J[end]] - positions[:, J[start]], axis=1)
        true = np.linalg.norm(world[:, J[end]] - world[:, J[start]], axis=1)
        assert np.abs(stored - true).max() < 0.003
    way = world[:, _HIPS][..., [0, 2]].mean(axis=1)
    gone = np.linalg.norm(way - way[0], axis=1)
    assert np.allclose(np.linalg.norm(path - path[0], axis=1), gone, atol=0.003)
    assert np.all(path[0] == 0)


def test_matched_times_are_those_of_the_assessment(assessment):
    data = encode_player_data(assessment)
    step, same = decode(data["step"], "<i4"), decode(data["time"], "<i4")
    valid = np.isfinite(assessment.matched_time)
    assert np.allclose(step[valid], 1000 * assessment.matched_time[valid], atol=0.51)
    assert np.all(step[~valid] < 0)
    last = np.flatnonzero(valid)[-1]
    assert -1 - step[-1] == step[last]  # the nearest moment that there is
    assert np.allclose(same, 1000 * assessment.same_time, atol=0.51)


def test_a_performance_without_any_counterpart_still_has_figures(assessment):
    nothing = np.full(600, np.nan)
    lost = dataclasses.replace(assessment, matched_time=nothing, same_time=nothing, events=(), furi=())
    data = encode_player_data(lost)
    step = decode(data["step"], "<i4")
    assert np.all(step < 0)
    assert -1 - step[0] == 0
    assert -1 - step[-1] == pytest.approx(1000 * 599 / 30, abs=1)
    assert abs(heading_of(positions_of(data["reference"]))) < 0.02


def test_one_frame_is_enough(assessment):
    def first(sequence):
        fields = {name: getattr(sequence, name)[:1] for name in ("segments", "seen", "positions")}
        return dataclasses.replace(sequence, **fields)

    short = dataclasses.replace(
        assessment,
        reference=first(assessment.reference),
        performance=first(assessment.performance),
        matched_time=np.zeros(1),
        same_time=np.zeros(1),
    )
    data = encode_player_data(short)
    assert data["performance"]["n_frames"] == data["reference"]["n_frames"] == 1
    assert decode(data["step"], "<i4").tolist() == [0]


@pytest.mark.slow
def test_five_minutes_fit_a_page():
    data = encode_player_data(make_assessment(300, frame_rate=120.0))
    assert 15 <= data["rate"] <= 30
    stored = sum(len(data[name][part]) for name in ("reference", "performance") for part in ("positions", "path"))
    assert stored + len(data["step"]) + len(data["time"]) <= 2.5e6
    n_frames = data["performance"]["n_frames"]
    assert (n_frames - 1) / data["rate"] == pytest.approx(299.99, abs=0.1)
    assert len(decode(data["step"], "<i4")) == n_frames


def test_a_lower_rate_thins_the_frames_and_keeps_their_times():
    fast = make_assessment(6, frame_rate=120.0)
    data = encode_player_data(fast, max_rate=25.0)
    assert data["rate"] == 25.0
    path = decode(data["performance"]["path"], "<i4").reshape(-1, 2) / 1000
    way = fast.performance.positions[:, _HIPS][..., [0, 2]].mean(axis=1)
    times = np.arange(len(path)) / 25.0
    there = np.stack([np.interp(times, fast.times, way[:, k]) for k in (0, 1)], axis=1)
    assert np.allclose(np.linalg.norm(path, axis=1), np.linalg.norm(there - way[0], axis=1), atol=0.003)


@pytest.mark.parametrize(("options", "says"), [({"language": "xx"}, "en"), ({"max_rate": 0.0}, "above 0")])
def test_wrong_options_are_named(assessment, options, says):
    with pytest.raises(OptionError, match=says):
        encode_player_data(assessment, **options)


def test_both_languages_have_all_words():
    known = load_section("player", "en").keys()
    assert known == load_section("player", "ja").keys()
    source = read_player_script()
    used = set(re.findall(r"words\.(\w+)", source)) | set(re.findall(r'"(key[A-Z]\w+)"', source))
    assert used <= known
    assert [name for name in known if not re.search(rf"\b{name}\b", source)] == []


def test_script_and_style_ask_nothing_of_any_network_and_make_no_markup():
    source = read_player_script() + read_player_style()
    for forbidden in ("eval(", "new Function", "innerHTML", "outerHTML", "insertAdjacentHTML", "document.write"):
        assert forbidden not in source
    assert set(re.findall(r"https?://[^\"'\s]+", source)) == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert "</script" not in source
    assert "@import" not in source
    assert "url(" not in source
    assert len(SCRIPT_PARTS) == len(set(SCRIPT_PARTS))


def test_data_may_stand_inside_a_page():
    text = format_player_data(encode_player_data(make_assessment(words=HOSTILE_WORDS)))
    assert "<" not in text
    assert "\u2028" not in text
    assert json.loads(text)["events"][0]["says"] == HOSTILE_WORDS


# --- in the browser


def write_page(assessment, path, language="en"):
    return write_player_page(encode_player_data(assessment, language), path)


@pytest.fixture(scope="module")
def pages(tmp_path_factory, assessment):
    folder = tmp_path_factory.mktemp("pages")
    return {
        "en": write_page(assessment, folder / "en.html"),
        "ja": write_page(make_assessment(), folder / "ja.html", "ja"),
        "hostile": write_page(make_assessment(words=HOSTILE_WORDS), folder / "hostile.html"),
        "many": write_page(make_assessment(60, events_per_kind=12), folder / "many.html"),
    }


@pytest.fixture
def page(browser, pages):
    """The English page; at the end its console must be empty."""
    browser.open(pages["en"])
    browser.run("document.querySelector('.dousa-player').focus()")
    browser.settle()
    yield browser
    assert browser.messages() == []


def time_of(page):
    return page.run("return player.time")


def click(page, label):
    page.run('document.querySelector(`[aria-label="${arguments[0]}"]`).click()', label)
    page.settle()


def test_it_plays_and_pauses_and_seeks(page):
    still = picture(page)
    assert picture(page) == still
    page.run("player.play()")
    page.wait("return player.time > 0.3")
    assert picture(page) != still
    page.run("player.pause()")
    rest, shown = time_of(page), picture(page)
    assert page.run("return player.playing") is False
    assert (time_of(page), picture(page)) == (rest, shown)
    page.run("player.seek(7.0)")
    assert picture(page) != shown
    assert page.run("return heard.at(-1)") == 7.0
    page.run("player.seek(1e9)")
    assert time_of(page) == pytest.approx(599 / 30)
    page.run("player.seek(NaN); player.seek(-5)")
    assert time_of(page) == 0


def test_it_stops_at_the_end_and_begins_anew(page):
    page.run("player.seek(19.8); player.play()")
    page.wait("return !player.playing")
    assert time_of(page) == pytest.approx(599 / 30)
    page.run("player.play()")
    page.wait("return player.time > 0 && player.time < 5")


def test_a_mark_of_an_event_seeks_and_shows_its_words(page, assessment):
    for index, event in enumerate(assessment.events):
        page.run("document.querySelectorAll('.dp-event')[arguments[0]].click()", index)
        page.settle()
        assert time_of(page) == pytest.approx(event.worst_s, abs=1e-3)
        assert str(event.says) in page.find(".dp-says").text
    page.run("player.seek(0)")
    page.settle()
    assert "No event" in page.find(".dp-says").text


def test_buttons_change_the_picture(page):
    page.run("player.seek(10.8)")  # late here: in step and same time differ
    seen = {picture(page)}
    for label in ("Over each other", "Same time", "Mirror", "In place"):
        click(page, label)
        now = picture(page)
        assert now not in seen, label
        seen.add(now)
    for label in ("Profile", "Top", "Front"):
        click(page, label)
        turned = picture(page)
        assert turned not in seen, label
        seen.add(turned)
    click(page, "Reset view")
    assert picture(page) == now
    expected = {"mode": "over", "sync": "time", "mirror": True, "inPlace": False}
    assert page.run("return player.view") == expected
    page.run("player.setView({mode: 'nonsense', mirror: 3}); player.setView(null)")
    assert page.run("return player.view") == expected


def test_the_keyboard_does_it_all(page, assessment):
    from selenium.webdriver.common.keys import Keys

    page.press(" ")
    assert page.run("return player.playing") is True
    page.press(" ")
    assert page.run("return player.playing") is False
    page.run("player.seek(3)")
    page.press(Keys.ARROW_RIGHT)
    assert time_of(page) == pytest.approx(3 + 1 / 30)
    page.press(Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    assert time_of(page) == pytest.approx(3 - 1 / 30)
    page.press(Keys.ARROW_RIGHT, held=Keys.SHIFT)
    assert time_of(page) == pytest.approx(4 - 1 / 30)
    page.press("n")
    assert time_of(page) == pytest.approx(assessment.events[1].worst_s, abs=1e-3)
    page.press("p")
    assert time_of(page) == pytest.approx(assessment.events[0].worst_s, abs=1e-3)
    page.press("o", "s", "m", "i")
    assert page.run("return player.view") == {"mode": "over", "sync": "time", "mirror": True, "inPlace": False}
    shown = picture(page)
    page.press("3")
    assert picture(page) != shown
    page.press("l")
    first = assessment.events[0]
    assert page.run("return player.looped") == pytest.approx([first.start_s, first.end_s], abs=1e-3)
    page.press("l")
    assert page.run("return player.looped") is None
    page.press(Keys.END)
    assert time_of(page) == pytest.approx(599 / 30)


def test_speed_changes_how_fast_time_runs(page):
    page.run("player.setSpeed(0.25); player.setSpeed(-1); player.setSpeed(NaN)")
    assert page.run("return player.speed") == 0.25
    page.press("]", "]")
    assert page.run("return player.speed") == 1
    page.press("[")
    page.settle()
    assert page.run("return document.querySelector('[aria-label=\"Speed 0.5×\"]').ariaPressed") == "true"


def test_space_on_a_button_presses_only_that(page):
    page.run("document.querySelector('[aria-label=\"Mirror\"]').focus()")
    page.press(" ")
    assert page.run("return [player.playing, player.view.mirror]") == [False, True]


def test_dragging_turns_and_a_double_click_resets(page):
    from selenium.webdriver import ActionChains

    canvas, before = page.find("canvas"), picture(page)
    ActionChains(page.driver).click_and_hold(canvas).move_by_offset(120, 30).release().perform()
    turned = picture(page)
    assert turned != before
    page.run(
        """document.querySelector("canvas").dispatchEvent(
            new WheelEvent("wheel", {deltaY: -300, cancelable: true, bubbles: true}))"""
    )
    assert picture(page) != turned
    ActionChains(page.driver).double_click(canvas).perform()
    assert picture(page) == before


def test_two_fingers_zoom(page):
    before = picture(page)
    page.run(
        """const canvas = document.querySelector("canvas");
        canvas.setPointerCapture = () => {};
        const touch = (name, pointerId, clientX) => canvas.dispatchEvent(
            new PointerEvent(name, {pointerId, clientX, clientY: 200, pointerType: "touch", bubbles: true}));
        touch("pointerdown", 1, 300); touch("pointerdown", 2, 340); touch("pointermove", 2, 420);
        touch("pointerup", 1, 300); touch("pointerup", 2, 420);"""
    )
    assert picture(page) != before


def test_keys_are_left_to_fields_and_taken_from_the_bare_page(page):
    page.find("#field").click()
    page.press(" ", "m", "l")
    assert page.find("#field").get_attribute("value") == " ml"
    assert page.run("return [player.playing, player.view.mirror, player.looped]") == [False, False, None]
    page.run("document.activeElement.blur()")
    page.press("m")
    assert page.run("return player.view.mirror") is True


def test_the_bar_of_time_is_a_slider(page):
    page.run(
        """const bar = document.querySelector('input[type=range]');
        bar.value = 5; bar.dispatchEvent(new Event('input'));"""
    )
    assert time_of(page) == pytest.approx(5)
    page.settle()
    assert page.run("return document.querySelector('input[type=range]').ariaValueText") == "0:05.0"


def test_a_loop_stays_inside_the_event(page, assessment):
    event = assessment.events[1]
    page.run("player.seek(arguments[0])", event.worst_s)
    page.press("l")
    page.run("heard.length = 0; player.setSpeed(2); player.play()")
    page.wait("return heard.filter((time, k) => k && time < heard[k - 1]).length >= 2")
    page.run("player.pause()")
    heard = page.run("return heard")
    assert min(heard) >= event.start_s - 1e-3
    assert max(heard) <= event.end_s + 1e-3
    page.run("player.loop(5, 4)")
    assert page.run("return player.looped") is None


def test_without_a_counterpart_the_reference_is_said_to_be_absent(page):
    page.run("player.seek(19.9)")
    page.settle()
    assert "no counterpart" in page.find(".dp-name-reference").text
    page.run("player.setView({sync: 'time'})")
    page.settle()
    assert "0:19.9" in page.find(".dp-name-reference").text


def test_every_control_can_be_reached_and_has_a_name(page):
    from selenium.webdriver.common.keys import Keys

    controls = page.run(
        """return [...document.querySelectorAll(".dousa-player button, .dousa-player input, .dousa-player summary")]
            .filter((control) => !control.disabled).length"""
    )
    names = []
    for _ in range(controls):
        page.press(Keys.TAB)
        name, outline = page.run(
            """const here = document.activeElement;
            return [here.ariaLabel ?? here.textContent, getComputedStyle(here).outlineStyle];"""
        )
        names.append(name)
        assert outline == "solid", name
    assert all(names)
    assert len(set(names)) == controls
    assert names[-1] == "Keys"


def test_a_screen_reader_hears_the_time_when_it_rests(page):
    page.run("player.seek(2.2)")
    page.wait(
        "return document.querySelector('[aria-live]').textContent.startsWith('0:02.2, paused, 0:01.4, right arm')"
    )


def test_two_players_on_a_page_and_none_after_destroy(page):
    page.run(
        """const box = document.createElement("div");
        document.body.append(box);
        window.second = dousa.createPlayer(box, data);
        document.activeElement.blur();"""
    )
    page.press("m")
    assert page.run("return [player.view.mirror, second.view.mirror]") == [False, True]
    page.run("second.destroy(); second.destroy(); second.seek(3)")
    page.press("m")
    assert page.run("return [player.view.mirror, document.querySelectorAll('canvas').length]") == [True, 1]
    page.run("player.destroy()")
    page.press(" ", "m")
    assert page.run("return document.querySelectorAll('.dousa-player').length") == 0


def test_words_of_any_kind_stay_words(browser, pages):
    browser.open(pages["hostile"])
    browser.run("document.querySelector('.dp-event').click()")
    browser.settle()
    assert HOSTILE_WORDS in browser.run("return document.querySelector('.dp-says').textContent")
    assert browser.run("return [window.hacked ?? null, document.querySelectorAll('img').length]") == [None, 0]
    assert browser.messages() == []


def test_damaged_data_are_refused_in_words(page):
    says = page.run(
        """const bad = {...data, performance: {...data.performance, n_frames: 7}};
        try { dousa.createPlayer(document.createElement("div"), bad); } catch (error) { return error.message; }"""
    )
    assert "do not fit" in says
