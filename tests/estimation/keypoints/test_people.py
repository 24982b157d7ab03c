"""People are followed from frame to frame and keep who they are: through crossings, breaks and ghosts."""

import itertools

import numpy as np
import pytest
from oracles.made_people import collect, see

from dousa.estimation.keypoints.people import PeopleFollower, assign, cut_stretches, find_identities
from dousa.estimation.keypoints.pose_networks import Detection, Landmarks, PersonCrop

TIMES = np.arange(120) / 30


def list_colours(sightings, rows):
    return set(sightings["colours"][rows, 0].argmax(axis=1).tolist())


@pytest.mark.parametrize("seed", range(20))
def test_assignment_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    n_rows = rng.integers(1, 6)
    costs = rng.normal(size=(n_rows, n_rows + rng.integers(0, 3)))
    if seed % 3 == 0:
        costs = np.round(costs)  # ties
    columns = assign(costs)
    assert len(set(columns)) == n_rows
    best = min(
        sum(costs[row, column] for row, column in enumerate(choice))
        for choice in itertools.permutations(range(costs.shape[1]), int(n_rows))
    )
    assert sum(costs[row, column] for row, column in enumerate(columns)) == pytest.approx(best)


def test_crops_that_slide_over_when_people_cross_are_put_right():
    """Two people walk through each other; from there on each crop follows the other person."""
    rows = []
    for frame in range(120):
        left, right = 100 + 5 * frame, 700 - 5 * frame
        swapped = frame >= 60
        rows += [see(frame, int(swapped), left, colour=1), see(frame, int(not swapped), right, colour=2)]
    sightings = collect(rows)
    people = find_identities(sightings, TIMES)
    assert [len(rows) for rows in people] == [120, 120]
    apart = abs(sightings["frame"] - 60) > 4  # while they touch there is no telling
    assert sorted(map(str, (list_colours(sightings, rows[apart[rows]]) for rows in people))) == ["{1}", "{2}"]


def test_people_of_the_same_colours_go_on_as_they_walked():
    rows = []
    for frame in range(120):
        for person, x in enumerate((100 + 5 * frame, 700 - 5 * frame)):
            if not 50 < frame < 70:
                rows.append(see(frame, person + 2 * (frame > 60), x, y=300 + 25 * person))
    sightings = collect(rows)
    people = find_identities(sightings, TIMES)
    assert len(people) == 2
    for rows in people:
        assert (np.abs(np.diff(np.sign(np.diff(sightings["crop"][rows, 0])))) == 0).all()


def test_who_comes_back_is_the_same_and_who_is_new_is_another():
    rows = [see(frame, 0, 100, colour=1) for frame in range(30)]
    rows += [see(frame, 1, 180, colour=1) for frame in range(60, 100)]
    rows += [see(frame, 2, 900, colour=9) for frame in range(50, 120)]
    sightings = collect(rows)
    people = find_identities(sightings, TIMES)
    assert [len(rows) for rows in people] == [70, 70]
    assert sorted(map(str, (list_colours(sightings, rows) for rows in people))) == ["{1}", "{9}"]


def test_nobody_is_in_a_frame_twice():
    rng = np.random.default_rng(0)
    rows = [
        see(frame, stretch, rng.uniform(0, 900), colour=int(rng.integers(3)))
        for stretch in range(12)
        for frame in range(9 * stretch, 9 * stretch + 30)
        if frame < 120
    ]
    sightings = collect(rows)
    for rows in find_identities(sightings, TIMES):
        assert (np.diff(sightings["frame"][rows]) > 0).all()


def test_ghosts_are_nobody():
    rows = [see(frame, 0, 100, colour=1) for frame in range(120)]
    rows += [see(frame, 1, 600, colour=5) for frame in range(40, 46)]  # a fifth of a second
    rows += [see(frame, 2, 900, colour=6, score=0.55) for frame in range(20, 100)]  # a lamp
    rows += [see(frame, 3, 300, colour=7, ghost=True) for frame in range(20, 100)]  # the sun, without a body
    sightings = collect(rows)
    assert [len(rows) for rows in find_identities(sightings, TIMES)] == [120]
    assert find_identities(sightings[:0], TIMES) == []


