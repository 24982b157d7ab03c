"""``dousa evaluate --music`` with beats and with sound: sentences, JSON, and mistakes in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from dousa.formats.registry import write_motion
from evaluation.beats.accented import make_body, wave

BEATS = np.arange(0.0, 20.0, 0.5)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """dance.trc, whose hand rests 80 ms after every second beat; beats.csv, and others that cannot be used."""
    folder = tmp_path_factory.mktemp("beats")
    body = make_body({"left_hand": wave(BEATS[2:34:2] + 0.08, 60.0)}, 60.0)
    write_motion(body.to_trajectories(), folder / "dance.trc")
    for name, beats in (("beats", BEATS), ("unsorted", BEATS[::-1]), ("short", BEATS[:6]), ("empty", ())):
        (folder / f"{name}.csv").write_text("time\n" + "".join(f"{beat}\n" for beat in beats))
    return folder


def evaluate(dousa, files, *words, language="en"):
    return dousa("--lang", language, "evaluate", files / "dance.trc", "--performance", files / "dance.trc", *words)


def test_the_sentences(dousa, files):
    code, out, _ = evaluate(dousa, files, "--music", files / "beats.csv", "--music-start", "0")
    assert code == 0
    assert "16 of 16 accents belong to beats of the music (120 a minute), " in out and " ms late in the median" in out
    assert "no drift over the song" in out


@pytest.mark.parametrize(("language", "title"), [("en", "On the beat"), ("ja", "音楽の拍との一致")])
def test_the_report_has_a_section(dousa, files, tmp_path, language, title):
    words = ("--music", files / "beats.csv", "--music-start", "0", "-o", tmp_path)
    assert evaluate(dousa, files, *words, language=language)[0] == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<section id="beats">') :]
    assert f"<h2>{title}</h2>" in section and section.count('class="dot stop" style') == 16


def test_json_has_beats_only_when_asked(dousa, files):
    code, out, _ = evaluate(dousa, files, "--music", files / "beats.csv", "--music-start", "0", "--json")
    beats = json.loads(out)["beats"]
    assert code == 0
    assert beats["median_ms"] == pytest.approx(80.0, abs=25.0)
    assert len(beats["accents"]) == 16
    code, out, _ = evaluate(dousa, files, "--json")
    assert code == 0 and "beats" not in json.loads(out)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--music", "unsorted.csv"), "expected rising times"),
        (("--music", "empty.csv"), "expected at least 4"),
        (("--music", "short.csv"), "shorter than the dance"),
        (("--music", "none.csv"), "none.csv"),
        (("--music", "beats.csv", "--music-start", "100"), "check --music-start"),
        (("--music", "beats.csv", "--music-start", "nan"), "expected seconds"),
        (("--music", "beats.csv", "--repetitions"), "cannot be combined with --repetitions"),
        (("--music-start", "1"), "needs --music"),
    ],
)
def test_mistakes_are_one_line(dousa, files, monkeypatch, words, says):
    monkeypatch.chdir(files)
    code, out, err = evaluate(dousa, files, *words)
    assert (code, out) == (2, "")
    assert says in err
    assert len([line for line in err.splitlines() if not line.startswith("note")]) == 1
