"""Pieces of work in threads: answers in order, however many threads, and errors as they are."""

import joblib
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from dousa.workers.threads import limit_blas, map_pieces, map_together, yield_answers


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


def _count_threads(_=None):
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_answers_are_yielded_in_order_and_some_may_stay(n_jobs):
    answers = yield_answers(lambda number: number**2, range(9), n_jobs)
    assert [next(answers) for _ in range(3)] == [0, 1, 4]
    answers.close()


def test_blas_has_one_thread_while_ours_work():
    with threadpool_limits(2, user_api="blas"):
        assert map_pieces(_count_threads, range(2)) == [{1}, {1}]
        assert set().union(*map_pieces(_count_threads, range(4), 2, 1)) == {1}
        assert set().union(*yield_answers(_count_threads, range(4), 2)) == {1}
        assert _count_threads() == {2}


def test_blocks_that_limit_blas_may_overlap():
    with threadpool_limits(2, user_api="blas"):
        first, second = limit_blas(), limit_blas()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert _count_threads() == {1}
        second.__exit__(None, None, None)
        assert _count_threads() == {2}