def test_pieces_end_where_people_touch_and_points_jump():
    rows = [see(frame, 0, 100 + (400 if frame >= 20 else 0)) for frame in range(40)]
    rows += [see(frame, 1, 900 - 10 * frame) for frame in range(40)]
    pieces = cut_stretches(collect(rows))
    firsts = [int(piece.rows[0]) for piece in pieces]
    assert sum(len(piece.rows) for piece in pieces) == 80
    assert firsts == sorted(firsts)
    assert any(piece.stretch == 0 and len(piece.rows) == 20 for piece in pieces)
    assert sum(piece.stretch == 1 for piece in pieces) > 1


@pytest.mark.parametrize("n_frames", [1, 2, 5])
def test_a_film_shorter_than_people_must_be_seen_has_people_all_the_same(n_frames):
    sightings = collect([see(frame, 0, 300 + frame) for frame in range(n_frames)])
    assert [len(rows) for rows in find_identities(sightings, TIMES[:n_frames])] == [n_frames]
    assert find_identities(sightings, TIMES) == []


class PlannedLandmarks:
    """Landmarks of people who stand at planned places; a crop shows the nearest."""

    def __init__(self, places):
        self.places, self.frame = places, 0

    def find(self, picture, crop, others=(), own=None):
        shown = [place for place in self.places(self.frame) if np.hypot(place[0] - crop.x, place[1] - crop.y) < 40]
        x, y = min(shown, key=lambda place: np.hypot(place[0] - crop.x, place[1] - crop.y), default=(crop.x, crop.y))
        row = see(0, 0, x, y, size=60)
        mask = np.zeros((128, 128), bool)
        mask[20:100, 40:90] = bool(shown)
        at = PersonCrop(x, y, 60.0, 0.0)
        points, visible = row["points"].astype(float), row["visibility"].astype(float)
        colours = np.zeros((256, 256, 3), np.uint8)
        return Landmarks(float(bool(shown)), points, visible, np.zeros((33, 3)), crop, at, mask, colours)


class PlannedDetector:
    """Finds all people who stand at planned places."""

    def __init__(self, landmarks):
        self.landmarks, self.n_asked = landmarks, 0

    def find(self, picture, part=None):
        self.n_asked += 1
        places = self.landmarks.places(self.landmarks.frame)
        return [Detection(0.9, np.zeros(4), PersonCrop(x + 2, y, 60.0, 0.0)) for x, y in places]


def follow(places, n_frames, resume_at=None, most=4):
    pytest.importorskip("cv2", reason="OpenCV is not installed (dousa[film])")
    landmarks = PlannedLandmarks(places)
    detector = PlannedDetector(landmarks)
    follower, rows = PeopleFollower(detector, landmarks, most), []
    for frame in range(n_frames):
        landmarks.frame = frame
        if frame == resume_at:
            follower = PeopleFollower(detector, landmarks, most)
            follower.resume(np.concatenate(rows), frame - 1)
        rows.append(follower.see(frame, np.zeros((200, 300, 3), np.uint8)))
    return np.concatenate(rows), detector.n_asked


def walk(frame):
    return [(50 + 2 * frame, 80)] + ([(250, 120)] if not 20 <= frame < 34 else [])


def test_people_are_followed_and_the_detector_rests():
    rows, n_asked = follow(walk, 60)
    assert (rows["stretch"] == 0).sum() == 60
    assert np.unique(rows["stretch"]).tolist() == [0, 1, 2]
    assert rows["frame"][rows["stretch"] == 2].min() in (34, 35, 36)  # looked for where he was lost
    assert n_asked < 25


@pytest.mark.parametrize("resume_at", [1, 20, 22, 36, 59])
def test_following_goes_on_as_if_nothing_had_happened(resume_at):
    rows, _ = follow(walk, 60)
    again, _ = follow(walk, 60, resume_at)
    assert rows.tobytes() == again.tobytes()


def test_no_more_people_than_asked_for_and_none_twice():
    rows, _ = follow(lambda frame: [(50, 80), (150, 80), (250, 80)], 20, most=2)
    assert set(np.unique(rows["frame"], return_counts=True)[1].tolist()) == {2}
    rows, _ = follow(lambda frame: [(50 + 5 * min(frame, 10), 80), (100, 80)], 20)
    assert (rows["frame"] == 19).sum() == 1
