"""Follow a person in front of the camera: pictures come in one by one; keypoints, a label and a grade go out.

Everything is computed on this machine, and no picture is stored. The network estimates the posture of one person, and
the picture gives the place.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.studio.core.answers import RefusedError, name_error
from dousa.arrays import FloatArray, Image
from dousa.errors import DousaError
from dousa.extras import require
from dousa.messages import Message, get_language

if TYPE_CHECKING:
    from dousa.estimation.keypoints.pose_models import LandmarkModel
    from dousa.evaluation import FrameState, IncrementalAssessor
    from dousa.library import Library
    from dousa.motion import CanonicalMotion
    from dousa.retrieval import LiveLabeller

QUICKEST: LandmarkModel = "lite"
_MODELS: tuple[LandmarkModel, ...] = ("full", QUICKEST, "heavy")  # those that keep up first


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A person in a picture.

    Parameters
    ----------
    points : (33, 2) px.
    visibility : (33,) 0 to 1.
    world : (33, 3) m about the hips, camera axes: x right, y down, z forward.
    """

    points: FloatArray
    visibility: FloatArray
    world: FloatArray


Finder = Callable[[Image], Seen | None]
"""Finds one person in pictures that come in turn."""


def choose_model() -> LandmarkModel:
    """Choose the installed model to begin with; `PersonFinder` takes the quickest where that does not keep up.

    Raises KeypointError if no model is installed, MissingExtraError without LiteRT or OpenCV.
    """
    from dousa.estimation.keypoints.pose_models import DETECTOR, check_pose_model, find_pose_model, get_pose_model

    require("cv2", "film")
    require("ai_edge_litert", "film")
    find_pose_model(DETECTOR)
    installed = (name for name in _MODELS if check_pose_model(get_pose_model(name)) == "installed")
    chosen = next(installed, _MODELS[0])
    find_pose_model(chosen)  # raises, with the remedy
    return chosen


def choose_person(rows: NDArray[np.void], last: np.void | None, others: Collection[int] = ()) -> np.void | None:
    """Choose the person to follow among those in a picture (P,) of `SIGHTING`; None if there is nobody.

    That is who was followed in the ``last`` picture, or else who is nearest to there, but none of the stretches
    ``others``, who were seen beside that person; at first who looks largest.
    """
    if last is not None:
        rows = rows[~np.isin(rows["stretch"], list(others))]
    if not len(rows):
        return None
    if last is None:
        place = int(rows["crop"][:, 2].argmax())
    else:
        away = np.hypot(*(rows["crop"][:, :2] - last["crop"][:2]).T)
        place = int(np.where(rows["stretch"] == last["stretch"], -1.0, away).argmin())
    chosen: np.void = rows[place]
    return chosen


class PersonFinder:
    """Finds one person in pictures that come in turn, though another may walk past; errors as `choose_model`.

    Parameters
    ----------
    rate : pictures a second below which the quickest model takes over, if it is installed; a slower one trails behind
        what is done.
    looks : pictures of which the median time counts.
    lost_for : pictures without that person after which whoever looks largest is followed.
    """

    def __init__(self, *, rate: float = 12.0, looks: int = 12, lost_for: int = 20) -> None:
        self._model = choose_model()
        self._most_s, self._looks, self._lost_for = 1.0 / rate, looks, lost_for
        self._took: list[float] = []
        self._last: np.void | None = None
        self._others: set[int] = set()
        self._n_seen = self._n_lost = 0
        self._open()

    def _open(self) -> None:
        from dousa.estimation.keypoints.people import PeopleFollower
        from dousa.estimation.keypoints.pose_networks import LandmarkNetwork, PersonDetector

        # A second person is followed too, as the crop of the only one would slide to whoever walks past.
        self._follower = PeopleFollower(PersonDetector(None), LandmarkNetwork(self._model, None), 2)

    def __call__(self, picture: Image) -> Seen | None:
        """Find the person in the next picture (H, W, 3) red, green, blue; None if that person is not seen."""
        if len(self._took) == self._looks and np.median(self._took) > self._most_s and self._model != QUICKEST:
            self._hurry()
        begun = time.perf_counter()
        rows = self._follower.see(self._n_seen, picture)
        self._n_seen += 1
        self._took = [*self._took[-self._looks + 1 :], time.perf_counter() - begun]
        row = choose_person(rows, self._last, self._others)
        if row is None:
            self._n_lost += 1
            if self._n_lost > self._lost_for:
                self._last, self._others = None, set()
            return None
        self._n_lost, self._last = 0, row
        self._others |= {*rows["stretch"].tolist()} - {int(row["stretch"])}
        sure = np.clip(np.asarray(row["visibility"], np.float64), 0.0, 1.0)
        return Seen(np.asarray(row["points"], np.float64), sure, np.asarray(row["world"], np.float64))

    def _hurry(self) -> None:
        from dousa.estimation.keypoints.pose_models import check_pose_model, get_pose_model

        self._took = []
        if check_pose_model(get_pose_model(QUICKEST)) == "installed":
            self._model, self._n_seen, self._others = QUICKEST, 0, set()
            if self._last is not None:
                self._last["stretch"] = -1  # a new follower counts from 0 again
            self._open()


