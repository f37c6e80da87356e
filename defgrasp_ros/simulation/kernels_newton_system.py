"""The linear systems of Newton's method for a contact problem, solved with factors of an earlier one.

With the slope S of ``alart_curnier`` at each contact, 0 where it is open and 1 where it sticks, a direction d obeys

    (1 + S G) d = -Phi,      G = (W + s) / r - (1 - epsilon),

with the scale r, a proximal shift s and a small regularisation epsilon. From one system to the next, also of the next
problem of a world, few slopes change, and W seldom does. So a world keeps its base M = 1 + S_0 G, the system that was
factorised last. For the contacts c whose slopes differ from S_0, by Woodbury's formula,

    d = y - sum_c X_c s_c,   y = -M^-1 Phi,   X_c = M^-1 e_c,   sum_c' (1_cc' + dS_c G_c X_c') s_c' = dS_c G_c y,

where G_c are rows of G. Each X_c is found when it is first needed, and kept as long as the base. Sliding contacts turn
a little all the time: small changes are passed over. What the direction then misses of its system, for this or any
other reason, decides whether it is taken, so factors that are too old cost time and nothing else.
"""

from typing import Any

import warp as wp

from defgrasp_ros.simulation.kernels_alart_curnier import alart_curnier_slope, phi
from defgrasp_ros.simulation.kernels_block_matrix import (
    block_of_symmetric,
    eliminate_symmetric,
    factorise,
    multiply_symmetric,
    solve_factorised,
    substitute_backwards,
    substitute_forwards,
)
from defgrasp_ros.simulation.kernels_coulomb import ContactProblems
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})

REGULARISATION = wp.constant(wp.float64(1e-6))
"""epsilon [-]: neighbouring points can depend on each other, this picks one of the equal solutions."""
COLUMNS = wp.constant(32)
"""Columns of the inverse that a world can keep."""
COLUMN_COST = wp.constant(4)
"""Of new factors, a column costs this part divided by the number of pressed contacts [-]; measured on a processor."""
SLOPE_TOLERANCE = wp.constant(wp.float64(1e-2))
"""Change of a contact's part of the system that is passed over [-]: of a slope, times own compliance over scale."""
LARGEST_DEFECT = wp.constant(wp.float64(5e-2))
"""What a direction from earlier factors may miss of its system, relative to Phi [-]."""


@wp.struct
class Base:
    """The system that was factorised last, one per world."""

    valid: wp.array[int]  # (world,): 0 if there is none for the present W
    scale: wp.array[wp.float64]  # (world,): r [m/N]
    shift: wp.array[wp.float64]  # (world,): s [m/N]
    slope: wp.array2d[mat33d]  # (world, contact): S_0
    pressed: wp.array2d[int]  # (world, place): contacts with S_0 other than 0; first those with S_0 = 1, which stick
    sticking_count: wp.array[int]  # (world,)
    pressed_count: wp.array[int]  # (world,)
    factors: wp.array2d[mat33d]  # (world, place): 1 + G of the pressed contacts, those that stick eliminated
    sliding_factors: wp.array3d[mat33d]  # (world, place, place): L and U of what is left for the others
    column_count: wp.array[int]  # (world,)
    place_of_column: wp.array2d[int]  # (world, contact): k of its column; -1: none so far
    contact: wp.array2d[int]  # (world, k): c
    column: wp.array2d[mat33d]  # (COLUMNS world + k, contact): X_c
    product: wp.array3d[mat33d]  # (world, k, k'): G_c X_c'


@wp.struct
class NewtonSystems:
    """One linear system per row."""

    base: Base
    slope: wp.array2d[mat33d]  # (row, contact): S
    value: wp.array2d[vec3d]  # (row, contact): Phi [N]
    direction: wp.array2d[vec3d]  # (row, contact): d [N]
    change: wp.array2d[vec3d]  # (row, contact): (W + s) d [m]
    changed: wp.array2d[int]  # (row, i): contacts with another slope than in the base
    pressed_part: wp.array2d[vec3d]  # (row, place)
    pressed_column: wp.array2d[mat33d]  # (row, place)
    matrix: wp.array3d[mat33d]  # (row, i, i'): 1 + dS G X
    unknown: wp.array2d[vec3d]  # (row, i): s_c [N]
    solved: wp.array[int]  # (row,): systems so far
    factorised: wp.array[int]  # (row,): how many of them had to be factorised


