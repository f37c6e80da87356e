"""How hard an object must be squeezed so that it does not turn between the fingers."""

from __future__ import annotations

import numpy as np


def rotational_slip_force(
    contacts: np.ndarray, centroid: np.ndarray, axis: np.ndarray, weight: float, friction: float, safety_factor: float
) -> float:
    """Return the SUM of the pads' normal forces that resists the moment of the weight [N] (DefGraspSim).

    The contact patch is replaced by two points a+ and a-, half way from its mean c to its ends along the line towards
    the centroid o, seen along the closing axis. In the worst orientation the weight stands across that line:

        F_slip = safety factor x m g (1 + 2 R / r) / mu,      R = |o - a+|,    r = |a+ - a-|.

    Args:
        contacts: Contact points of both fingers [m], shape ``(contact, 3)``.
        centroid: Centre of mass [m], shape ``(3,)``.
        axis: Unit vector along which the fingers close, shape ``(3,)``.
        weight: m g [N].
        friction: Coulomb's mu [-].
        safety_factor: [-].

    Returns:
        The force; inf where the points lie on one line along the axis, and 0 where the centroid is at their mean.
    """
    middle = contacts.mean(axis=0)
    lever = centroid - middle
    lever = lever - axis * (axis @ lever)
    length = float(np.linalg.norm(lever))
    if length == 0.0:
        return 0.0
    along = (contacts - middle) @ (lever / length)
    near, far = 0.5 * along.max(), 0.5 * along.min()
    if near == far:
        return np.inf
    return safety_factor * weight * (1.0 + 2.0 * abs(length - near) / (near - far)) / friction
