"""Dense linear algebra on the simulation's device: BLAS and LAPACK on the CPU, kernels on CUDA.

The products are the same in both; only who computes them differs. ``HostAlgebra`` works on the memory of the Warp
arrays without copying.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

TILE = wp.constant(32)
TILE_DEPTH = wp.constant(16)
TILE_THREADS = 128


class HostAlgebra:
    """NumPy on zero-copy views of CPU arrays."""

    def multiply_rows(self, rows: wp.array, matrix: wp.array, out: wp.array) -> None:
        """out = rows @ matrix, with a symmetric matrix; shapes ``(row, n)``, ``(n, n)``, ``(row, n)``."""
        np.matmul(rows.numpy(), matrix.numpy(), out=out.numpy())

    def invert(self, matrix: wp.array, worlds: np.ndarray, sizes: np.ndarray, shift: np.ndarray, out: wp.array) -> None:
        """out[w] = (matrix[w] + shift[w] I)^-1 of the leading ``sizes[w]`` rows, for each of ``worlds``."""
        source, target = matrix.numpy(), out.numpy()
        for w in worlds:
            n = sizes[w]
            if n:
                shifted = source[w, :n, :n].copy()
                shifted[np.diag_indices(n)] += shift[w]
                target[w, :n, :n] = np.linalg.inv(shifted)

    def world_product(
        self, matrix: wp.array, worlds: wp.array, sizes: np.ndarray, done: wp.array, vector: wp.array, out: wp.array
    ) -> Callable[[], None]:
        """Return a call that does out[i] = matrix[worlds[i]] @ vector[i] on the leading ``sizes[worlds[i]]`` rows,
        where ``done[i]`` is 0 at the time of the call."""
        matrices, x, y, flags = matrix.numpy(), vector.numpy(), out.numpy(), done.numpy()
        blocks = [
            (matrices[w, : sizes[w], : sizes[w]], x[i, : sizes[w]], y[i, : sizes[w]])
            for i, w in enumerate(worlds.numpy())
        ]

        def multiply() -> None:
            for flag, (block, column, product) in zip(flags, blocks, strict=True):
                if not flag:
                    np.dot(block, column, out=product)

        return multiply


class DeviceAlgebra:
    """The same products as Warp kernels; runs on any device, meant for CUDA."""

    def multiply_rows(self, rows: wp.array, matrix: wp.array, out: wp.array) -> None:
        """See :class:`HostAlgebra`."""
        blocks = (-(-rows.shape[0] // TILE), -(-matrix.shape[0] // TILE))
        wp.launch_tiled(
            _tiled_product, dim=blocks, inputs=[rows, matrix], outputs=[out], block_dim=TILE_THREADS, device=rows.device
        )

    def invert(self, matrix: wp.array, worlds: np.ndarray, sizes: np.ndarray, shift: np.ndarray, out: wp.array) -> None:
        """See :class:`HostAlgebra`."""
        device = matrix.device
        some = wp.array(worlds, dtype=int, device=device)
        size = wp.array(sizes, dtype=int, device=device)
        largest = int(sizes[worlds].max(initial=0))
        if largest == 0:
            return
        pivot_row = wp.empty((len(worlds), largest), dtype=wp.float64, device=device)
        pivot_column = wp.empty_like(pivot_row)
        shifts = wp.array(shift, dtype=wp.float64, device=device)
        square = (len(worlds), largest, largest)
        wp.launch(_shifted_copy, dim=square, inputs=[some, size, shifts, matrix], outputs=[out], device=device)
        for k in range(largest):
            wp.launch(
                _take_pivot,
                dim=(len(worlds), largest),
                inputs=[some, size, k, out, pivot_row, pivot_column],
                device=device,
            )
            wp.launch(_eliminate, dim=square, inputs=[some, size, k, pivot_row, pivot_column, out], device=device)

    def world_product(
        self, matrix: wp.array, worlds: wp.array, sizes: np.ndarray, done: wp.array, vector: wp.array, out: wp.array
    ) -> Callable[[], None]:
        """See :class:`HostAlgebra`."""
        size = wp.array(sizes, dtype=int, device=matrix.device)
        command = wp.launch(
            _batched_product,
            dim=(worlds.shape[0], vector.shape[1]),
            inputs=[worlds, size, done, matrix, vector],
            outputs=[out],
            device=matrix.device,
            record_cmd=True,
        )
        return command.launch


def algebra_for(device: wp.Device) -> HostAlgebra | DeviceAlgebra:
    """Return the implementation for a device."""
    return DeviceAlgebra() if device.is_cuda else HostAlgebra()


@wp.kernel
def _tiled_product(
    a: wp.array2d[wp.float64],  # (row, n)
    b: wp.array2d[wp.float64],  # (n, n)
    out: wp.array2d[wp.float64],  # (row, n)
):
    """out = a @ b, one tile of out per block; edges are padded with zeros."""
    i, j = wp.tid()
    total = wp.tile_zeros(shape=(TILE, TILE), dtype=wp.float64)
    for k in range((b.shape[0] + TILE_DEPTH - 1) // TILE_DEPTH):
        left = wp.tile_load(a, shape=(TILE, TILE_DEPTH), offset=(i * TILE, k * TILE_DEPTH))
        right = wp.tile_load(b, shape=(TILE_DEPTH, TILE), offset=(k * TILE_DEPTH, j * TILE))
        wp.tile_matmul(left, right, total)
    wp.tile_store(out, total, offset=(i * TILE, j * TILE))


@wp.kernel
def _shifted_copy(
    worlds: wp.array[int],
    size: wp.array[int],  # (world,)
    shift: wp.array[wp.float64],  # (world,)
    matrix: wp.array3d[wp.float64],  # (world, n, n)
    out: wp.array3d[wp.float64],
):
    """out = matrix + shift I on the leading rows."""
    i, r, c = wp.tid()
    w = worlds[i]
    if r < size[w] and c < size[w]:
        value = matrix[w, r, c]
        if r == c:
            value += shift[w]
        out[w, r, c] = value


@wp.kernel
def _take_pivot(
    worlds: wp.array[int],
    size: wp.array[int],  # (world,)
    k: int,
    matrix: wp.array3d[wp.float64],  # (world, n, n)
    pivot_row: wp.array2d[wp.float64],  # (row, n)
    pivot_column: wp.array2d[wp.float64],
):
    """Keep row and column k of step k, before they are overwritten."""
    i, r = wp.tid()
    w = worlds[i]
    if k < size[w] and r < size[w]:
        pivot_row[i, r] = matrix[w, k, r]
        pivot_column[i, r] = matrix[w, r, k]


@wp.kernel
def _eliminate(
    worlds: wp.array[int],
    size: wp.array[int],  # (world,)
    k: int,
    pivot_row: wp.array2d[wp.float64],  # (row, n)
    pivot_column: wp.array2d[wp.float64],
    matrix: wp.array3d[wp.float64],  # (world, n, n), in and out
):
    """Step k of the in-place Gauss-Jordan inverse; a positive definite matrix needs no pivoting."""
    i, r, c = wp.tid()
    w = worlds[i]
    if k >= size[w] or r >= size[w] or c >= size[w]:
        return
    pivot = wp.float64(1.0) / pivot_row[i, k]
    if r == k and c == k:
        matrix[w, r, c] = pivot
    elif r == k:
        matrix[w, r, c] = pivot_row[i, c] * pivot
    elif c == k:
        matrix[w, r, c] = -pivot_column[i, r] * pivot
    else:
        matrix[w, r, c] = matrix[w, r, c] - pivot_column[i, r] * pivot_row[i, c] * pivot


@wp.kernel
def _batched_product(
    worlds: wp.array[int],
    size: wp.array[int],  # (world,)
    done: wp.array[int],  # (row,)
    matrix: wp.array3d[wp.float64],  # (world, n, n)
    vector: wp.array2d[wp.float64],  # (row, n)
    out: wp.array2d[wp.float64],  # (row, n)
):
    """out[i] = matrix[worlds[i]] @ vector[i]."""
    i, r = wp.tid()
    w = worlds[i]
    if done[i] != 0 or r >= size[w]:
        return
    total = wp.float64(0.0)
    for c in range(size[w]):
        total += matrix[w, r, c] * vector[i, c]
    out[i, r] = total
