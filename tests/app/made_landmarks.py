"""Keypoints of made-up people: the names that a network gives, and the points of the body that stand for them."""

from dousa.estimation import MEDIAPIPE_NAMES

_HANDS = {"foot_index": "toe", "index": "hand", "pinky": "hand"}
NAMES = tuple(name for name in MEDIAPIPE_NAMES if not any(word in name for word in ("eye", "mouth", "thumb")))
OWN = tuple(next((name.replace(a, b) for a, b in _HANDS.items() if name.endswith(a)), name) for name in NAMES)