@wp.func
def find_direction(
    problems: ContactProblems,
    systems: NewtonSystems,
    force: wp.array2d[vec3d],
    motion: wp.array2d[vec3d],
    row: int,
    scale: wp.float64,
    shift: wp.float64,
):
    """Find the direction of Newton's method at an iterate, and its change of motion."""
    linearise(problems, systems, force, motion, row, scale)
    changed_count = list_changed_contacts(problems, systems, row, scale, shift)
    systems.solved[row] = systems.solved[row] + 1
    if changed_count >= 0:
        solve_changed(problems, systems, row, changed_count)
        find_change(problems, systems, row, shift)
        if is_accurate(problems, systems, row, scale):
            return
    factorise_base(problems, systems, row, scale, shift)
    solve_changed(problems, systems, row, 0)
    find_change(problems, systems, row, shift)


@wp.func
def linearise(
    problems: ContactProblems,
    systems: NewtonSystems,
    force: wp.array2d[vec3d],
    motion: wp.array2d[vec3d],
    row: int,
    scale: wp.float64,
):
    """Take S and Phi of an iterate."""
    for c in range(problems.count[problems.worlds[row]]):
        systems.slope[row, c] = alart_curnier_slope(force[row, c] - motion[row, c] / scale, problems.friction)
        systems.value[row, c] = phi(force[row, c], motion[row, c], scale, problems.friction)


@wp.func
def find_change(problems: ContactProblems, systems: NewtonSystems, row: int, shift: wp.float64):
    """change = (W + s) direction."""
    w = problems.worlds[row]
    count = problems.count[w]
    multiply_symmetric(problems.matrix, w, count, systems.direction, systems.change, row)
    if shift > wp.float64(0.0):
        for c in range(count):
            systems.change[row, c] = systems.change[row, c] + shift * systems.direction[row, c]


@wp.func
def is_accurate(problems: ContactProblems, systems: NewtonSystems, row: int, scale: wp.float64) -> bool:
    """Whether the direction with its change obeys the system of this row."""
    missing = wp.float64(0.0)
    whole = wp.float64(0.0)
    for c in range(problems.count[problems.worlds[row]]):
        direction = systems.direction[row, c]
        product = systems.change[row, c] / scale - (wp.float64(1.0) - REGULARISATION) * direction
        value = systems.value[row, c]
        defect = direction + systems.slope[row, c] * product + value
        missing += wp.dot(defect, defect)
        whole += wp.dot(value, value)
    return missing <= LARGEST_DEFECT * LARGEST_DEFECT * whole


# --- the base ---------------------------------------------------------------------------------------------------------


@wp.func
def is_zero(x: Any) -> bool:
    """Whether all entries are 0."""
    return x == wp.float64(0.0) * x


@wp.func
def is_sticking(slope: mat33d) -> bool:
    """Whether a slope is that of a sticking contact."""
    return slope == wp.identity(n=3, dtype=wp.float64)


