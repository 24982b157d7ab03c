"""How far an estimate is to be trusted: in its result, and as the page says it."""

from __future__ import annotations

import json

import pytest

from dousa.app.studio.work.estimation import rank_warnings
from dousa.messages import Message
from dousa.messages.tables import load_table

BAD = Message("doubts.bad_overlap", overlap=0.52)
DOUBT = Message("doubts.one_view")
NOTE = Message("film_estimate.calibrated", views=2)


@pytest.mark.parametrize(
    ("warnings", "lost", "trust", "order"),
    [
        ([NOTE, DOUBT, BAD], 0.0, "bad", [BAD, DOUBT, NOTE]),
        ([NOTE, DOUBT], 0.1, "unsure", [DOUBT, NOTE]),
        ([NOTE], 0.0, "good", [NOTE]),
        ([], 0.0, "good", []),
        ([], 0.6, "bad", []),
        ([Message("film.of_view", view="a", note=BAD), NOTE], 0.0, "bad", None),
    ],
)
def test_the_gravest_comes_first_and_counts(warnings, lost, trust, order):
    found, ranked, weights = rank_warnings(warnings, lost)
    assert found == trust
    assert order is None or ranked == order
    assert len(weights) == len(warnings)
    assert weights == sorted(weights, key=["bad", "unsure", "good"].index)


def test_every_code_that_is_weighed_exists():
    from dousa.app.studio.work import estimation as trust

    assert (trust._WRONG | trust._DOUBTFUL) - set(load_table("en")) == set()


@pytest.mark.parametrize(
    ("trust", "language", "heading"),
    [("bad", "en", "Do not trust this motion"), ("unsure", "ja", "動きが推定できました（要確認）")],
)
def test_a_wrong_result_is_not_headed_as_if_it_were_right(show, running, trust, language, heading, tmp_path):
    job = running.app.state.studio.jobs
    folder = running.app.state.studio.workspace.root / "jobs" / "0123456789abcdef"
    folder.mkdir()
    warnings = [BAD, DOUBT, NOTE] if trust == "bad" else [DOUBT, NOTE]
    result = {
        "trust": trust, "warning_weights": ["bad", "unsure", "good"][-len(warnings):],
        "warnings": [{"$message": one.to_json()} for one in warnings], "iou": {"mean": 0.52}, "lost_frames": [],
        "n_frames": 10, "frame_rate": 30.0, "stature_m": 1.7, "frames_per_second": 2.0, "files": [],
    }  # fmt: skip
    stored = {
        "id": folder.name, "kind": "estimate", "title": "kick", "request": {}, "state": "done", "what": None,
        "notes": [], "problem": None, "result": result, "version": 1, "finished_s": 1.0,
    }  # fmt: skip
    (folder / "job.json").write_text(json.dumps(stored))
    job._load()
    page = show(f"/estimate?job={folder.name}", language=language)
    page.wait("return !document.querySelector('#outcome').hidden")
    assert page.run("return document.querySelector('#outcome-title').textContent") == heading
    assert page.run("return document.querySelector('#watch-state').className") == f"badge {trust}"
    first = page.run("return document.querySelector('.says li').className")
    assert first == trust
    # The warnings stand above the figures.
    assert page.run(
        "return document.querySelector('.says').compareDocumentPosition(document.querySelector('.outcome-facts')) & 4"
    )
