"""Dense matrices of 3 x 3 blocks, one per row of a batch: products, and factors without exchange of rows.

A vector is an array (row, i) of blocks, a matrix an array (row, i, j). Of a symmetric matrix there is only the upper
half, row after row without gaps, as an array (row, place): a batch fits no cache, and what is read from memory sets
the time. With blocks this small, elimination runs at the speed of a library on a processor, for all rows of the batch
in one launch.
"""

from typing import Any

import warp as wp

from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})


# --- symmetric matrices -----------------------------------------------------------------------------------------------


def half_size(count: int) -> int:
    """Return how many blocks the upper half of a symmetric matrix of ``count`` rows of blocks has."""
    return count * (count + 1) // 2


@wp.func
def place_in_half(i: int, j: int, count: int) -> int:
    """Place of block (i, j) with i <= j in the upper half of a matrix of ``count`` rows of blocks."""
    return i * count - (i * (i + 1)) // 2 + j


@wp.func
def block_of_symmetric(half: wp.array2d[mat33d], m: int, i: int, j: int, count: int) -> mat33d:
    """Return block (i, j) of the symmetric matrix ``m`` of ``count`` rows of blocks."""
    if i <= j:
        return half[m, place_in_half(i, j, count)]
    return wp.transpose(half[m, place_in_half(j, i, count)])


@wp.func
def multiply_symmetric(
    half: wp.array2d[mat33d], m: int, count: int, x: wp.array2d[vec3d], y: wp.array2d[vec3d], row: int
):
    """y = A x of ``row``, with the symmetric matrix ``m`` of ``count`` rows of blocks."""
    for i in range(count):
        y[row, i] = vec3d()
    place = int(0)
    for i in range(count):
        own = x[row, i]
        total = y[row, i] + half[m, place] * own
        place += 1
        for j in range(i + 1, count):
            block = half[m, place]
            total += block * x[row, j]
            y[row, j] = y[row, j] + own * block
            place += 1
        y[row, i] = total


@wp.func
def eliminate_symmetric(half: wp.array2d[mat33d], m: int, count: int, pivots: int):
    """Eliminate the first ``pivots`` unknowns of a symmetric matrix, positive definite in them.

    Their rows become those of U in A = U^T D U, with unit U, and inverses of the blocks of D on the diagonal. The other
    rows become the Schur complement.
    """
    for k in range(pivots):
        pivot = place_in_half(k, 0, count)
        inverse = wp.inverse(half[m, pivot + k])
        half[m, pivot + k] = inverse
        for i in range(k + 1, count):
            factor = wp.transpose(half[m, pivot + i]) * inverse
            begin = place_in_half(i, 0, count)
            for j in range(i, count):
                half[m, begin + j] = half[m, begin + j] - factor * half[m, pivot + j]
        for j in range(k + 1, count):
            half[m, pivot + j] = inverse * half[m, pivot + j]


@wp.func
def substitute_forwards(
    half: wp.array2d[mat33d], m: int, count: int, pivots: int, x: wp.array2d[Any], row: int, first: int
):
    """Replace x by U^-T x, with the rows of U that ``eliminate_symmetric`` made; entries before ``first`` are 0.

    From the other rows it takes what the eliminated unknowns contribute to them.
    """
    for i in range(first, pivots):
        own = x[row, i]
        begin = place_in_half(i, 0, count)
        for j in range(i + 1, count):
            x[row, j] = x[row, j] - wp.transpose(half[m, begin + j]) * own


@wp.func
def scale_by_pivots(half: wp.array2d[mat33d], m: int, count: int, pivots: int, x: wp.array2d[Any], row: int):
    """Replace the eliminated unknowns x by D^-1 x."""
    for i in range(pivots):
        x[row, i] = half[m, place_in_half(i, i, count)] * x[row, i]


@wp.func
def substitute_backwards(half: wp.array2d[mat33d], m: int, count: int, pivots: int, x: wp.array2d[Any], row: int):
    """Replace U x by x in the eliminated unknowns; the others are known."""
    for n in range(pivots):
        i = pivots - 1 - n
        begin = place_in_half(i, 0, count)
        total = x[row, i]
        for j in range(i + 1, count):
            total -= half[m, begin + j] * x[row, j]
        x[row, i] = total


# --- any matrices -----------------------------------------------------------------------------------------------------


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
def solve_factorised(matrix: wp.array3d[mat33d], m: int, count: int, x: wp.array2d[vec3d], row: int):
    """Replace the right-hand side x of ``row`` by A^-1 x, after ``factorise`` of matrix ``m``."""
    for i in range(1, count):
        total = x[row, i]
        for j in range(i):
            total -= matrix[m, i, j] * x[row, j]
        x[row, i] = total
    for n in range(count):
        i = count - 1 - n
        total = x[row, i]
        for j in range(i + 1, count):
            total -= matrix[m, i, j] * x[row, j]
        x[row, i] = matrix[m, i, i] * total