@wp.func
def factorise_base(problems: ContactProblems, systems: NewtonSystems, row: int, scale: wp.float64, shift: wp.float64):
    """Make the system of this row the base of its world.

    Rows of sticking contacts are those of the symmetric 1 + G. Once they are eliminated, the others with what is left
    of 1 + G, H, have the system 1 - S + S H.
    """
    base = systems.base
    w = problems.worlds[row]
    count = problems.count[w]
    sticking = int(0)
    for c in range(count):
        slope = systems.slope[row, c]
        base.slope[w, c] = slope
        base.place_of_column[w, c] = -1
        if is_sticking(slope):
            base.pressed[w, sticking] = c
            sticking += 1
    closed = int(sticking)
    for c in range(count):
        slope = systems.slope[row, c]
        if not is_zero(slope) and not is_sticking(slope):
            base.pressed[w, closed] = c
            closed += 1
    own = (shift / scale + REGULARISATION) * wp.identity(n=3, dtype=wp.float64)
    place = int(0)
    for a in range(closed):
        c = base.pressed[w, a]
        for b in range(a, closed):
            block = block_of_symmetric(problems.matrix, w, c, base.pressed[w, b], count)
            base.factors[w, place + b - a] = block * (wp.float64(1.0) / scale)
        base.factors[w, place] = base.factors[w, place] + own
        place += closed - a
    eliminate_symmetric(base.factors, w, closed, sticking)
    sliding = closed - sticking
    for a in range(sliding):
        slope = base.slope[w, base.pressed[w, sticking + a]]
        for b in range(sliding):
            rest = block_of_symmetric(base.factors, w, sticking + a, sticking + b, closed)
            base.sliding_factors[w, a, b] = slope * rest
        base.sliding_factors[w, a, a] = base.sliding_factors[w, a, a] + wp.identity(n=3, dtype=wp.float64) - slope
    factorise(base.sliding_factors, w, sliding)
    base.sticking_count[w] = sticking
    base.pressed_count[w] = closed
    base.column_count[w] = 0
    base.scale[w] = scale
    base.shift[w] = shift
    base.valid[w] = 1
    systems.factorised[row] = systems.factorised[row] + 1


@wp.func
def solve_base(
    problems: ContactProblems, base: Base, w: int, x: wp.array2d[Any], x_row: int, part: wp.array2d[Any], row: int
):
    """Replace x by M^-1 x; ``part`` is work space."""
    count = problems.count[w]
    sticking = base.sticking_count[w]
    closed = base.pressed_count[w]
    for a in range(closed):
        part[row, a] = x[x_row, base.pressed[w, a]] * wp.float64(0.0)
    for c in range(count):
        if is_zero(base.slope[w, c]) and not is_zero(x[x_row, c]):
            known = x[x_row, c] / base.scale[w]
            for a in range(closed):
                block = block_of_symmetric(problems.matrix, w, base.pressed[w, a], c, count)
                part[row, a] = part[row, a] - block * known
    first = int(sticking)
    for a in range(sticking):
        part[row, a] = part[row, a] + x[x_row, base.pressed[w, a]]
        if first == sticking and not is_zero(part[row, a]):
            first = a
    substitute_forwards(base.factors, w, closed, sticking, part, row, first)
    for a in range(sticking, closed):
        c = base.pressed[w, a]
        part[row, a] = x[x_row, c] + base.slope[w, c] * part[row, a]
    solve_factorised(base.sliding_factors, w, closed - sticking, part, row, sticking)
    substitute_backwards(base.factors, w, closed, sticking, part, row)
    for a in range(closed):
        x[x_row, base.pressed[w, a]] = part[row, a]


@wp.func
def times_row(problems: ContactProblems, base: Base, w: int, c: int, x: wp.array2d[Any], row: int, right_side: Any):
    """Return G_c x, for the solution x of M x = b; ``right_side`` is b_c."""
    if is_sticking(base.slope[w, c]):
        return right_side - x[row, c]  # row c of M is that of 1 + G
    count = problems.count[w]
    own = base.shift[w] - (wp.float64(1.0) - REGULARISATION) * base.scale[w]
    total = own * x[row, c]
    for j in range(count):
        total += block_of_symmetric(problems.matrix, w, c, j, count) * x[row, j]
    return total / base.scale[w]


