"""Launches that are shared out to several threads."""

import numpy as np
import warp as wp

from defgrasp_ros.simulation.launching import MIN_PIECE, Row, launch_rows


@wp.kernel
def _chaotic(worlds: wp.array[int], start: wp.array[wp.float64], out: wp.array2d[wp.float64]):
    i, n = wp.tid()
    x = start[worlds[i]] + wp.float64(n) * wp.float64(1e-5)
    for _k in range(100):
        x = wp.float64(3.9) * x * (wp.float64(1.0) - x)
    out[i, n] = x


def test_the_number_of_threads_does_not_change_a_bit():
    """One, two and many pieces fill every row, with equal bits, from what belongs to the row's world."""
    rows, columns = 7, MIN_PIECE
    worlds = np.array([8, 0, 3, 5, 1, 2, 9])
    start = wp.array(np.linspace(0.1, 0.2, 10), dtype=wp.float64, device="cpu")
    results = []
    for threads in (1, 2, 5, 100):
        out = wp.full((rows, columns), wp.float64(-1.0), device="cpu")
        inputs = [Row(wp.array(worlds, dtype=int, device="cpu")), start]
        launch_rows(_chaotic, (rows, columns), inputs, [Row(out)], device=wp.get_device("cpu"), threads=threads)
        results.append(out.numpy())
    for other in results[1:]:
        np.testing.assert_array_equal(other, results[0])
    assert len(np.unique(results[0][:, 0])) == rows and results[0].min() >= 0.0
