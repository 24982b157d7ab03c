"""Evaluations beside each other in Chromium: dates of one pupil, several pupils of one figure, two players in step."""

import urllib.error

import pytest

from dousa.evaluation.grade.score import round_grade

CELLS = """
return [...document.querySelectorAll('.compare-table tbody tr:not(.compare-title)')].map((row) =>
  [...row.children].map((cell) => cell.textContent.trim()));
"""
# Pieces of names that do not stand in one line: they were broken within a word.
BROKEN = """
const found = [];
for (const name of document.querySelectorAll('.compare-table thead a, .compare-name, .compare-group legend')) {
  for (const piece of name.childNodes) {
    const range = document.createRange();
    range.selectNodeContents(piece);
    if (new Set([...range.getClientRects()].map((one) => Math.round(one.top))).size > 1) found.push(piece.textContent);
  }
}
return found;
"""
FILLED = "return document.querySelectorAll('.compare-table tbody tr').length > 10"


@pytest.fixture
def graded(client, dances):
    """(evaluations against one reference, the worse first; one against another), done."""
    takes, pupil = dances
    names = [client.upload(path) for path in (*takes, pupil)]
    references = [{"motion": name} for name in names[:2]]
    found = []
    for performance, against in ((names[3], references), (names[2], references), (names[2], references[:1])):
        wanted = {"references": against, "performance": {"motion": performance}}
        found.append(client.ask("POST", "/api/jobs/evaluate", wanted)["id"])
        assert client.wait(found[-1])["state"] == "done"
    return found[:2], found[2]


def test_evaluations_of_one_reference_stand_beside_each_other(show, client, graded, faults):
    (first, second), other = graded
    scores = [client.ask("GET", f"/api/jobs/{job}")["result"]["score"] for job in (first, second)]
    assert scores[1] > scores[0] + 2
    page = show("/evaluate", 1440, 900)
    page.wait("return document.querySelector('#compare-open')?.checkVisibility()")
    page.find("#compare-open").click()
    page.wait(FILLED)
    boxes = page.run(
        "return [...document.querySelectorAll('.compare-row input')].map((b) => [b.dataset.job, b.checked])"
    )
    assert dict(boxes) == {first: True, second: True, other: False}

    rows = {name: cells for name, *cells in page.run(CELLS)}
    assert [int(cell.split()[0]) for cell in rows["Grade"]] == [round_grade(score) for score in scores]
    assert set(rows) >= {"time shift", "left forearm", "trunk"}
    page.run("document.querySelector('[name=compare-mode][value=dates]').click()")
    rows = {name: cells for name, *cells in page.run(CELLS)}
    assert "better" in rows["Grade"][1] and "better" not in rows["Grade"][0]
    said = page.run("return document.querySelector('.compare-says').textContent")
    assert said.startswith("the grade rose from")
    page.wait("return document.querySelector('.compare-picture').naturalWidth > 100")

    # The grade stands beside the name.
    box = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
    boxes = [page.run(box, one) for one in (".compare-name", ".compare-grade")]
    assert boxes[1]["left"] >= boxes[0]["right"] and abs(boxes[1]["top"] - boxes[0]["top"]) < 4
    assert faults(page) == []

    page.run("document.querySelector('[name=compare-mode][value=pupils]').click()")
    rows = {name: cells for name, *cells in page.run(CELLS)}
    assert "best" in rows["Grade"][1] and "best" not in rows["Grade"][0]
    assert not page.run("return document.querySelector('.compare-picture').checkVisibility()")
    said = page.run("return document.querySelector('.compare-says').textContent")
    assert said.startswith(("What all of them do wrong", "No error is common"))

    page.wait("return document.querySelector('.compare-player canvas')")
    names = page.run("return [...document.querySelectorAll('.compare-player .dp-name')].map((e) => e.textContent)")
    assert any("dance_pupil" in name for name in names) and any("dance_reference" in name for name in names)


def test_grades_are_told_as_reports_and_tables_tell_them(show):
    page = show("/evaluate")
    grades = [tenth / 10 for tenth in range(1001)]
    said = page.driver.execute_async_script(
        """
        const [grades, done] = arguments;
        const base = document.querySelector('script[src*="core/frame"]').src.replace('frame.js', '');
        import(`${base}dom.js`).then(({ wholeGrade }) => done(grades.map(wholeGrade)));
        """,
        grades,
    )
    assert said == [f"{round_grade(grade):.0f}" for grade in grades]


def test_what_is_chosen_stays_in_the_address_and_is_of_one_reference(show, graded, faults):
    (first, second), other = graded
    page = show(f"/evaluate?compare={first},{second}", 390, 844, "dark", "ja")
    page.wait(FILLED)
    assert page.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    page.wait("return document.querySelector('.compare-player canvas')")
    assert faults(page) == []
    assert page.run(BROKEN) == []
    high = "return [...document.querySelectorAll('.dp-name')].map((e) => e.getBoundingClientRect().height)"
    assert len(page.run(high)) == 2 and max(page.run(high)) < 32  # one line each, however narrow
    page.run("document.querySelector(`.compare-row [data-job='${arguments[0]}']`).click()", other)
    page.wait("return !document.querySelector('.compare-table')")  # one alone is not compared
    checked = page.run("return [...document.querySelectorAll('.compare-row input:checked')].map((b) => b.dataset.job)")
    assert checked == [other] and page.run("return location.search.includes(arguments[0])", f"compare={other}")
    for job in (first, second):
        page.run("document.querySelector(`.compare-row [data-job='${arguments[0]}']`).click()", job)
    page.wait(FILLED)
    page.driver.refresh()
    page.wait(FILLED)
    assert page.run("return document.querySelectorAll('.compare-row input:checked').length") == 2
    page.resize(2560, 1300)
    assert page.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_what_cannot_be_compared_is_refused(client, graded):
    (first, second), other = graded
    for asked, status in (
        (f"job={first}", 422),
        (f"job={first}&job={first}", 422),
        (f"job={first}&job={other}", 422),
        (f"job={first}&job=0123456789abcdef", 404),
        ("", 422),
    ):
        for path in ("comparisons", "comparisons/player", "comparisons/progress.svg"):
            with pytest.raises(urllib.error.HTTPError) as caught:
                client.ask("GET", f"/api/{path}?{asked}")
            caught.value.close()
            assert caught.value.code == status, (path, asked)
    found = client.ask("GET", f"/api/comparisons?job={first}&job={second}&language=ja")
    assert "評価点が" in found["says"] and len(found["attempts"]) == 2
