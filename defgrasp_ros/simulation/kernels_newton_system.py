"""The linear systems of Newton's method for a contact problem, solved with factors of an earlier one.

With the slope S of ``alart_curnier`` at each contact, 0 where it is open and 1 where it sticks, a direction d obeys

    (1 - S) d + S K d = -Phi,      K = (W + s) / r + epsilon,

with the scale r, a proximal shift s and a small regularisation epsilon. From one system to the next, also of the next
problem of a world, few contacts begin to open, stick or slide, and W seldom changes. So a world keeps a base: K of
contacts that stick, B, factorised as U^T D U, and of contacts that slid when it was made, T, with B eliminated: H.
Where the contacts of B stick still, the system there is K d = -Phi, whatever else happens. A contact c of B that does
not stick any more misses that by an unknown s_c, and one that is neither in B nor in T has the unknown s_c = d_c. Each
of them needs a column,

    z_c = U^-T e_c  or  -U^-T K_Bc,      q_c = -K_TB K_BB^-1 e_c  or  -H_Tc,

which is found when it is first needed, and kept as long as the base. With the products Q_cc' = z_c^T D^-1 z_c', less
K_cc' for two outside, and f = -U^-T Phi_B, what is left is a small system for d_T and s:

    (1 - S) d_t + S m_t = -Phi_t,          m_T = K_TB K_BB^-1 (-Phi_B) + H d_T - sum_c q_c s_c,
    (1 - S) m_c + S s_c = -(1 - S) Phi_c   of contacts of B,
    (1 - S) s_c - S m_c = -Phi_c           of others,      m_c = z_c^T D^-1 f + sum_c' Q_cc' s_c' + q_c^T d_T,

and then U d_B = D^-1 (f + sum_c z_c s_c) - (U d_T). Slopes come in only here, so a contact that slides may turn freely.
Of an open contact outside d = -Phi is known; K d of these stands on the right-hand sides.
"""

from typing import Any

import warp as wp

