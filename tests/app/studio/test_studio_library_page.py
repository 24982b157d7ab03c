"""The Library page in a real browser: looking, choosing, labelling, removing, adding, training."""

import time
from pathlib import Path

import pytest

from app.studio.library_page import CELLS, click, wait_count
from patience import PATIENCE

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "bandai"
N = 24

DRAWN = f"{CELLS}.filter((cell) => !cell.querySelector('canvas').hidden).length"
CHOSEN = "return [...document.querySelectorAll('.cell[aria-selected=true]')].map((cell) => cell.cell.id)"
DIALOG = "return document.querySelector('dialog[open]')"


@pytest.fixture
def library_page(show):
    """``library_page(path, ...)``: the page when its first figures are drawn."""

    def open_page(path="/library", **look):
        page = show(path, **look)
        page.wait(f"{DRAWN} > 0")
        return page

    return open_page


def no_messages(page):
    """Nothing on the console but the answers to files that are refused, which the browser itself notes down."""
    return [text for text in page.messages() if "/api/uploads" not in text]


# --- looking


@pytest.mark.parametrize(
    "look",
    [{"width": 1280, "height": 720}, {"width": 390, "height": 844}, {"scheme": "dark"}, {"language": "ja"}],
    ids=["desk", "phone", "dark", "japanese"],
)
def test_the_grid_shows_moving_figures(library_page, tmp_path, look):
    page = library_page(**look)
    assert page.wait("return window.dousa.miniatures.alive") > 0
    assert page.run("return document.documentElement.scrollWidth <= innerWidth")
    name = page.run("return document.querySelector('.cell .name').textContent")
    assert name == "performer00_1.bvh"
    heading = page.run("return document.querySelector('h1').textContent")
    assert heading == ("ライブラリー" if look.get("language") == "ja" else "Library")
    assert page.screenshot(tmp_path / "library.png").stat().st_size > 20_000


def test_filters_and_words_narrow_the_list_and_stand_in_the_address(library_page):
    page = library_page()
    click(page, "[data-key='category squat']")
    wait_count(page, 6)
    page.find("#text").send_keys("performer03")
    wait_count(page, 1)
    assert page.run("return [...new URLSearchParams(location.search).getAll('category')]") == ["squat"]
    page.driver.refresh()
    wait_count(page, 1)
    page.find("#text").send_keys("no such thing")
    page.wait("return !document.querySelector('#nothing').hidden")
    click(page, "#clear-filter")
    wait_count(page, N)


def test_the_place_of_the_pointer_over_a_figure_is_a_moment(library_page):
    page = library_page()
    stage = page.find(".cell .stage")
    cell = "document.querySelector('.cell').cell"
    place = -round(0.25 * stage.rect["width"])
    page.point(stage, place)
    page.wait(f"return !{cell}.scrubber.hidden")
    share, playing = page.run(f"return [{cell}.miniature.share, {cell}.miniature.playing]")
    assert share == pytest.approx(0.25, abs=0.02) and not playing
    page.point(page.find("h1"))
    page.wait(f"return {cell}.miniature.playing")
    features = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    page.point(stage, place)
    page.settle()
    assert page.run(f"return {cell}.scrubber.hidden")


def test_a_clip_is_shown_large_and_the_focus_comes_back(library_page):
    page = library_page()
    page.find(".cell").click()
    page.press(KEYS.ENTER)
    page.wait("return document.querySelector('dialog .detail-stage canvas')")
    assert "performer00_1.bvh" in page.run(f"{DIALOG}.textContent")
    click(page, "dialog button[aria-label='The next one']")
    page.wait(f"{DIALOG}.querySelector('h2').textContent === 'performer01_1.bvh'")
    page.press(KEYS.ESCAPE)
    page.wait("return document.activeElement.classList.contains('cell')")
    assert page.run("return document.activeElement.cell.index") == 1


def test_who_comes_back_finds_selection_and_place(library_page):
    page = library_page(width=700, height=500)
    page.find(".cell").click()
    page.press(KEYS.ARROW_RIGHT, held=KEYS.SHIFT)
    page.run("window.scrollTo({top: 600, behavior: 'instant'})")
    page.settle()
    top = page.run("return window.scrollY")
    assert top > 300
    page.run("document.querySelector('#actions a').click()")
    page.wait("return location.pathname === '/evaluate'")
    page.driver.back()
    page.wait("return document.querySelector('.chosen-count')?.textContent.startsWith('2')")
    page.wait("return Math.abs(window.scrollY - arguments[0]) < 3", top)
    links = page.run("return [...document.querySelectorAll('#actions a')].map((a) => a.getAttribute('href'))")
    assert links == ["/evaluate?references=clip:1,clip:2"]


