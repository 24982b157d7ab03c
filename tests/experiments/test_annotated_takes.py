"""The trial of real annotated takes, on takes made of short actions with nothing between them."""

import json
from pathlib import Path

import numpy as np
import pytest
from oracles.short_actions import make_clip
from oracles.standing import standing

from dousa.errors import MotionFileError, TrainingError
from dousa.experiments.annotated_takes import NEVER_UNKNOWN, OURS, run_annotated_takes_experiment
from dousa.motion.annotation import Stretch
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.takes.label import Segment

ACTIONS = ("bow", "kick", "raise left", "spread")
REST = 45  # frames


def make_take(performer: int) -> AnnotatedTake:
    """Rest, an action, rest, an action, ...; the last rest is unclear."""
    draw = np.random.default_rng(performer)
    parts, stretches, at = [], [], 0
    for action in (*draw.permutation(ACTIONS), *draw.permutation(ACTIONS), None):
        clip = None if action is None else make_clip(str(action), performer, trial=len(parts))
        size = 1.0 + 0.05 * (performer % 3)
        rest = np.repeat(standing(), REST, axis=0) * size + 0.002 * draw.normal(size=(REST, 20, 3))
        parts.append(rest)
        stretches.append(Stretch(at / 30, (at + REST) / 30, None, counted=clip is not None))
        at += REST
        if clip is not None:
            parts.append(clip.positions)
            stretches.append(Stretch(at / 30, (at + len(clip.positions)) / 30, str(action)))
            at += len(clip.positions)
    height = 1.7 * (1.0 + 0.05 * (performer % 3))
    return AnnotatedTake(f"take {performer}", str(performer), np.concatenate(parts), 30.0, height, tuple(stretches))


TAKES = [make_take(performer) for performer in range(3)]


def knows_all(takes):
    def label(take):
        truth = [Segment(one.start, one.stop, one.category, 1.0) for one in take.stretches]
        return {"truth": truth, "silence": [], "bow": [Segment(0.0, 1e3, "bow", 1.0)]}

    return label


@pytest.fixture(scope="module")
def result():
    return run_annotated_takes_experiment(TAKES, methods={"other": knows_all}, n_jobs=1)


def test_a_perfect_answer_and_silence_and_one_word(result):
    perfect, silence, bow = (result.scores[name] for name in ("truth", "silence", "bow"))
    assert (perfect.annotated_right, perfect.rest_called, perfect.timeline.frame_accuracy) == (1.0, 0.0, 1.0)
    assert perfect.timeline.f_measure == 1.0
    assert (silence.annotated_right, silence.rest_called) == (0.0, 0.0)
    assert bow.rest_called == 1.0 and 0.15 < bow.annotated_right < 0.35


def test_frames_that_nobody_can_name_do_not_count(result):
    rest = sum(one.stop - one.start for take in TAKES for one in take.stretches if one.category is None and one.counted)
    shown = sum(one.stop - one.start for take in TAKES for one in take.stretches if one.category is not None)
    assert result.scores["silence"].timeline.frame_accuracy == pytest.approx(rest / (rest + shown), abs=0.005)


def test_ours_is_learned_from_the_takes_of_others(result):
    assert result.scores[OURS].annotated_right > 0.7
    assert result.scores[NEVER_UNKNOWN].annotated_right >= result.scores[OURS].annotated_right - 0.05
    assert list(result.by_performer[OURS]) == ["0", "1", "2"]
    assert (result.n_takes, result.n_segments, result.n_categories) == (3, 24, 4)
    assert all(one.truth != one.predicted for one in result.confusions)


def test_the_answer_is_plain_and_shown_in_full(result):
    assert json.loads(json.dumps(result.to_json()))["n_takes"] == 3
    scores, people, *_ = result.to_tables()
    assert [row[0] for row in scores.rows] == list(result.scores)
    assert [row[0] for row in people.rows] == ["0", "1", "2"]


def test_what_cannot_be_tried_is_said():
    with pytest.raises(TrainingError, match="two categories"):
        run_annotated_takes_experiment([])
    alone = [take for take in TAKES if take.performer == "0"]
    with pytest.raises(TrainingError):
        run_annotated_takes_experiment(alone)


def write_takes(folder: Path) -> None:
    from dousa.formats import write_motion
    from dousa.formats.annotations import write_labels_csv
    from dousa.motion import CANONICAL_JOINTS, Trajectories

    for take in TAKES:
        path = folder / f"p{take.performer}.trc"
        write_motion(Trajectories(CANONICAL_JOINTS, take.positions, 30.0), path)
        write_labels_csv(take.stretches, path.with_suffix(".labels.csv"))


def test_takes_are_read_with_their_tables(tmp_path):
    from dousa.app.pipelines.experiment_clips import read_annotated_takes
    from dousa.formats import ReadOptions

    write_takes(tmp_path)
    options = ReadOptions(unit="m", up="y")
    (tmp_path / "p2.labels.csv").unlink()
    takes, skipped = read_annotated_takes([tmp_path], "beside", performer_from=r"name:p(\d)", options=options, n_jobs=1)
    assert [take.performer for take in takes] == ["0", "1"]
    assert [item.reason.code for item in skipped] == ["annotations.no_table"]
    said = [one.category for one in takes[0].stretches]
    assert said == [one.category for one in TAKES[0].stretches]
    (tmp_path / "p2.labels.csv").write_text("start_s,end_s,category\n")
    _, skipped = read_annotated_takes([tmp_path], "beside", performer_from=r"name:p(\d)", options=options, n_jobs=1)
    assert [item.reason.code for item in skipped] == ["annotations.blank"]
    (tmp_path / "p2.labels.csv").write_text("start_s,end_s,category\n9000,9900,bow\n")
    with pytest.raises(MotionFileError, match=r"p2.labels.csv:2: 'bow' from 9000 to 9900 s does not fit p2.trc"):
        read_annotated_takes([tmp_path], "beside", performer_from=r"name:p(\d)", options=options, n_jobs=1)