from defgrasp_ros.simulation.kernels_alart_curnier import alart_curnier_slope, phi
from defgrasp_ros.simulation.kernels_block_matrix import (
    block_of_symmetric,
    eliminate_symmetric,
    factorise,
    multiply_symmetric,
    scale_by_pivots,
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
"""Columns that a world can keep."""
LARGEST_DEFECT = wp.constant(wp.float64(1e-6))
"""What a direction from earlier factors may miss of its system, relative to Phi [-]: rounding, but no more."""


@wp.struct
class Base:
    """The system that was factorised last, one per world."""

    valid: wp.array[int]  # (world,): 0 if there is none for the present W
    scale: wp.array[wp.float64]  # (world,): r [m/N]
    shift: wp.array[wp.float64]  # (world,): s [m/N]
    pressed: wp.array2d[int]  # (world, place): contacts of B, then those of T
    place: wp.array2d[int]  # (world, contact): their places; -1: neither in B nor in T
    sticking_count: wp.array[int]  # (world,): contacts of B
    pressed_count: wp.array[int]  # (world,): those of B and T
    factors: wp.array2d[mat33d]  # (world, place): upper half of U, inverses of D, and H
    spent: wp.array[wp.float64]  # (world,): on differences from it, in products of 3 x 3 blocks
    column_count: wp.array[int]  # (world,)
    column_of: wp.array2d[int]  # (world, contact): k of its column; -1: none so far
    contact: wp.array2d[int]  # (world, k): c
    column: wp.array2d[mat33d]  # (COLUMNS world + k, place): D^-1 z_c and q_c
    product: wp.array3d[mat33d]  # (world, k, k'): Q


@wp.struct
class NewtonSystems:
    """One linear system per row."""

    base: Base
    slope: wp.array2d[mat33d]  # (row, contact): S
    value: wp.array2d[vec3d]  # (row, contact): Phi [N]
    direction: wp.array2d[vec3d]  # (row, contact): d [N]
    change: wp.array2d[vec3d]  # (row, contact): (W + s) d [m]
    changed: wp.array2d[int]  # (row, i): contacts whose columns are needed
    load: wp.array2d[vec3d]  # (row, contact): K d of contacts that open and are not in the base [N]
    part: wp.array2d[vec3d]  # (row, place): of the contacts of the base
    column_part: wp.array2d[mat33d]  # (row, place)
    unknown: wp.array2d[vec3d]  # (row, i): d_T, then s [N]
    matrix: wp.array3d[mat33d]  # (world, i, i'): of the small system
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
        solve_system(problems, systems, row, changed_count)
        find_change(problems, systems, row, shift)
        if is_accurate(problems, systems, row, scale):
            return
    factorise_base(problems, systems, row, scale, shift)
    solve_system(problems, systems, row, 0)
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
def compliance(problems: ContactProblems, base: Base, w: int, a: int, b: int) -> mat33d:
    """Return K_ab [-]."""
    result = block_of_symmetric(problems.matrix, w, a, b, problems.count[w]) * (wp.float64(1.0) / base.scale[w])
    if a == b:
        result += (base.shift[w] / base.scale[w] + REGULARISATION) * wp.identity(n=3, dtype=wp.float64)
    return result


@wp.func
def factorise_base(problems: ContactProblems, systems: NewtonSystems, row: int, scale: wp.float64, shift: wp.float64):
    """Make a base that needs no columns for the system of this row."""
    base = systems.base
    w = problems.worlds[row]
    count = problems.count[w]
    base.scale[w] = scale
    base.shift[w] = shift
    sticking = int(0)
    for c in range(count):
        base.place[w, c] = -1
        base.column_of[w, c] = -1
        if is_sticking(systems.slope[row, c]):
            base.pressed[w, sticking] = c
            sticking += 1
    pressed = int(sticking)
    for c in range(count):
        slope = systems.slope[row, c]
        if not is_zero(slope) and not is_sticking(slope):
            base.pressed[w, pressed] = c
            pressed += 1
    place = int(0)
    for a in range(pressed):
        c = base.pressed[w, a]
        base.place[w, c] = a
        for b in range(a, pressed):
            base.factors[w, place] = compliance(problems, base, w, c, base.pressed[w, b])
            place += 1
    eliminate_symmetric(base.factors, w, pressed, sticking)
    base.sticking_count[w] = sticking
    base.pressed_count[w] = pressed
    base.column_count[w] = 0
    base.spent[w] = wp.float64(0.0)
    base.valid[w] = 1
    systems.factorised[row] = systems.factorised[row] + 1


@wp.func
def add_column(problems: ContactProblems, systems: NewtonSystems, row: int, contact: int):
    """Find the column of a contact, and its products with those that there are."""
    base = systems.base
    w = problems.worlds[row]
    k = base.column_count[w]
    column = COLUMNS * w + k
    sticking = base.sticking_count[w]
    pressed = base.pressed_count[w]
    own = base.place[w, contact]
    first = int(0)
    if own >= 0:
        first = own
        for a in range(pressed):
            systems.column_part[row, a] = mat33d()
        systems.column_part[row, own] = wp.identity(n=3, dtype=wp.float64)
    else:
        for a in range(pressed):
            systems.column_part[row, a] = -compliance(problems, base, w, base.pressed[w, a], contact)
    substitute_forwards(base.factors, w, pressed, sticking, systems.column_part, row, first)
    for a in range(pressed):
        base.column[column, a] = systems.column_part[row, a]
    scale_by_pivots(base.factors, w, pressed, sticking, base.column, column)
    base.contact[w, k] = contact
    base.column_of[w, contact] = k
    base.column_count[w] = k + 1
    for j in range(k + 1):
        product = mat33d()
        for a in range(first, sticking):
            product += wp.transpose(systems.column_part[row, a]) * base.column[COLUMNS * w + j, a]
        other = base.contact[w, j]
        if own < 0 and base.place[w, other] < 0:
            product -= compliance(problems, base, w, contact, other)
        base.product[w, k, j] = product
        base.product[w, j, k] = wp.transpose(product)


# --- systems that differ from it --------------------------------------------------------------------------------------


@wp.func
def cube(n: int) -> wp.float64:
    """Return n^3."""
    x = wp.float64(n)
    return x * x * x


@wp.func
def list_changed_contacts(
    problems: ContactProblems, systems: NewtonSystems, row: int, scale: wp.float64, shift: wp.float64
) -> int:
    """List the contacts whose columns are needed; return how many, or -1 if new factors are cheaper."""
    base = systems.base
    w = problems.worlds[row]
    if base.valid[w] == 0 or base.scale[w] != scale or base.shift[w] != shift:
        return -1
    changed = int(0)
    pressed = int(0)
    sliding = int(0)
    columns = base.column_count[w]
    for c in range(problems.count[w]):
        slope = systems.slope[row, c]
        if not is_zero(slope):
            pressed += 1
            if not is_sticking(slope):
                sliding += 1
        place = base.place[w, c]
        released = place >= 0 and place < base.sticking_count[w] and not is_sticking(slope)
        if released or (place < 0 and not is_zero(slope)):
            if base.column_of[w, c] < 0:
                columns += 1
            if columns > COLUMNS:
                return -1
            systems.changed[row, changed] = c
            changed += 1
    small = base.pressed_count[w] - base.sticking_count[w] + changed
    cost = base.spent[w] + (cube(small) - cube(sliding)) / wp.float64(3.0)
    cost += wp.float64(columns - base.column_count[w]) * wp.float64(pressed * pressed) / wp.float64(2.0)
    if cost > cube(pressed) / wp.float64(6.0):
        return -1
    base.spent[w] = cost
    return changed


@wp.func
def solve_system(problems: ContactProblems, systems: NewtonSystems, row: int, changed_count: int):
    """Find the direction from the base and the columns of the contacts that are listed as changed."""
    base = systems.base
    w = problems.worlds[row]
    count = problems.count[w]
    sticking = base.sticking_count[w]
    pressed = base.pressed_count[w]
    sliding = pressed - sticking
    for i in range(changed_count):
        if base.column_of[w, systems.changed[row, i]] < 0:
            add_column(problems, systems, row, systems.changed[row, i])
    find_load(problems, systems, row)
    for a in range(pressed):
        c = base.pressed[w, a]
        systems.part[row, a] = -systems.load[row, c]
        if a < sticking:
            systems.part[row, a] = systems.part[row, a] - systems.value[row, c]
    substitute_forwards(base.factors, w, pressed, sticking, systems.part, row, 0)
    assemble_small_system(problems, systems, row, changed_count)
    factorise(systems.matrix, w, sliding + changed_count)
    solve_factorised(systems.matrix, w, sliding + changed_count, systems.unknown, row)
    scale_by_pivots(base.factors, w, pressed, sticking, systems.part, row)
    for i in range(changed_count):
        column = COLUMNS * w + base.column_of[w, systems.changed[row, i]]
        for a in range(sticking):
            systems.part[row, a] = systems.part[row, a] + base.column[column, a] * systems.unknown[row, sliding + i]
    for a in range(sliding):
        systems.part[row, sticking + a] = systems.unknown[row, a]
    substitute_backwards(base.factors, w, pressed, sticking, systems.part, row)
    for a in range(pressed):
        systems.direction[row, base.pressed[w, a]] = systems.part[row, a]
    for i in range(changed_count):
        c = systems.changed[row, i]
        if base.place[w, c] < 0:
            systems.direction[row, c] = systems.unknown[row, sliding + i]
    for c in range(count):
        if is_zero(systems.slope[row, c]):
            systems.direction[row, c] = -systems.value[row, c]  # open contacts lose their force to the last digit


@wp.func
def find_load(problems: ContactProblems, systems: NewtonSystems, row: int):
    """Find K d of the contacts whose d is known beforehand: open ones that are not in the base."""
    base = systems.base
    w = problems.worlds[row]
    count = problems.count[w]
    for c in range(count):
        systems.load[row, c] = vec3d()
    for o in range(count):
        value = systems.value[row, o]
        if base.place[w, o] < 0 and is_zero(systems.slope[row, o]) and not is_zero(value):
            for c in range(count):
                systems.load[row, c] = systems.load[row, c] - compliance(problems, base, w, c, o) * value


@wp.func
def assemble_small_system(problems: ContactProblems, systems: NewtonSystems, row: int, changed_count: int):
    """Fill matrix and right-hand side of the system for d_T and s."""
    base = systems.base
    w = problems.worlds[row]
    sticking = base.sticking_count[w]
    pressed = base.pressed_count[w]
    sliding = pressed - sticking
    one = wp.identity(n=3, dtype=wp.float64)
    for a in range(sliding):
        c = base.pressed[w, sticking + a]
        slope = systems.slope[row, c]
        for b in range(sliding):
            rest = block_of_symmetric(base.factors, w, sticking + a, sticking + b, pressed)
            systems.matrix[w, a, b] = slope * rest
        systems.matrix[w, a, a] = systems.matrix[w, a, a] + one - slope
        for i in range(changed_count):
            column = COLUMNS * w + base.column_of[w, systems.changed[row, i]]
            systems.matrix[w, a, sliding + i] = -slope * base.column[column, sticking + a]
        systems.unknown[row, a] = slope * systems.part[row, sticking + a] - systems.value[row, c]
    for i in range(changed_count):
        c = systems.changed[row, i]
        slope = systems.slope[row, c]
        value = systems.value[row, c]
        k = base.column_of[w, c]
        column = COLUMNS * w + k
        motion = vec3d()
        for a in range(sticking):
            motion += wp.transpose(base.column[column, a]) * systems.part[row, a]
        if base.place[w, c] >= 0:
            weight = one - slope
            own = slope
            systems.unknown[row, sliding + i] = -weight * (value + motion)
        else:
            weight = -slope
            own = one - slope
            systems.unknown[row, sliding + i] = slope * (motion - systems.load[row, c]) - value
        for b in range(sliding):
            systems.matrix[w, sliding + i, b] = weight * wp.transpose(base.column[column, sticking + b])
        for j in range(changed_count):
            other = base.column_of[w, systems.changed[row, j]]
            systems.matrix[w, sliding + i, sliding + j] = weight * base.product[w, k, other]
        systems.matrix[w, sliding + i, sliding + i] = systems.matrix[w, sliding + i, sliding + i] + own
