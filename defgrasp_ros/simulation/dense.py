"""The one big dense product of the simulation: BLAS on the CPU, a tiled kernel on CUDA."""

from __future__ import annotations

import numpy as np
import warp as wp

from defgrasp_ros.simulation.rows import RowList, Rows

TILE = wp.constant(32)
TILE_DEPTH = wp.constant(16)
TILE_THREADS = 128

wp.set_module_options({"enable_backward": False, "block_dim": TILE_THREADS})


def multiply_rows(rows: RowList, left: wp.array, matrix: wp.array, out: wp.array) -> None:
    """out = left @ matrix in as many rows as there are worlds, with a symmetric matrix.

    Args:
        rows: Worlds.
        left: First factor, shape ``(row, n)``.
        matrix: Second factor, shape ``(n, n)``.
        out: Product, shape ``(row, n)``.
    """
    if rows.stays_on_device:
        multiply_rows_by_tiles(rows, left, matrix, out)
    else:
        np.matmul(left.numpy()[: rows.count], matrix.numpy(), out=out.numpy()[: rows.count])


def multiply_rows_by_tiles(rows: RowList, left: wp.array, matrix: wp.array, out: wp.array) -> None:
    """The same as a Warp kernel; it runs on any device, and is fast on CUDA alone."""
    blocks = (-(-rows.count // TILE), -(-matrix.shape[0] // TILE))
    inputs = [rows.device, left, matrix]
    wp.launch_tiled(
        _tiled_product, dim=blocks, inputs=inputs, outputs=[out], block_dim=TILE_THREADS, device=left.device
    )


@wp.kernel
def _tiled_product(
    rows: Rows,
    a: wp.array2d[wp.float64],  # (row, n)
    b: wp.array2d[wp.float64],  # (n, n)
    out: wp.array2d[wp.float64],  # (row, n)
):
    """out = a @ b, one tile of out per block; edges are padded with zeros, tiles beyond the last row left alone."""
    i, j = wp.tid()
    if i * TILE >= rows.count[0]:
        return
    total = wp.tile_zeros(shape=(TILE, TILE), dtype=wp.float64)
    for k in range((b.shape[0] + TILE_DEPTH - 1) // TILE_DEPTH):
        left = wp.tile_load(a, shape=(TILE, TILE_DEPTH), offset=(i * TILE, k * TILE_DEPTH))
        right = wp.tile_load(b, shape=(TILE_DEPTH, TILE), offset=(k * TILE_DEPTH, j * TILE))
        wp.tile_matmul(left, right, total)
    wp.tile_store(out, total, offset=(i * TILE, j * TILE))
