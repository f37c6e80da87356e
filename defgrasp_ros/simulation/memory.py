"""How much memory a simulation takes, and how many worlds fit into what is free."""

from __future__ import annotations

import os

import warp as wp

from defgrasp_ros.errors import ResourceExhaustedError
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.anderson import DEPTH
from defgrasp_ros.simulation.contact_set import INITIAL_CAPACITY
from defgrasp_ros.simulation.kernels_newton_system import COLUMNS
from defgrasp_ros.simulation.shared_compliance import KEPT

USED_SHARE = 0.7
"""Part of the free memory that worlds may fill [-]; the rest is for copies, other programs, and lists that grow."""
EXPECTED_CAPACITY = 4 * INITIAL_CAPACITY
"""Contact points per world for which there must be room."""
SCALAR, VECTOR, MATRIX = 8, 24, 72
"""Bytes of a number, a vector of 3 and a 3 x 3 matrix in double precision."""


def bytes_per_world(model: ObjectModel, capacity: int = EXPECTED_CAPACITY) -> int:
    """Return the device memory of one world with room for ``capacity`` contact points [byte]."""
    mesh = model.mesh
    nodes = len(mesh.vertices)
    history = 2 * (int(DEPTH) + 1)
    nodal = nodes * ((11 + history) * VECTOR + 3 * MATRIX)
    elements = len(mesh.tetrahedra) * MATRIX + mesh.elements.size * VECTOR
    matrices = 2 * capacity**2 + (int(COLUMNS) + 3) * capacity + int(COLUMNS) ** 2
    contacts = capacity * (9 * (5 * VECTOR + MATRIX + 4 * SCALAR) + (23 + history) * VECTOR)
    return nodal + elements + matrices * MATRIX + contacts


def shared_bytes(model: ObjectModel) -> int:
    """Return the memory of the inverses that all worlds share [byte]."""
    return KEPT * SCALAR * (3 * len(model.mesh.vertices)) ** 2


def worlds_that_fit(model: ObjectModel, device: wp.Device) -> int:
    """Return how many worlds fit into the free memory of a device.

    Raises:
        ResourceExhaustedError: If not a single one does.
    """
    free = device.free_memory if device.is_cuda else free_host_memory()
    room = int((USED_SHARE * free - shared_bytes(model)) // bytes_per_world(model))
    if room < 1:
        needed = (shared_bytes(model) + bytes_per_world(model)) / USED_SHARE
        raise ResourceExhaustedError(
            f"the simulation of {len(model.mesh.vertices)} nodes needs {needed / 1e9:.1f} GB of memory, and "
            f"{device.alias} has {free / 1e9:.1f} GB free; use a coarser mesh (target_edge_length), or free memory"
        )
    return room


def free_host_memory() -> int:
    """Return the memory that programs can still get [byte]."""
    try:
        with open("/proc/meminfo") as lines:
            available = next(line for line in lines if line.startswith("MemAvailable:"))
        return 1024 * int(available.split()[1])
    except (OSError, StopIteration):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