def open_finder() -> Finder:
    """Open a finder of one person; errors as `choose_model`."""
    return PersonFinder()


def to_canonical(seen: Seen, size: tuple[int, int]) -> FloatArray:
    """Convert a person in a picture of ``size`` (width, height) px to canonical joints (20, 3), m, Y up.

    The place across the line of sight, on which depend walking and jumping, is that in the picture, at the scale at
    which the landmarks lie on it. Along it the scale says less than nothing (lab/notes/evaluation.md): it stays 0.
    Raises InvalidMotionError for landmarks that are not a person.
    """
    from dousa.estimation import MEDIAPIPE_NAMES
    from dousa.motion import Trajectories, canonicalise

    found = canonicalise(Trajectories(MEDIAPIPE_NAMES, seen.world[None] * (1.0, -1.0, -1.0), 1.0))  # any rate will do
    points = np.array(found.positions[0])
    if any(one.code == "canonical.mirrored" for one in found.warnings):  # one frame cannot tell
        points[:, 2] *= -1.0
    flat = seen.world[:, :2]
    centre, middle = (np.average(some, axis=0, weights=seen.visibility) for some in (flat, seen.points))
    spread = seen.visibility[:, None] * (flat - centre)
    scale = (spread * (seen.points - middle)).sum() / (spread * (flat - centre)).sum()
    points[:, :2] += ((middle - np.divide(size, 2.0)) / max(scale, 1.0) - centre) * (1.0, -1.0)  # a person has many px
    return points


@dataclass(slots=True)
class _Graded:
    """The performance so far, what is known of its last pose, and the grade of its last seconds."""

    assessor: IncrementalAssessor
    begun: float = 0.0  # s, by the camera's clock
    state: FrameState | None = None
    score: float | None = None
    asked: float = 0.0


