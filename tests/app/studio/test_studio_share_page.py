"""What a pupil sees on a phone, and where a teacher gets the link, in a real Chromium."""

from ipaddress import IPv4Address

import pytest

from app.studio.studio_client import Client

pytest.importorskip("cryptography", reason="pip install 'dousa[share]'")
pytest.importorskip("segno", reason="pip install 'dousa[share]'")

from dousa.app.studio.server import PatientProtocol, answer_problems
from dousa.app.studio.shared import make_sharing


@pytest.fixture
def sharing(running, browser):
    """That studio, shared; the browser takes its certificate, as a person would."""
    inner = running.app.state.studio
    inner.sharing = make_sharing(inner, IPv4Address("127.0.0.1"), answer_problems, PatientProtocol)
    inner.sharing.begin()
    browser.driver.execute_cdp_cmd("Security.setIgnoreCertificateErrors", {"ignore": True})
    yield inner.sharing
    browser.driver.get("about:blank")
    browser.driver.execute_cdp_cmd("Security.setIgnoreCertificateErrors", {"ignore": False})
    inner.sharing.end()


@pytest.fixture
def job(running):
    client = Client(running)
    clips = [one["motion"] for one in client.ask("GET", "/api/clips?category=kick_left")["items"]]
    request = {"references": [{"motion": one} for one in clips[1:4]], "performance": {"motion": clips[0]}}
    found = client.ask("POST", "/api/jobs/evaluate", request)["id"]
    client.wait(found)
    client.ask("PUT", f"/api/evaluations/{found}/notes", {"notes": "Softer knees. <b>Soon</b>."})
    return found


def _visit(browser, address, width=390, height=844, scheme="light", language="en"):
    browser.resize(width, height)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    browser.driver.get("about:blank")
    browser.driver.get_log("browser")
    browser.driver.get(address)  # the code brings the phone in
    browser.wait("return document.readyState === 'complete'")
    browser.driver.add_cookie({"name": "dousa_lang", "value": language, "path": "/"})
    browser.driver.refresh()
    browser.wait("return document.readyState === 'complete'")


@pytest.mark.parametrize(
    ("width", "height", "scheme", "language"),
    [(390, 844, "light", "ja"), (390, 844, "dark", "en"), (1440, 900, "light", "en")],
)
def test_a_pupil_sees_the_report_on_a_phone(browser, sharing, job, tmp_path, width, height, scheme, language):
    link = sharing.links.add(job)
    _visit(browser, sharing.address_of(link), width, height, scheme, language)
    browser.wait("return document.querySelector('#player .dousa-player')")
    assert browser.run("return location.pathname") == "/report"
    assert "key" not in browser.run("return location.search")
    browser.settle()
    assert browser.run("return document.documentElement.scrollWidth") <= width
    text = browser.run("return document.querySelector('#report').textContent")
    assert ("評価点" in text) == (language == "ja")
    assert "Softer knees. <b>Soon</b>." in text
    assert browser.run("return document.querySelectorAll('#report [data-part=notes] b').length") == 0
    # Nothing to change: no field, no panel; the analysis is folded, and the report is one file.
    fields = browser.run(
        "return [...document.querySelectorAll('textarea, #adjust, form, select, input:not(.dp-scrub)')]"
        ".filter((one) => one.offsetParent).map((one) => one.outerHTML)"
    )
    assert fields == []
    assert not browser.run("return document.querySelector('#analysis').open")
    assert browser.run("return document.querySelector('#download').href").endswith(f"report.html?language={language}")
    # The player plays, and touches have room.
    browser.run("document.querySelector('#report [data-event]')?.click()")
    small = browser.run(
        "return [...document.querySelectorAll('#player button, .bar-end button, #download')].filter((one) => "
        "one.offsetParent && one.getBoundingClientRect().height < 28).map((one) => one.outerHTML)"
    )
    assert small == []
    browser.screenshot(tmp_path / "page.png", whole=True)
    assert browser.messages() == []