@wp.func
def add_column(problems: ContactProblems, systems: NewtonSystems, row: int, contact: int):
    """Find X_c of a contact, and its products with those that there are."""
    base = systems.base
    w = problems.worlds[row]
    k = base.column_count[w]
    for c in range(problems.count[w]):
        base.column[COLUMNS * w + k, c] = mat33d()
    base.column[COLUMNS * w + k, contact] = wp.identity(n=3, dtype=wp.float64)
    solve_base(problems, base, w, base.column, COLUMNS * w + k, systems.pressed_column, row)
    base.contact[w, k] = contact
    base.place_of_column[w, contact] = k
    base.column_count[w] = k + 1
    zero = mat33d()
    one = wp.identity(n=3, dtype=wp.float64)
    for j in range(k):
        base.product[w, k, j] = times_row(problems, base, w, contact, base.column, COLUMNS * w + j, zero)
        base.product[w, j, k] = times_row(problems, base, w, base.contact[w, j], base.column, COLUMNS * w + k, zero)
    base.product[w, k, k] = times_row(problems, base, w, contact, base.column, COLUMNS * w + k, one)


# --- systems that differ from it --------------------------------------------------------------------------------------


@wp.func
def list_changed_contacts(
    problems: ContactProblems, systems: NewtonSystems, row: int, scale: wp.float64, shift: wp.float64
) -> int:
    """List the contacts whose slope is not that of the base; return how many, or -1 if new factors are cheaper."""
    base = systems.base
    w = problems.worlds[row]
    if base.valid[w] == 0 or base.scale[w] != scale or base.shift[w] != shift:
        return -1
    count = problems.count[w]
    changed = int(0)
    columns = base.column_count[w]
    for c in range(count):
        difference = systems.slope[row, c] - base.slope[w, c]
        largest = wp.float64(0.0)
        for i in range(3):
            largest = wp.max(largest, wp.max(wp.abs(difference[i])))
        own = wp.trace(block_of_symmetric(problems.matrix, w, c, c, count))
        if largest * (scale + own) > SLOPE_TOLERANCE * scale:
            if base.place_of_column[w, c] < 0:
                columns += 1
            if columns > COLUMNS:
                return -1
            systems.changed[row, changed] = c
            changed += 1
    if COLUMN_COST * (columns - base.column_count[w]) > base.pressed_count[w]:
        return -1
    return changed


@wp.func
def solve_changed(problems: ContactProblems, systems: NewtonSystems, row: int, changed_count: int):
    """Find the direction from the base, with the slopes of this row at the contacts that are listed as changed."""
    base = systems.base
    w = problems.worlds[row]
    count = problems.count[w]
    for c in range(count):
        systems.direction[row, c] = -systems.value[row, c]
    solve_base(problems, base, w, systems.direction, row, systems.pressed_part, row)
    if changed_count == 0:
        return
    for i in range(changed_count):
        if base.place_of_column[w, systems.changed[row, i]] < 0:
            add_column(problems, systems, row, systems.changed[row, i])
    for i in range(changed_count):
        c = systems.changed[row, i]
        k = base.place_of_column[w, c]
        difference = systems.slope[row, c] - base.slope[w, c]
        right_side = -systems.value[row, c]
        systems.unknown[row, i] = difference * times_row(problems, base, w, c, systems.direction, row, right_side)
        for j in range(changed_count):
            other = base.place_of_column[w, systems.changed[row, j]]
            systems.matrix[row, i, j] = difference * base.product[w, k, other]
        systems.matrix[row, i, i] = systems.matrix[row, i, i] + wp.identity(n=3, dtype=wp.float64)
    factorise(systems.matrix, row, changed_count)
    solve_factorised(systems.matrix, row, changed_count, systems.unknown, row, 0)
    for i in range(changed_count):
        k = COLUMNS * w + base.place_of_column[w, systems.changed[row, i]]
        for c in range(count):
            systems.direction[row, c] = systems.direction[row, c] - base.column[k, c] * systems.unknown[row, i]
    for i in range(changed_count):
        c = systems.changed[row, i]
        if is_zero(systems.slope[row, c]):
            systems.direction[row, c] = -systems.value[row, c]  # open contacts lose their force to the last digit
