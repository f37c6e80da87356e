"""Whether an object slides on a pad as a whole, or only at some of its contact points.

Points at the edge of a patch slide long before the object does, and one at the centre of a turn never does. What counts
is the load on the patch: the friction at all points together against the most that they can resist. A sliding motion
of the pad's plane, velocity v and turning rate w, meets at most the friction power

    D(v, w) = sum mu N_i |v_i|,     v_i = v + w x r_i,

and the present friction forces f_i resist it with P = sum f_i . v_i <= D. Gross slip is P = D for one motion: the
forces are on the limit surface of the patch (Goyal, Ruina and Papadopoulos 1991). The largest P / D of all motions is
the share of the patch's resistance that is used up; its inverse is the load factor to slip at the same normal forces.
"""

from __future__ import annotations

import numpy as np

GROSS_SLIP_SHARE = 0.98
"""Share of the resistance from which on an object slides [-]. A sliding patch that also spreads does not reach 1: 0.989
in the validation of friction."""
MAX_ITERATIONS = 30
"""For the motion with the largest share; five are usual."""
ACCURACY = 1e-3
"""Change of the share at which the search ends [-]."""
SLOWEST = 1e-3
"""Speed of a point, relative to the fastest, below which it counts as that fast in the search [-]."""


def mobilised_friction(positions: np.ndarray, normals: np.ndarray, forces: np.ndarray, friction: float) -> float:
    """Return the share of the sliding resistance that the forces on a flat patch use up [-], in [0, 1]; 0 without any.

    Minimises D for P = 1 by quadratic majorants (iteratively reweighted least squares), which never raises D.

    Args:
        positions: Contact points [m], shape ``(contact, 3)``.
        normals: Unit, from the pad into the object, shape ``(contact, 3)``.
        forces: On the object [N], shape ``(contact, 3)``.
        friction: Coulomb's mu [-].
    """
    normal_forces = np.einsum("ij,ij->i", forces, normals)
    limits = friction * normal_forces
    if not limits.sum() > 0.0:
        return 0.0
    axis = normals.mean(axis=0)
    tangents = np.linalg.svd(axis[None])[2][1:]
    load = (forces - normal_forces[:, None] * normals) @ tangents.T
    offset = (positions - limits @ positions / limits.sum()) @ tangents.T
    radius = np.linalg.norm(offset, axis=1).max() or 1.0
    motions = np.zeros((len(load), 2, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = 1.0
    motions[:, 0, 2], motions[:, 1, 2] = -offset[:, 1] / radius, offset[:, 0] / radius
    wrench = np.einsum("iab,ia->b", motions, load)
    share, speeds = 0.0, np.ones(len(load))
    for _ in range(MAX_ITERATIONS):
        resistance = np.einsum("i,iab,iac->bc", limits / speeds, motions, motions)
        motion = np.linalg.solve(resistance + 1e-12 * np.trace(resistance) * np.eye(3), wrench)
        speeds = np.linalg.norm(motions @ motion, axis=1)
        most = limits @ speeds
        last, share = share, max(share, float(wrench @ motion / most)) if most > 0.0 else 0.0
        if share - last < ACCURACY:
            break
        speeds = np.maximum(speeds, SLOWEST * speeds.max())
    return share
