"""Miniatures in a real browser: they move only where they are seen, in step where they share a clock."""

import pytest

from app.player_pages import picture, write_miniatures_page
from dousa.app.player.data import encode_motion, format_player_data
from dousa.app.player.figures import encode_miniature
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="module")
def motions():
    names = ("wave_right", "kick_left", "squat", "walk")
    return [canonicalise(make_motion(name, draw_performer(3))) for name in names]


@pytest.fixture(scope="module")
def file(tmp_path_factory, motions):
    path = tmp_path_factory.mktemp("pages") / "miniatures.html"
    return write_miniatures_page([encode_miniature(motion) for motion in motions], path)


def set_reduced(page, value):
    features = [{"name": "prefers-reduced-motion", "value": value}]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})


@pytest.fixture
def page(browser, file):
    browser.open(file, 600, 700)
    yield browser
    set_reduced(browser, "no-preference")
    assert browser.messages() == []


@pytest.fixture
def calm(page):
    """The same page where less motion is wished for."""
    set_reduced(page, "reduce")
    page.settle()
    return page


def alive(page):
    page.settle()
    return page.run("return dousa.miniatures.alive")


def ink(page, index=0):
    return page.run(
        """const data = pixels(arguments[0]);
        let sum = 0;
        for (let k = 3; k < data.length; k += 4) sum += data[k] > 200;
        return (4 * sum) / data.length;""",
        index,
    )


def test_a_miniature_runs_and_only_while_it_is_visible(page):
    page.run("window.minis = [...Array(8)].map((_, k) => add(loops[k % 4]))")
    page.wait("return dousa.miniatures.alive > 0")
    assert page.run("return dousa.miniatures.count") == 8
    assert 2 <= alive(page) <= 3  # of 300 px each in a window of 700
    assert page.run("return minis.map((mini) => mini.visible).indexOf(false)") == alive(page)
    first = picture(page, 0)
    page.wait("return minis[0].share > 0.3")
    assert picture(page, 0) != first
    assert 0.05 < ink(page) < 0.5
    assert page.run("return minis[7].share") == 0
    page.run("document.querySelectorAll('canvas')[7].scrollIntoView()")
    page.wait("return minis[7].share > 0 && !minis[0].visible")
    rest = page.run("return minis[0].share")
    page.settle()
    assert page.run("return minis[0].share") == rest


def test_what_is_out_of_sight_or_destroyed_costs_nothing(page):
    page.run("window.minis = [add(loops[0]), add(loops[1])]")
    page.wait("return dousa.miniatures.alive === 2")
    page.run("document.querySelectorAll('canvas')[1].parentElement.remove()")
    page.wait("return dousa.miniatures.alive === 1")
    page.run("for (const mini of [...minis, ...minis]) mini.destroy()")
    assert alive(page) == 0
    assert page.run("return dousa.miniatures.count") == 0
    drawn = page.run("return dousa.miniatures.drawn")
    page.settle()
    assert page.run("return dousa.miniatures.drawn") == drawn


def test_play_pause_and_seek(page):
    page.run("window.mini = add(loops[0]); mini.pause()")
    page.wait("return mini.visible")
    assert alive(page) == 0
    page.run("mini.seek(0.5)")
    half = picture(page)
    page.run("mini.seek(0)")
    assert picture(page) != half
    page.run("mini.seek(7); mini.seek(NaN)")
    assert page.run("return mini.share") == 1
    page.run("mini.seek(0.5)")
    assert picture(page) == half
    page.run("mini.play()")
    page.wait("return mini.playing && mini.share !== 0.5")


def test_other_bytes_in_the_same_canvas(page, motions):
    page.run("window.mini = add(loops[0]); mini.pause(); mini.seek(0.5)")
    page.wait("return mini.visible")
    before = picture(page)
    page.run("mini.replace(loops[1].slice().buffer)")  # an ArrayBuffer will do
    assert picture(page) != before
    assert page.run("return mini.duration") == pytest.approx((motions[1].n_frames - 1) / 30)
    says = page.run("try { mini.replace(new Uint8Array(9)); } catch (error) { return error.message; }")
    assert "expected 1456 bytes, got 9" in says


def test_less_motion_shows_the_most_telling_pose_until_somebody_looks(calm):
    calm.run("window.mini = add(loops[0])")
    calm.wait("return mini.visible")
    assert alive(calm) == 0
    still = calm.run("return new DataView(loops[0].buffer).getFloat32(12, true)")
    assert calm.run("return mini.share") == pytest.approx(still)
    shown = picture(calm)
    calm.run("document.querySelector('button').focus()")
    calm.wait("return dousa.miniatures.alive === 1 && Math.abs(mini.share - arguments[0]) > 0.1", still)
    calm.run("document.querySelector('button').blur()")
    assert alive(calm) == 0
    assert picture(calm) == shown
    host = "document.querySelector('button').dispatchEvent(new PointerEvent('pointerenter'))"
    calm.run(host)
    assert alive(calm) == 1
    calm.run(host.replace("enter", "leave"))
    assert alive(calm) == 0


def test_a_clock_keeps_several_in_step(page):
    page.run(
        """window.clock = dousa.createClock({duration: 1});
        window.minis = [add(loops[0], {clock}), add(loops[1], {clock, tone: "reference"})];
        window.heard = [];
        window.deaf = clock.onChange((share) => heard.push(share));"""
    )
    page.wait("return minis[1].visible")
    assert alive(page) == 0
    page.run("clock.seek(0.25)")
    assert page.run("return [clock.share, ...minis.map((mini) => mini.share)]") == [0.25] * 3
    page.run("minis[1].seek(0.75)")
    assert page.run("return [clock.share, ...minis.map((mini) => mini.share), ...heard]") == [0.75] * 3 + [0.25, 0.75]
    page.run("clock.play()")
    assert alive(page) == 2
    page.wait("return heard.filter((share, k) => share < heard[k - 1]).length >= 1")  # begins anew
    page.run("clock.pause(); deaf()")
    shares = page.run("return [clock.share, ...minis.map((mini) => mini.share)]")
    assert len(set(shares)) == 1
    assert alive(page) == 0


def test_a_clock_follows_a_player(page, motions):
    page.run(
        """window.clock = dousa.createClock();
        window.mini = add(loops[0], {clock});
        const box = document.createElement("div");
        document.body.append(box);
        window.player = dousa.createPlayer(box, JSON.parse(arguments[0]));
        player.seek(player.duration / 2);
        window.leave = clock.follow(player);""",
        format_player_data(encode_motion(motions[0])),
    )
    assert page.run("return [clock.share, mini.share]") == [0.5, 0.5]
    assert page.run("return clock.duration === player.duration")
    page.run("clock.seek(0.25)")
    assert page.run("return player.time / player.duration") == pytest.approx(0.25)
    page.run("clock.play()")
    assert page.run("return [player.playing, clock.playing, mini.playing]") == [True, True, True]
    page.wait("return mini.share > 0.3")
    page.run("clock.pause()")
    assert page.run("return player.playing") is False
    page.run("leave(); leave(); player.seek(0)")
    assert page.run("return clock.share > 0.3")


@pytest.mark.parametrize("at", [0, 4, 8, 12])
def test_damaged_bytes_are_refused_in_words(page, at):
    says = page.run(
        """const bad = loops[0].slice();
        new DataView(bad.buffer).setFloat32(arguments[0], NaN, true);
        try { add(bad); } catch (error) { return error.message; }""",
        at,
    )
    assert "damaged header" in says