def test_the_list_and_the_library(browser, sharing, job):
    link = sharing.links.add(None)
    _visit(browser, sharing.address_of(link))
    browser.wait("return document.querySelectorAll('.shared-clip').length === 24")
    assert browser.run("return document.querySelectorAll('.shared-report').length") == 1
    field = browser.find("#shared-text")
    field.send_keys("squat")
    browser.wait("return document.querySelectorAll('.shared-clip').length === 6")
    browser.run("document.querySelector('.shared-clip').click()")
    browser.wait("return document.querySelector('dialog .dousa-player canvas')")
    assert browser.run("return document.documentElement.scrollWidth") <= 390
    browser.press("\ue00c")
    browser.wait("return !document.querySelector('dialog')")
    browser.find(".shared-report").click()
    browser.wait("return document.querySelector('#player .dousa-player')")
    assert browser.messages() == []


def test_a_phone_films_and_the_teacher_finds_it(browser, sharing, running, show, tmp_path):
    inner = running.app.state.studio
    link = sharing.links.add(None, inner.workspace.new_inbox())
    _visit(browser, sharing.address_of(link))
    browser.wait("return document.querySelector('#film')")
    assert browser.run("return location.pathname") == "/film"
    field = browser.find("#film")
    assert field.get_attribute("capture") == "environment"
    (tmp_path / "image.mp4").write_bytes(b"\0\0\0\x18ftypisom" + b"\0" * 100)
    field.send_keys(str(tmp_path / "image.mp4"))
    browser.wait("return document.querySelectorAll('#film-files .card').length === 1")
    assert browser.messages() == []
    page = show("/library", 1440, 900)
    page.wait("return document.querySelector('#share-button')").click()
    page.wait("return document.querySelector('#inboxes a')")
    assert page.run("return document.querySelector('#inboxes a').href").endswith(f"/estimate?batch={link.inbox}")
    page.find("[data-act=share_discard]").click()
    page.wait("return !document.querySelector('#inboxes')")
    assert inner.workspace.files(link.inbox) == []


def test_a_teacher_gets_the_code_takes_it_back_and_ends_it(show, sharing, job):
    page = show(f"/evaluate?job={job}", 1440, 900)
    page.wait("return document.querySelector('#share-report')?.offsetParent")
    page.find("#share-report").click()
    page.wait("return document.querySelector('#sharing img')?.naturalWidth > 50")
    url = page.run("return document.querySelector('#sharing input').value")
    assert url.startswith("https://127.0.0.1:")
    warning = page.run("return document.querySelector('#sharing .problem-box').textContent")
    assert "Nobody can change anything" in warning
    assert sharing.server.fingerprint in page.run("return document.querySelector('#sharing').textContent")
    before = sharing.links.all()
    assert [link.report for link in before] == [job]
    page.run("document.querySelector('.sharing-links').open = true")
    page.find("[data-act=share_revoke]").click()
    page.wait("return document.querySelector('#sharing input')?.value !== arguments[0]", url)
    assert sharing.links.find(before[0].token) is None  # the link that is shown now is another one
    page.find("[data-act=share_end]").click()
    page.wait("return document.querySelector('[data-act=share_begin]')")
    assert sharing.server is None
    assert not page.run("return document.querySelector('#share-button').classList.contains('on')")
    page.find("[data-act=share_begin]").click()
    page.wait("return document.querySelector('#sharing img')")
    assert sharing.server is not None


def test_without_the_option_the_page_says_how(show, running, job):
    page = show(f"/evaluate?job={job}")
    page.wait("return document.querySelector('#share-report')?.offsetParent")
    page.find("#share-report").click()
    page.wait("return document.querySelector('#sharing code')")
    assert "--share" in page.run("return document.querySelector('#sharing code').textContent")
    assert not page.run("return document.querySelector('#share-button')")