def test_a_filter_leaves_what_is_chosen_and_says_what_it_hides(library_page):
    page = library_page()
    page.find(".cell").click()
    page.press(KEYS.ARROW_RIGHT, held=KEYS.SHIFT)
    said = "return document.querySelector('.chosen-count').textContent"
    click(page, "[data-key='category squat']")
    wait_count(page, 6)
    page.wait(f"{said} === '2 chosen (2 not in this list)'")
    page.run("document.querySelector('.cell .tick').click()")
    page.wait(f"{said} === '3 chosen (2 not in this list)'")
    click(page, "[data-key='category squat']")
    page.wait(f"{said} === '3 chosen'")


# --- choosing


def test_choosing_with_the_keyboard(library_page):
    page = library_page()
    page.run("document.querySelector('.cell[tabindex=\"0\"]').focus()")
    page.press(" ")
    assert page.run(CHOSEN) == [1]
    page.press(KEYS.ARROW_RIGHT, KEYS.ARROW_RIGHT, held=KEYS.SHIFT)
    assert page.run(CHOSEN) == [1, 2, 3]
    page.press(KEYS.ARROW_DOWN, " ")
    assert len(page.run(CHOSEN)) == 4
    page.press(KEYS.END, held=KEYS.CONTROL)
    assert page.run("return document.activeElement.cell.index") == N - 1
    page.press("a", held=KEYS.CONTROL)
    page.wait("return document.querySelector('.chosen-count')?.textContent.startsWith('24')")
    page.press(KEYS.ESCAPE)
    assert page.run("return document.querySelector('#actions').hidden")


# Answers with clips of the list wait until `letGo`; how many do is counted.
HOLD_LISTS = """
    const real = window.fetch;
    window.held = 0;
    const gate = new Promise((done) => { window.letGo = () => { window.fetch = real; done(); }; });
    window.fetch = async (path, ...rest) => {
        if (/\\/api\\/clips\\?.*offset=/.test(path)) { window.held += 1; await gate; }
        return real(path, ...rest);
    };
"""


def test_while_the_list_is_read_again_what_is_shown_can_be_chosen(library_page, running):
    page = library_page()
    page.run(HOLD_LISTS)
    running.app.state.studio.library.remove([1])
    page.run("document.dispatchEvent(new Event('visibilitychange'))")
    page.wait("return window.held > 0")
    assert page.run(f"{DRAWN} > 3")
    page.run("document.querySelectorAll('.cell')[1].click()")
    assert page.run("return document.querySelector('#actions a').getAttribute('href')") == "/search?motion=clip:2"
    page.run("window.letGo()")
    wait_count(page, N - 1)
    page.settle()
    assert page.run(CHOSEN) == [2]
    # The same while another filter is asked for.
    page.run(HOLD_LISTS)
    page.run("document.querySelector(\"[data-key='category squat']\").click()")
    page.wait("return window.held > 0")
    page.run("document.querySelectorAll('.cell')[2].click()")
    page.settle()
    chosen = page.run(CHOSEN)
    assert len(chosen) == 1 and chosen != [2]
    page.run("window.letGo()")
    wait_count(page, 6)
    page.wait("return document.querySelector('.chosen-count')?.textContent === '1 chosen (1 not in this list)'")


def test_relabelling_by_keyboard(library_page, running):
    page = library_page()
    page.find(".cell").click()
    page.press(KEYS.ARROW_RIGHT, held=KEYS.SHIFT)
    click(page, "[data-word=relabel]")
    page.find("#relabel-category").send_keys("<b>hop</b>", KEYS.ENTER)
    page.wait("return document.querySelector('.cell .badge').textContent === '<b>hop</b>'")
    assert page.run("return document.querySelector('.cell .badge b')") is None
    page.wait("return document.querySelector('#forest-state').textContent.includes('changed')")
    clips = running.app.state.studio.library.clips([1, 2, 3])
    assert [clip.category for clip in clips] == ["<b>hop</b>", "<b>hop</b>", "kick_left"]


