"""Dense matrices of 3 x 3 blocks, one per row of a batch: products, and factors without exchange of rows.

A matrix is an array (row, i, j) of blocks, a vector an array (row, i). With blocks this small, elimination runs at the
speed of a library on a processor, for all rows of the batch in one launch.
"""

from typing import Any

import warp as wp

from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})


@wp.func
def multiply_symmetric(
    matrix: wp.array3d[mat33d], m: int, count: int, x: wp.array2d[vec3d], y: wp.array2d[vec3d], row: int
):
    """y = A x of ``row``, with the leading ``count`` blocks of the symmetric matrix ``m``, of which it reads half."""
    for i in range(count):
        y[row, i] = matrix[m, i, i] * x[row, i]
    for i in range(count):
        own = x[row, i]
        total = y[row, i]
        for j in range(i + 1, count):
            block = matrix[m, i, j]
            total += block * x[row, j]
            y[row, j] = y[row, j] + own * block
        y[row, i] = total


@wp.func
def factorise(matrix: wp.array3d[mat33d], row: int, count: int):
    """Replace A by L U with unit L; the diagonal keeps the inverses of U's blocks."""
    for k in range(count):
        inverse = wp.inverse(matrix[row, k, k])
        matrix[row, k, k] = inverse
        for i in range(k + 1, count):
            factor = matrix[row, i, k] * inverse
            matrix[row, i, k] = factor
            for j in range(k + 1, count):
                matrix[row, i, j] = matrix[row, i, j] - factor * matrix[row, k, j]


@wp.func
def solve_factorised(matrix: wp.array3d[mat33d], m: int, count: int, x: wp.array2d[Any], row: int, first: int):
    """Replace the right-hand side x of ``row``, of vectors or blocks, by A^-1 x, after ``factorise`` of matrix ``m``.

    Entries of the right-hand side before ``first`` are 0.
    """
    for i in range(first + 1, count):
        total = x[row, i]
        for j in range(first, i):
            total -= matrix[m, i, j] * x[row, j]
        x[row, i] = total
    for n in range(count):
        i = count - 1 - n
        total = x[row, i]
        for j in range(i + 1, count):
            total -= matrix[m, i, j] * x[row, j]
        x[row, i] = matrix[m, i, i] * total
