"""The dense product."""

import numpy as np
import warp as wp

from defgrasp_ros.simulation.dense import multiply_rows, multiply_rows_by_tiles


def test_kernel_for_the_gpu_agrees_with_blas():
    """Both give rows @ matrix, also for sizes that fill no tile."""
    random = np.random.default_rng(7)
    square, rows = random.normal(size=(70, 70)), random.normal(size=(37, 70))
    matrix, left = (wp.array(a, dtype=wp.float64, device="cpu") for a in (square + square.T, rows))
    for product in (multiply_rows, multiply_rows_by_tiles):
        out = wp.zeros((37, 70), dtype=wp.float64, device="cpu")
        product(37, left, matrix, out)
        np.testing.assert_allclose(out.numpy(), rows @ (square + square.T), rtol=1e-12, atol=1e-10)