def test_taking_a_label_away_shows_what_the_forest_thinks(library_page):
    page = library_page()
    page.find(".cell").click()
    click(page, "[data-word=relabel]")
    click(page, "#relabel-no-category")
    click(page, "#relabel-save")
    page.wait("return document.querySelector('.cell .badge.unsure')?.textContent === 'kick_left?'")


def test_removal_asks_first(library_page, running):
    page = library_page()
    page.find(".cell").click()
    page.press(KEYS.DELETE)
    page.wait(DIALOG)
    page.press(KEYS.ENTER)  # the harmless button has the focus
    assert not page.run(DIALOG)
    page.find(".cell").click()
    page.press(KEYS.DELETE)
    click(page, "#remove-go")
    wait_count(page, N - 1)
    assert len(running.app.state.studio.library.clips()) == N - 1


def test_what_another_tab_removed_is_gone_here_too(library_page, running):
    page = library_page()
    page.find(".cell").click()
    running.app.state.studio.library.remove([1, 2, 3, 4, 5, 6])
    page.run("document.dispatchEvent(new Event('visibilitychange'))")
    wait_count(page, N - 6)
    assert page.run("return document.querySelector('.cell .name').textContent") == "performer00_1.bvh"


def test_an_empty_library_invites(library_page):
    page = library_page()
    click(page, "#all-button")
    page.wait("return document.querySelector('.chosen-count')?.textContent.startsWith('24')")
    click(page, "[data-word=remove]")
    click(page, "#remove-go")
    page.wait("return document.querySelector('#start .drop')")
    assert page.run("return document.querySelector('#browse').hidden")
    assert page.find("#start-files") is not None


# --- adding and training


@pytest.fixture
def motions(bvh, tmp_path):
    """Two motions to add: real ones where they are, else made ones; and files that cannot be used."""
    good = sorted(DATA.rglob("*.bvh"))[:2]
    if not good:
        good = [tmp_path / "one.bvh", tmp_path / "two.bvh"]
        for number, path in enumerate(good, 1):
            path.write_bytes(bvh.read_bytes() + b"\n" * number)
    bad = [tmp_path / "broken.bvh", tmp_path / "letter.docx", tmp_path / "fake.bvh"]
    for path, text in zip(bad, ["HIERARCHY\nROOT a\n{\n", "Dear all", "hello"], strict=True):
        path.write_text(text)
    return good, bad


def test_files_are_added_and_what_was_refused_is_listed_also_after_a_reload(library_page, motions):
    good, bad = motions
    page = library_page()
    click(page, "#add-button")
    page.find("#add-files").send_keys("\n".join(map(str, [*good, *bad])))
    page.wait("return document.querySelector('#add-go')")
    refused = page.run(f"{DIALOG}.querySelector('.refused').textContent")
    assert "letter.docx" in refused
    assert "fake.bvh" in refused
    assert page.run("return document.querySelector('#add-category').value") == "none"
    click(page, "#add-go")
    for _ in range(2):
        page.wait("return document.querySelector('#add-report')?.textContent.startsWith('2 added')")
        refused = page.run(f"{DIALOG}.querySelector('.refused').textContent")
        assert all(path.name in refused for path in bad)
        page.driver.refresh()
    page.wait("return document.querySelector('#add-report')")
    click(page, "dialog .foot button")  # show them
    wait_count(page, 2)
    page.wait(f"{DRAWN} === 2")
    assert no_messages(page) == []


def test_labels_from_folders_are_shown_before_they_are_given(library_page, bvh, tmp_path, wait_job):
    folder = tmp_path / "hop"
    folder.mkdir()
    (folder / "anna_1.bvh").write_bytes(bvh.read_bytes() + b"\n")
    page = library_page()
    click(page, "#add-button")
    page.wait("return document.querySelector('#add-files')")
    page.find("#add-files-folder").send_keys(str(folder))
    page.wait("return document.querySelector('#add-go')")
    cells = "return [...document.querySelectorAll('.preview td')].map((cell) => cell.textContent)"
    assert page.run(cells) == ["hop/anna_1.bvh", "hop", "–"]
    page.run(
        "const select = document.querySelector('#add-performer'); select.value = 'name';"
        "const text = document.querySelector('#add-performer-pattern'); text.value = '^([a-z]+)';"
        "for (const one of [select, text]) one.dispatchEvent(new Event('input', {bubbles: true}));"
    )
    assert page.run(cells) == ["hop/anna_1.bvh", "hop", "anna"]
    click(page, "#add-go")
    page.wait("return document.querySelector('#add-report')")
    page.press(KEYS.ESCAPE)
    page.wait("return document.querySelector('[data-key=\"performer anna\"]')")
    assert page.run("return document.querySelector('[data-key=\"category hop\"]') !== null")


