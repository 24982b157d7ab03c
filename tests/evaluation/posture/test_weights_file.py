"""Files of weights: exact names lie over coarse ones, and what cannot be meant is refused in one line."""

from __future__ import annotations

import pytest

from dousa.errors import OptionError
from dousa.evaluation import SEGMENTS, read_weights


@pytest.fixture
def weights(tmp_path):
    def read(text):
        path = tmp_path / "weights.toml"
        path.write_text(text, encoding="utf-8")
        return read_weights(path)

    return read


def test_what_is_not_named_weighs_one(weights):
    assert weights("trunk = 2") == {**dict.fromkeys(SEGMENTS, 1.0), "trunk": 2.0}


@pytest.mark.parametrize(
    "text",
    [
        "left_forearm = 0\nleft_arm = 3\narms = 2\nlegs = 0.5\n",
        "[weights]\narms = 2 # hands\nleft_arm = 3\nlegs = 0.5\nleft_forearm = 0",
        "Left Forearm = 0\nleft-arm = 3\narms = 2\n\nlegs = .5  # no TOML",
    ],
)
def test_exact_names_lie_over_coarse_ones(weights, text):
    found = weights(text)
    assert list(found) == list(SEGMENTS)
    assert found["left_upper_arm"] == 3 and found["left_forearm"] == 0
    assert found["right_upper_arm"] == found["right_forearm"] == 2
    assert {found[name] for name in SEGMENTS if "thigh" in name or "shank" in name} == {0.5}
    assert found["trunk"] == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tail = 1", "'tail' is no segment; there are: arms, legs, left_arm"),
        ("arms = -1", "'arms': expected a weight from 0 to a million, got -1"),
        ("arms = nan", "got nan"),
        ("arms = inf", "got inf"),
        ("arms = true", "got True"),
        ('arms = "much"', "got 'much'"),
        ("arms = 1e9", "a million"),
        ("arms = []", "got []"),
        ("trunk = 0\narms = 0\nlegs = 0", "every segment weighs 0"),
        ("", "expected lines 'segment = number', got none"),
        ("# nothing", "got none"),
        ("arms", ":1: expected 'segment = number', got 'arms'"),
        ("left arm = 2\nleft arm = 3", ":2: 'left arm' is given a second time"),
        ("left_arm = 2\nLEFT_ARM = 3", "given a second time"),
        ("left arm = two", ":1: expected a number for 'left arm', got 'two'"),
        ("left.arm = 2", "'arm' is no segment"),
    ],
)
def test_what_cannot_be_meant_is_refused(weights, text, says):
    with pytest.raises(OptionError) as caught:
        weights(text)
    assert says in str(caught.value) and "weights.toml" in str(caught.value)


def test_files_that_are_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "big").write_bytes(b"#" * 1_000_001)
    for path, says in ((tmp_path / "a", "UTF-8"), (tmp_path / "big", "1 MB"), (tmp_path / "none", "cannot be read"),
                       (tmp_path, "cannot be read")):  # fmt: skip
        with pytest.raises(OptionError, match=says):
            read_weights(path)
