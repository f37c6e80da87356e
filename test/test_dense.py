"""The dense product."""

import numpy as np
import warp as wp

from defgrasp_ros.simulation.dense import multiply_rows, multiply_rows_by_tiles
from defgrasp_ros.simulation.rows import RowList


def test_kernel_for_the_gpu_agrees_with_blas():
    """Both give rows @ matrix, also for sizes that fill no tile, and for fewer rows than there is room for."""
    random = np.random.default_rng(7)
    square, rows = random.normal(size=(70, 70)), random.normal(size=(40, 70))
    matrix, left = (wp.array(a, dtype=wp.float64, device="cpu") for a in (square + square.T, rows))
    worlds = RowList(40, wp.get_device("cpu")).assign(np.arange(37))
    for product in (multiply_rows, multiply_rows_by_tiles):
        out = wp.zeros((40, 70), dtype=wp.float64, device="cpu")
        product(worlds, left, matrix, out)
        np.testing.assert_allclose(out.numpy()[:37], rows[:37] @ (square + square.T), rtol=1e-12, atol=1e-10)
