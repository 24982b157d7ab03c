"""The player in a real browser without an assessment: one figure, two in step, other data in place, themes."""

import dataclasses

import numpy as np
import pytest

from app.player_pages import picture, write_player_page
from dousa.app.player.data import encode_motion, encode_pair, format_player_data
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion


@dataclasses.dataclass(frozen=True)
class Part:
    positions: np.ndarray
    frame_rate: float = 30.0


@pytest.fixture(scope="module")
def motions():
    names = ("wave_right", "kick_left")
    return {name: canonicalise(make_motion(name, draw_performer(3))) for name in names}


@pytest.fixture(scope="module")
def pages(tmp_path_factory, motions):
    folder = tmp_path_factory.mktemp("pages")
    wave, kick = motions.values()
    pair = encode_pair(wave, kick, names=("clip 1", "clip 2"), labels=("query", "match"))
    return {
        "one": write_player_page(encode_motion(wave, "a wave <b>"), folder / "one.html"),
        "ja": write_player_page(encode_motion(wave, "手を振る", language="ja"), folder / "ja.html"),
        "pair": write_player_page(pair, folder / "pair.html"),
    }


@pytest.fixture
def one(browser, pages):
    """The page with one figure; at the end its console must be empty."""
    browser.open(pages["one"])
    browser.settle()
    yield browser
    assert browser.messages() == []


@pytest.fixture
def pair(browser, pages):
    browser.open(pages["pair"])
    browser.settle()
    yield browser
    assert browser.messages() == []


def visible_buttons(page):
    return page.run(
        """return [...document.querySelectorAll(".dousa-player button")]
            .filter((button) => button.checkVisibility()).map((button) => button.ariaLabel);"""
    )


def load(page, name, data):
    """Give the page other data as a page gets them: parsed from text."""
    page.run(f"window.{name} = JSON.parse(arguments[0])", format_player_data(data))


# --- one figure


def test_one_figure_has_only_the_buttons_that_it_needs(one):
    buttons = visible_buttons(one)
    assert {"Play", "One frame back", "Loop", "Mirror", "In place", "Front"} <= set(buttons)
    assert not {"Side by side", "In step", "Previous event", "Next event"} & set(buttons)
    assert one.find(".dp-names").text.split("\n")[0] == "a wave <b>"
    assert one.run("return document.querySelector('.dp-says').checkVisibility()") is False
    assert "Player of the motion" in one.find(".dousa-player").get_attribute("aria-label")
    assert "event" not in one.run("return document.querySelector('.dp-keys').textContent")


def test_one_figure_plays_and_every_key_does_no_harm(one):
    still = picture(one)
    one.run("document.querySelector('.dousa-player').focus()")
    one.press("o", "s", "n", "p")
    assert picture(one) == still
    one.run("player.play()")
    one.wait("return player.time > 0.3")
    one.run("player.pause()")
    assert picture(one) != still


def test_the_loop_is_the_whole_motion_and_grows_with_it(one, motions):
    one.run("document.querySelector('.dousa-player').focus()")
    one.press("l")
    assert one.run("return player.looped") == pytest.approx([0, one.run("return player.duration")])
    longer = Part(np.concatenate([motions["wave_right"].positions] * 2))
    load(one, "longer", encode_motion(longer))
    one.run("player.replace(longer)")
    assert one.run("return player.looped[1] === player.duration")
    one.press("l")
    assert one.run("return player.looped") is None


def test_the_bare_page_may_keep_its_keys(one):
    one.run(
        """player.destroy();
        window.player = dousa.createPlayer(document.getElementById("here"), data, {pageKeys: false});
        document.activeElement.blur();"""
    )
    one.press("m")
    assert one.run("return player.view.mirror") is False
    one.run("player.element.focus()")
    one.press("m")
    assert one.run("return player.view.mirror") is True


# --- two in step


def test_a_pair_has_words_and_names_over_its_figures_and_no_events(pair):
    names = [pair.find(f".dp-name-{who}").text for who in ("reference", "performance")]
    assert names[0].startswith("query") and "clip 1" in names[0]
    assert names[1].startswith("match") and "clip 2" in names[1]
    assert {"Side by side", "Over each other", "In step", "Same time"} <= set(visible_buttons(pair))
    assert "Next event" not in visible_buttons(pair)
    seen = {picture(pair)}
    for view in ("{mode: 'over'}", "{sync: 'time'}"):
        pair.run(f"player.seek(1.5); player.setView({view})")
        assert picture(pair) not in seen
        seen.add(picture(pair))


def test_in_step_the_reference_arrives_with_the_performance(pair, motions):
    pair.run("player.seek(1e9)")
    pair.settle()
    end = (motions["wave_right"].n_frames - 1) / 30
    assert pair.find(".dp-name-reference .dp-when").text == f"0:{end:04.1f}"


# --- other data


def test_replaced_data_keep_view_time_speed_and_motion(one, motions):
    load(one, "other", encode_motion(motions["kick_left"], "a kick"))
    one.run("player.setView({mirror: true, inPlace: false}); player.setSpeed(0.5); player.seek(0.7)")
    shown = picture(one)
    one.run("window.canvas = document.querySelector('canvas'); player.replace(other)")
    assert picture(one) != shown
    assert one.run("return [player.time, player.speed, player.playing]") == [0.7, 0.5, False]
    assert one.run("return [player.view.mirror, player.view.inPlace]") == [True, False]
    assert one.run("return canvas.isConnected")  # the same one: nothing flickers
    assert one.find(".dp-names").text.startswith("a kick")
    one.run("player.play(); player.replace(data)")
    assert one.run("return player.playing") is True
    one.run("player.pause(); player.seek(1e9)")
    load(one, "short", encode_motion(Part(motions["kick_left"].positions[:10])))
    one.run("player.replace(short)")
    assert one.run("return player.time") == pytest.approx(9 / 30)


def test_a_growing_recording_follows_its_end_in_the_same_room(one, motions):
    grown = Part(np.concatenate([motions["wave_right"].positions] * 3))
    first = encode_motion(Part(grown.positions[:30]))
    load(one, "first", first)
    load(one, "more", encode_motion(Part(grown.positions[:60]), like=first))
    one.run("player.replace(first); player.seek(1e9); player.replace(more, {live: true})")
    assert one.run("return player.time") == pytest.approx(59 / 30)
    one.run("player.seek(0.5); player.replace(more, {live: true})")
    shown = picture(one)
    one.run("player.replace(more, {live: true})")
    assert picture(one) == shown
    assert one.run("return player.time") == 0.5


def test_one_figure_becomes_two_and_one_again(one, motions):
    load(one, "both", encode_pair(*motions.values()))
    one.run("player.element.focus(); player.setView({mirror: true}); player.seek(0.4); player.replace(both)")
    one.settle()
    assert "In step" in visible_buttons(one)
    assert one.run("return [player.time, player.view.mirror, document.querySelectorAll('canvas').length]") == [
        0.4,
        True,
        1,
    ]
    assert one.run("return document.activeElement === player.element")
    two = picture(one)
    one.run("player.replace(data)")
    assert picture(one) != two
    assert "In step" not in visible_buttons(one)
    one.run("player.destroy(); player.replace(both)")
