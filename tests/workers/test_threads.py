"""Pieces of work in threads: answers in order, however many threads, and errors as they are."""

import joblib
import pytest

from dousa.workers.threads import map_pieces, map_together


@pytest.mark.parametrize("n_jobs", [None, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 16, 17, 50])
def test_answers_come_in_the_order_of_the_pieces(n_jobs, count):
    assert map_pieces(lambda number: number**2, range(count), n_jobs) == [number**2 for number in range(count)]


def test_threads_of_the_configuration_are_used():
    with joblib.parallel_config("threading", n_jobs=2):
        assert map_pieces(str, range(5), at_a_time=1) == list("01234")


def test_an_error_in_a_thread_is_raised():
    with pytest.raises(ZeroDivisionError):
        map_pieces(lambda number: 1 / (number - 20), range(40), 2)


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_pieces_of_one_size_come_together(n_jobs):
    pieces, portions = ["a", "bb", "c", "dd", "e", "f"], []

    def shout(some):
        portions.append(some)
        return (piece.upper() for piece in some)

    found = map_together(shout, pieces, [len(piece) for piece in pieces], n_jobs, at_a_time=2)
    assert found == ["A", "BB", "C", "DD", "E", "F"]
    assert sorted(portions) == [["a", "c"], ["bb", "dd"], ["e", "f"]]
    assert map_together(shout, [], [], n_jobs) == []
