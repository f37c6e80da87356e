"""Edge lengths that give a number of nodes."""

import numpy as np
import pytest

from defgrasp_ros.errors import MeshingTimeoutError, MeshTooLargeError, TetrahedralizationError
from defgrasp_ros.mesh.node_count import ATTEMPTS, with_nodes
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh

SIZE = 0.1


class Mesher:
    """Makes cubes of cells of an edge length, and keeps the lengths; raises what it is told to, call by call."""

    def __init__(self, *errors: Exception | None) -> None:
        self.edges: list[float] = []
        self._errors = list(errors)

    def __call__(self, edge_length: float) -> TetMesh:
        self.edges.append(edge_length)
        error = self._errors.pop(0) if self._errors else None
        if error is not None:
            raise error
        return box((SIZE,) * 3, (max(1, round(SIZE / edge_length)),) * 3)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("first", [0.005, 0.03])
def test_the_number_is_reached(order, first):
    """From either side, at either order, in a few attempts."""
    mesher = Mesher()
    mesh = with_nodes(mesher, first, order, 0.7, nodes=700, tolerance=0.3)
    nodes = len(TetMesh(mesh.vertices, mesh.tetrahedra, order).vertices)
    assert abs(np.log(nodes / 700)) < 0.3 and 1 < len(mesher.edges) <= ATTEMPTS


def test_the_nearest_is_taken():
    """Where no mesh has the number, even if a later one is worse."""
    meshes = iter([box((SIZE,) * 3, (cells,) * 3) for cells in (1, 3, 2, 1)])
    assert len(with_nodes(lambda edge: next(meshes), 0.02, 1, 0.7, nodes=60, tolerance=1e-3).vertices) == 64


def test_after_a_failure_another_length_is_tried():
    """By the factor that was given."""
    mesher = Mesher(TetrahedralizationError("too coarse"))
    with_nodes(mesher, 0.02, 1, 0.5, nodes=1331)
    assert mesher.edges == [0.02, 0.01]


def test_the_first_failure_is_raised():
    """When there is no mesh at all."""
    mesher = Mesher(*(TetrahedralizationError(f"failure {number}") for number in range(ATTEMPTS)))
    with pytest.raises(TetrahedralizationError, match="failure 0"):
        with_nodes(mesher, 0.02, 1, 0.7)
    assert len(mesher.edges) == ATTEMPTS


@pytest.mark.parametrize("error", [MeshingTimeoutError("too slow"), MeshTooLargeError("too large")])
def test_what_smaller_elements_do_not_mend_ends_the_search(error):
    """Nobody waits for the mesher's time limit four times."""
    mesher = Mesher(error)
    with pytest.raises(type(error)):
        with_nodes(mesher, 0.02, 1, 0.7)
    assert len(mesher.edges) == 1


def test_a_timeout_leaves_the_mesh_before():
    """It is not as near as it could be, but it is there."""
    mesher = Mesher(None, MeshingTimeoutError("too slow"))
    assert len(with_nodes(mesher, 0.05, 1, 0.7).vertices) == 27