def test_files_dropped_anywhere_are_taken(library_page, bvh):
    page = library_page()
    page.run(
        "const files = new DataTransfer(); files.items.add(new File([arguments[0]], 'dropped.bvh'));"
        "for (const kind of ['dragenter', 'drop']) document.querySelector('#grid').dispatchEvent("
        "new DragEvent(kind, {bubbles: true, cancelable: true, dataTransfer: files}));",
        bvh.read_text() + "\n",
    )
    page.wait("return document.querySelector('#came')")
    assert not page.run("return document.documentElement.classList.contains('over')")


def test_training_shows_how_far_it_is_and_what_came_of_it(library_page):
    page = library_page()
    click(page, "#train-button")
    page.wait("return document.querySelector('#train-trees')")
    page.run("document.querySelector('#train-trees').value = '20'")
    click(page, "#train-go")
    page.wait("return document.querySelector('#train-result')")
    assert "20 trees on 24 clips of 4 categories" in page.run(f"{DIALOG}.textContent")
    page.driver.refresh()
    page.wait("return document.querySelector('#train-result')")


def test_an_upload_that_is_not_added_leaves_nothing(library_page, running, tmp_path):
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic import draw_performer, make_motion

    write_motion(make_motion("bow", draw_performer(5)), tmp_path / "bow.bvh")
    batches = running.app.state.studio.workspace.root / "files"
    page = library_page()
    click(page, "#add-button")
    page.find("#add-files").send_keys(str(tmp_path / "bow.bvh"))
    page.wait("return document.querySelector('#add-go')")
    assert [path for path in batches.iterdir() if path.is_dir()]
    page.press(KEYS.ESCAPE)
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if not [path for path in batches.iterdir() if path.is_dir()]:
            break
        page.settle()
    assert not [path for path in batches.iterdir() if path.is_dir()]
    page.run("document.querySelector('#jobs-button').click()")
    page.wait("return document.querySelector('.space')?.textContent.includes('MB')")


def test_folders_become_categories_by_level_with_a_look_at_what_comes_out(library_page, running, tmp_path):
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic import draw_performer, make_motion

    for number, place in enumerate(("archive/day1/bow", "archive/day2/bow", "archive/day2/nod")):
        folder = tmp_path / "up" / place
        folder.mkdir(parents=True)
        write_motion(
            make_motion("bow", draw_performer(40 + number)), folder / f"long_take_name_that_goes_on_{number}.bvh"
        )
    page = library_page()
    click(page, "#add-button")
    page.find("#add-files-folder").send_keys(str(tmp_path / "up"))
    page.wait("return document.querySelector('#add-go')")
    said = "return document.querySelector('.tally-line').textContent"
    assert page.run(said).startswith("Categories: 3 - ")
    offered = page.run("return [...document.querySelectorAll('#add-category option')].map((one) => one.value)")
    assert offered == ["folder", "last_folder", "level_1", "level_2", "level_3", "name", "none"]
    page.run(
        "const one = document.querySelector('#add-category'); one.value = 'last_folder';"
        "one.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    assert page.run(said) == "Categories: 2 - bow (2), nod (1)"
    page.find("#add-go").click()
    page.wait("return document.querySelector('.report-head')")
    known = running.app.state.studio.library.stats().categories
    assert known["bow"] == 2 and known["nod"] == 1
    page.press(KEYS.ESCAPE)
    page.find("#text").send_keys("goes_on")
    wait_count(page, 3)
    page.wait(f"{DRAWN} === 3")
    # Names that begin alike differ where they end, and that is not cut.
    ends = page.run("return [...document.querySelectorAll('.cell .name .cut-tail')].map((one) => one.textContent)")
    assert {"goes_on_0.bvh"[-10:], "goes_on_1.bvh"[-10:]} <= set(ends)
