"""Parts are compiled into kernels, for numbers once, and run nowhere else."""

import pickle
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit

from dousa import kernel_compiler, kernels
from dousa.kernels import kernel, part
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.features.sensor_noise import measure_unsteadiness, reduce_noise
from dousa.retrieval.ranking.ranking import compute_with_poses
from dousa.retrieval.words.relations import find_relations


@part
def greater(a, b):
    return a if a > b else b


@part
def double_greater(a, b):
    return greater(a, b) + greater(b, a)


@kernel
def shift(values, out):
    for t in range(len(values)):
        out[t] = double_greater(values[greater(t - 2, 0)], 0.5) / values[0]


def test_who_waits_is_told_what_is_compiled(monkeypatch):
    seen = []
    monkeypatch.setattr(kernel_compiler.CPUDispatcher, "compile", lambda made, sig: seen.append([*kernels.under_way]))
    made = kernel_compiler.compile_kernel(shift.py_func, kernels.under_way, False, False)
    for is_kept in (False, True):
        monkeypatch.setattr(type(made), "is_kept", lambda self, known=is_kept: known)
        made.compile(())
    assert seen == [["shift"], []] and not kernels.under_way


def test_a_kernel_does_what_its_parts_say():
    values = np.linspace(0.0, 1.0, 9)
    out = np.empty(9)
    shift(values, out)
    assert np.isinf(out).all()  # as NumPy divides
    shift(values + 1.0, out)
    np.testing.assert_array_equal(out, 2 * np.maximum((values + 1.0)[np.maximum(np.arange(9) - 2, 0)], 0.5))


@kernel(allocates=True)
def shift_anew(values):
    out = np.empty(len(values))
    shift(values, out)
    for t in range(len(values)):
        out[t] = greater(out[t], values[t])
    return out


def test_a_kernel_can_call_another_and_make_arrays():
    values = np.linspace(1.0, 2.0, 9)
    out = np.empty(9)
    shift(values, out)
    np.testing.assert_array_equal(shift_anew(values), np.maximum(out, values))


def test_a_part_is_compiled_once_for_constants_and_for_what_is_computed():
    def call_parts(number):
        return greater(number, 0) + greater(3, number) + greater(0.0, 0.5)

    call_it = kernel_compiler._Kernel(  # not kept: the part is compiled now
        call_parts,
        targetoptions=kernel_compiler._options(False, False),
        pipeline_class=kernel_compiler._KernelCompiler,
    )
    call_it.under_way = []
    assert call_it(2) == 5.5
    assert [str(kinds) for kinds in greater.overloads] == ["(int64, int64)", "(float64, float64)"]


def test_code_that_is_no_kernel_cannot_call_a_part():
    @njit
    def call_it(number):
        return greater(number, 0.5)

    with pytest.raises(TypeError, match="into kernels alone"):
        call_it(2.0)


def test_python_cannot_call_a_part():
    with pytest.raises(TypeError, match="greater is a part of kernels"):
        greater(1, 2)
    shift(np.ones(3), np.empty(3))
    with pytest.raises(TypeError, match="greater is a part of kernels"):
        greater(1, 2)


def test_a_kernel_is_pickled_by_its_name():
    assert pickle.loads(pickle.dumps(shift)) is shift


def test_numba_is_loaded_with_the_first_kernel_that_runs():
    program = "import sys, dousa.kernels as k; f = k.kernel(abs); assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)


PROGRAM = """
import sys
import numpy as np
from dousa.kernels import kernel

@kernel(linear=True)
def double(values, out):
    for t in range(len(values)):
        out[t] = 2.0 * values[t]

values, out, count = np.linspace(0.0, 1.0, 100_000), np.empty(100_000), 0
while "numba" not in sys.modules:
    double(values, out)
    count += 1
    assert (out == 2.0 * values).all() and count < 1000
assert count > 1
"""


def test_small_work_is_interpreted_until_compiling_would_have_cost_as_much(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    subprocess.run([sys.executable, tmp_path / "program.py"], check=True)


@pytest.mark.parametrize("n_frames", [3, 40])
def test_what_describes_clips_is_the_same_interpreted(monkeypatch, n_frames):
    chance = np.random.default_rng(n_frames)
    walk = canonicalise(compute_trajectories(make_motion("walk", draw_performer(0)))).positions[:n_frames]
    clip = SimpleNamespace(positions=walk + chance.normal(0.0, 0.01, walk.shape), frame_rate=30.0, height=1.7)
    extended = FEATURE_SETS["extended"]
    examples = extended.compute(clip) * chance.normal(1.0, 0.5, (30, 1, 1))
    forest = MotionForest(n_trees=9, random_state=0).fit(examples, np.arange(30) % 3, feature_set=extended)

    def describe():
        quiet = reduce_noise(clip)
        features = compute_with_poses([quiet], extended)
        leaves = forest.apply(np.concatenate([features[0], examples]).astype(np.float32))
        arrays = *features, leaves, forest.histograms_of(leaves), quiet.positions
        return arrays, measure_unsteadiness(clip), find_relations(clip)

    compiled = describe()
    monkeypatch.setattr(kernels._depth, "interpreting", True)
    with np.errstate(all="ignore"):
        found = describe()
    for one, other in zip(compiled[0], found[0], strict=True):
        np.testing.assert_array_equal(one, other)
    assert compiled[1:] == found[1:]
