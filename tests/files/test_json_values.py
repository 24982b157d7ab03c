"""Values as JSON has them."""

import json

import numpy as np

from dousa.files.json_values import to_json_value
from dousa.messages import Message


def test_what_json_has_not_becomes_what_it_has():
    value = {
        1: (np.float32(0.5), np.nan, -np.inf),
        "array": np.array([[1.0, np.nan]]),
        "said": [Message("cli.interrupted")],
        "plain": [None, True, "words", 7, 2.5],
    }
    assert to_json_value(value) == {
        "1": [0.5, None, None],
        "array": [[1.0, None]],
        "said": [str(Message("cli.interrupted"))],
        "plain": [None, True, "words", 7, 2.5],
    }
    json.dumps(to_json_value(value), allow_nan=False)
