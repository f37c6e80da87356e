"""The inverse behind the compliance, and that it lets other threads go on."""

from __future__ import annotations

from threading import Event, Thread

import numpy as np
import scipy.linalg

from defgrasp_ros.simulation.lapack import inverse_of_positive_definite


def positive_definite(size: int) -> np.ndarray:
    factor = np.random.default_rng(0).normal(size=(size, size))
    return factor @ factor.T + size * np.eye(size)


def test_inverse_is_that_of_scipy():
    """It is symmetric, the inverse to rounding, and its triangle is bit by bit what SciPy gets from LAPACK."""
    matrix = positive_definite(60)
    inverse = inverse_of_positive_definite(matrix.copy())
    np.testing.assert_array_equal(inverse, inverse.T)
    np.testing.assert_allclose(inverse @ matrix, np.eye(60), atol=1e-12)
    factor, _ = scipy.linalg.lapack.dpotrf(matrix.T, lower=1)
    expected, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
    np.testing.assert_array_equal(np.tril(inverse), np.tril(expected))


def test_indefinite_matrix_has_none():
    """A negative direction, or one without stiffness, is found."""
    for diagonal in ([1.0, -1.0], [1.0, 0.0]):
        assert inverse_of_positive_definite(np.diag(diagonal)) is None


def test_other_threads_go_on_meanwhile():
    """Another thread counts while a matrix is inverted that takes some tenths of a second."""
    done, counts = Event(), []

    def count() -> None:
        while not done.wait(1e-3):
            counts.append(len(counts))

    matrix = positive_definite(1500)
    thread = Thread(target=count)
    thread.start()
    before = len(counts)
    inverse_of_positive_definite(matrix)
    during = len(counts) - before
    done.set()
    thread.join()
    assert during > 5
