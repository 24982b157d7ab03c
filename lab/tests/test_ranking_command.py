"""The programs lab.ranking and lab.novelty: tables, JSON, and what they refuse."""

from __future__ import annotations

import json

import pytest

from dousa.formats.registry import write_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.ranking.systems import RANKING_SYSTEMS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """category/pN.bvh of three performers; one category only one of them shows."""
    made = tmp_path_factory.mktemp("ranked")
    for number in range(3):
        performer = draw_performer(number)
        for category in ("walk", "squat", "clap", *(["bow"] if number == 0 else [])):
            (made / category).mkdir(exist_ok=True)
            write_motion(make_motion(category, performer, seed=number), made / category / f"p{number}.bvh")
    return made


PERFORMERS = ("--split", "leave-performer-out", "--performer-from", r"name:(p\d)", "--trees", 10, "--jobs", 1)


def test_the_table_names_every_ranking_and_says_what_was_left_out(program, folder):
    code, out, err = program("ranking", folder, *PERFORMERS)
    assert code == 0, err
    for words in (
        "4 categories, 9 queries",
        "features extended",
        "fused (default)",
        "histogram (eq. 8)",
        "DTW on poses",
        "motion templates",
        "2000 bootstrap resamples",
        "fewer than 10 clips to find",
        "a perfect ranking reaches 0.200",
        "bow: queries left out, as no clip of this category is there to be found: 1",
        "MAP beyond DTW: fused",
        "whole performers resampled",
    ):
        assert words in out


def test_json_and_systems_of_choice(program, folder):
    code, out, err = program("ranking", folder, *PERFORMERS, "--json", "--features", "paper")
    assert code == 0, err
    answer = json.loads(out)
    assert list(answer["systems"]) == list(RANKING_SYSTEMS)
    assert answer["features"] == "paper" and answer["skipped"] == []
    words = ("--system", "dtw", "--system", "fused", "--json")
    code, out, _ = program("ranking", folder, *PERFORMERS, *words)
    assert list(json.loads(out)["systems"]) == ["dtw", "fused"]


def test_a_folder_of_queries(program, folder, tmp_path):
    queries = tmp_path / "asked" / "walk"
    queries.mkdir(parents=True)
    write_motion(make_motion("walk", draw_performer(9), seed=9), queries / "p9.bvh")
    words = ("--test", queries.parent, "--system", "fused", "--trees", 10, "--json", "--jobs", 1)
    code, out, err = program("ranking", folder, *words)
    assert code == 0, err
    answer = json.loads(out)
    assert (answer["split"], answer["n_queries"], answer["n_gallery"]) == ("given", 1, 10)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--split", "leave-performer-out"), "--performer-from"),
        (("--split", "half", "--test", "queries"), "--test"),
        (("--system", "best"), "best"),
    ],
)
def test_what_cannot_be_is_refused(program, folder, words, problem):
    code, out, err = program("ranking", folder, *words)
    assert code == 2 and problem in err and not out


def test_unknown_motions_answer_with_tables(program, shared_data):
    options = ("--performer-from", r"name:HDM_(..)_", "--trees", 10, "--jobs", 1)
    code, out, err = program("novelty", shared_data("hdm05"), *options)
    assert code == 0, err
    for words in ("AUROC", "189 clips of 11 categories", "grown", "retrained"):
        assert words in out