class LiveSession:
    """One camera.

    Parameters
    ----------
    finder : see `open_finder`.
    library : labels the motion if it is trained.
    references : takes with which the performance is compared; without any nothing is graded.
    send : is given the canonical joints (20, 3), m, of each picture.
    rate : Hz, at which the performance is compared, whatever the rate of the pictures; a higher one takes longer.
    grade_every : s between two grades.
    """

    def __init__(
        self,
        finder: Finder,
        library: Library,
        references: Sequence[CanonicalMotion],
        send: Callable[[FloatArray], None] = lambda points: None,
        *,
        rate: float = 15.0,
        grade_every: float = 3.0,
    ) -> None:
        self._rate, self._grade_every = rate, grade_every
        self.id = secrets.token_hex(8)
        self.used = time.monotonic()
        self._finder, self._library, self._references = finder, library, tuple(references)
        self._send = send
        self._lock = threading.Lock()
        self._labeller: LiveLabeller | None = None
        self._label: dict[str, Any] | None = None
        self._label_problem: Message | None = None
        self._last: tuple[float, FloatArray] | None = None
        self._graded = self._begin_grade()
        self._learning = threading.Thread(target=self._learn, daemon=True)
        self._learning.start()

    def _learn(self) -> None:
        """Open the labeller, which takes a while if it must be trained."""
        try:
            self._labeller = self._library.live()
        except DousaError as error:
            self._label_problem = error.message

    def _begin_grade(self) -> _Graded | None:
        from dousa.evaluation import IncrementalAssessor

        references = list(self._references)
        return _Graded(IncrementalAssessor(references, self._rate)) if references else None

    def see(self, picture: Image, seconds: float) -> dict[str, Any]:
        """Process the next picture.

        Parameters
        ----------
        picture : (H, W, 3) red, green, blue.
        seconds : time of the camera, s; later than that of the picture before.

        Returns
        -------
        ``person``: ``points`` [[x, y], ...] in shares of width and height and ``visibility``, null if there is none;
            ``label``, ``grade``; ``ms``: time of each step.
        """
        with self._lock:
            self.used = begun = time.monotonic()
            seen, size = self._finder(picture), (picture.shape[1], picture.shape[0])
            found = time.monotonic()
            if seen is not None:
                self._take(seen, size, seconds)
            return {
                "person": None if seen is None else _describe(seen, size),
                "label": self._describe_label(),
                "grade": self._describe_grade(),
                "ms": {
                    "keypoints": round(1000 * (found - begun), 1),
                    "judging": round(1000 * (time.monotonic() - found), 1),
                },
            }

    def _take(self, seen: Seen, size: tuple[int, int], seconds: float) -> None:
        if not np.isfinite([seen.world.sum(), seen.points.sum()]).all() or float(np.median(seen.visibility)) < 0.3:
            return
        try:
            points = to_canonical(seen, size)
        except DousaError:  # such as a person half outside of the picture
            return
        self._send(points)
        # s without a person, after which label and grade start again
        if self._last is not None and not 0 < seconds - self._last[0] <= 1.5:
            self._begin_anew()
        self._push_label(points, seconds)
        self._push_grade(points, seconds)
        self._last = seconds, points

    def _begin_anew(self) -> None:
        self._last = None
        self._graded = self._begin_grade()
        if self._labeller is not None:
            self._labeller = self._library.live()

    # --- the label

    def _push_label(self, points: FloatArray, seconds: float) -> None:
        if self._labeller is None:
            return
        try:
            answer = self._labeller.push(points, seconds)
        except DousaError:
            self._labeller = self._library.live()
            return
        if answer is not None:
            self._label = answer.to_json()

    def _describe_label(self) -> dict[str, Any]:
        if self._label_problem is not None:
            return {"state": "none", "problem": self._label_problem}
        if self._labeller is None:
            return {"state": "learning"}
        return {"state": "ready", **(self._label or {"category": None, "confidence": None, "settled": []})}

    # --- the grade

    def _push_grade(self, points: FloatArray, seconds: float) -> None:
        """Resample the joints linearly to one rate."""
        graded = self._graded
        if graded is None:
            return
        if self._last is None:
            graded.begun, graded.state = seconds, graded.assessor.push(points)
            return
        before, last = self._last
        while (at := graded.begun + graded.assessor.n_frames / self._rate) <= seconds:
            graded.state = graded.assessor.push(last + (points - last) * ((at - before) / (seconds - before)))
        if time.monotonic() - graded.asked > self._grade_every:
            score = graded.assessor.grade
            graded.asked = time.monotonic()
            # After the end of the reference the last grade stays.
            graded.score = graded.score if np.isnan(score) else score

    def _describe_grade(self) -> dict[str, Any] | None:
        graded = self._graded
        if graded is None:
            return None
        from dousa.evaluation.live.assessor import WINDOW_S
        from dousa.evaluation.words import describe_segments

        state = graded.state
        wrong, matched_s = ((), np.nan) if state is None else (state.wrong, state.matched_time_s)
        return {
            "score": None if graded.score is None else round(graded.score, 1),
            "seconds": round(min(graded.assessor.n_frames / self._rate, WINDOW_S), 2),
            "wrong": list(wrong),
            "wrong_names": describe_segments(wrong, get_language()) if wrong else "",
            "lag_ms": None if state is None or not np.isfinite(state.lag_ms) else round(state.lag_ms),
            "matched_s": None if not np.isfinite(matched_s) else round(matched_s, 2),
        }


def _describe(seen: Seen, size: tuple[int, int]) -> dict[str, Any]:
    points = np.where(np.isfinite(seen.points), (seen.points + 0.5) / size, -1.0)
    return {"points": points.round(4).tolist(), "visibility": seen.visibility.round(2).tolist()}


class Live:
    """The current session; a new one ends the one before."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._now: LiveSession | None = None

    def begin(self, session: LiveSession) -> None:
        """Begin a session."""
        with self._lock:
            self._now = session

    def get(self, session_id: str) -> LiveSession:
        """Return a session by number; RefusedError if it has ended."""
        with self._lock:
            # s without a question after which a session ends
            if self._now is not None and time.monotonic() - self._now.used > 60.0:
                self._now = None
            if self._now is None or self._now.id != session_id:
                raise RefusedError(404, "studio_live.over")
            return self._now

    def end(self, session_id: str) -> None:
        """End a session."""
        with self._lock:
            if self._now is not None and self._now.id == session_id:
                self._now = None


def find_problem(home: Path) -> Message | None:
    """Tell why people cannot be found in pictures here; None if they can."""
    try:
        choose_model()
    except DousaError as error:
        return name_error(error, home)
    return None
