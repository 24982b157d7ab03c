"""The time-series correlation matrix S of two long motions.

    python -m lab.benchmarks.correlation_matrix [--frames N]

Postures are made at random. Peers:

- BLAS: three single-precision matrix products (real part, imaginary part, height) and numpy for the rest; with all
  memory held beforehand, in tiles that stay in the cache, and as anyone would write it;
- numpy einsum (with its optimiser), complex.

Ours gives fresh memory each time.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from dousa.evaluation import compute_correlation_matrix
from lab.benchmarks.timing import Row, run, take_turns


def make_postures(n_frames: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(n_frames, 9, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Blas:
    """S by three matrix products."""

    def __init__(self, a: np.ndarray, b: np.ndarray) -> None:
        z, x, y = (np.asarray(a[:, :, axis] / 9.0, np.float32) for axis in (2, 0, 1))
        self.along, self.across, self.up = np.hstack([z, x]), np.hstack([x, -z]), y
        z, x, y = (np.asarray(b[:, :, axis], np.float32) for axis in (2, 0, 1))
        self.horizontal, self.vertical = np.ascontiguousarray(np.hstack([z, x]).T), np.ascontiguousarray(y.T)
        self.first, self.second = np.empty((2, len(a), len(b)), np.float32)

    def held(self) -> np.ndarray:
        first, second = self.first, self.second
        np.matmul(self.along, self.horizontal, out=first)
        np.matmul(self.across, self.horizontal, out=second)
        np.multiply(first, first, out=first)
        np.multiply(second, second, out=second)
        np.add(first, second, out=first)
        np.sqrt(first, out=first)
        np.matmul(self.up, self.vertical, out=second)
        return np.add(first, second, out=first)

    def tiled(self, tile: int = 64) -> np.ndarray:
        """A few rows at a time, so that the parts stay in the cache."""
        out, part = self.first, self.second[:tile]
        for start in range(0, len(out), tile):
            rows = slice(start, start + tile)
            row, spare = out[rows], part[: len(out[rows])]
            np.matmul(self.along[rows], self.horizontal, out=row)
            np.matmul(self.across[rows], self.horizontal, out=spare)
            np.multiply(row, row, out=row)
            np.multiply(spare, spare, out=spare)
            np.add(row, spare, out=row)
            np.sqrt(row, out=row)
            np.matmul(self.up[rows], self.vertical, out=spare)
            np.add(row, spare, out=row)
        return out

    def plain(self) -> np.ndarray:
        along, across = self.along @ self.horizontal, self.across @ self.horizontal
        return np.sqrt(along * along + across * across) + self.up @ self.vertical


def by_einsum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = ((s[..., 2] + 1j * s[..., 0]).astype(np.complex64) for s in (a, b))
    heights = (s[..., 1].astype(np.float32) for s in (a, b))
    horizontal = np.einsum("tp,up->tu", first, second.conj(), optimize=True)
    return (np.abs(horizontal) + np.einsum("tp,up->tu", *heights, optimize=True)) / 9.0


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    a, b = make_postures(options.frames, 0), make_postures(options.frames, 1)
    blas = Blas(a, b)
    worst = float(np.abs(blas.held()[:100] - compute_correlation_matrix(a[:100], b)).max())
    peers = {
        "BLAS, memory held, in tiles": blas.tiled,
        "BLAS, plain": blas.plain,
        "numpy einsum": lambda: by_einsum(a, b),
    }
    found = take_turns({"ours": lambda: compute_correlation_matrix(a, b), **peers}, options.repeats)
    for name in peers:
        work = f"correlation matrix, {options.frames:,} x {options.frames:,} frames x 9 segments"
        yield Row(work, found["ours"], name, found[name], note=f"largest difference to BLAS {worst:.0e}")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--frames", type=int, default=10_000)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
