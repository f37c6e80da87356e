"""The objects that a running evaluator knows by name."""

from __future__ import annotations

from threading import Lock

import numpy as np

from defgrasp_ros.errors import IncorrectStateError, InvalidMeshError, NotFoundError, ResourceExhaustedError
from defgrasp_ros.mesh.object_mesh import PreparedMesh
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.objects import find_object, object_library

OBJECT_SCHEME = "object://"
"""Of URIs that name a registered object, or one of the library."""

MAX_OBJECTS = 200
"""Most objects that are kept; each takes about a megabyte."""


class RegistrationError(IncorrectStateError):
    """An object of that name is there already."""


class TooManyObjectsError(ResourceExhaustedError):
    """No room for another object."""


class ObjectRegistry:
    """Meshes by name; may be used from several threads."""

    def __init__(self) -> None:
        self._meshes: dict[str, TetMesh] = {}
        self._lock = Lock()

    def check_name(self, name: str, *, replace: bool) -> None:
        """Raise if an object cannot be kept under that name, before time is spent on its mesh.

        Raises:
            InvalidMeshError: If the name is empty.
            RegistrationError: If there is one, and it is not to be replaced.
            TooManyObjectsError: If there is no room.
        """
        if not name:
            raise InvalidMeshError("object_id and object.name are both empty; give the object a name")
        with self._lock:
            if name in self._meshes and not replace:
                raise RegistrationError(f"object '{name}' is registered already; give replace, or remove it first")
            if name not in self._meshes and len(self._meshes) >= MAX_OBJECTS:
                raise TooManyObjectsError(f"{MAX_OBJECTS} objects are registered; remove one first")

    def add(self, name: str, mesh: TetMesh) -> None:
        """Keep a mesh; one of the same name is replaced."""
        with self._lock:
            self._meshes[name] = mesh

    def remove(self, name: str) -> None:
        """Forget a mesh.

        Raises:
            NotFoundError: If there is none of that name.
        """
        with self._lock:
            if self._meshes.pop(name, None) is None:
                raise NotFoundError(f"no object '{name}' is registered; registered: {self._listed()}")

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._meshes.clear()

    def names(self) -> list[str]:
        """Return the names of the registered objects."""
        with self._lock:
            return list(self._meshes)

    def mesh(self, name: str, element_order: int | None = None) -> TetMesh:
        """Return the mesh of a registered object, or of one of the library.

        Args:
            name: Of the object.
            element_order: 1 or 2, see :class:`TetMesh`; None: that of the registered object, 2 for the library.

        Raises:
            NotFoundError: If there is neither.
            InvalidMeshError: If a registered object is of another order.
        """
        with self._lock:
            mesh = self._meshes.get(name)
            listed = self._listed()
        if mesh is not None:
            if element_order not in (None, mesh.element_order):
                raise InvalidMeshError(
                    f"element_order = {element_order}, but object '{name}' is registered with {mesh.element_order}; "
                    "leave it out, or register the object again"
                )
            return mesh
        if name not in object_library():
            raise NotFoundError(
                f"object '{name}' is neither registered ({listed}) nor in the library ({', '.join(object_library())})"
            )
        return find_object(name).mesh(element_order=element_order)

    def prepared(self, name: str, element_order: int | None = None) -> PreparedMesh:
        """Return the mesh as one that was prepared before; errors as of ``mesh``."""
        return PreparedMesh(self.mesh(name, element_order), None, None, 1, (), ())

    def surface(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return vertices [m] and triangles of the surface of an object; errors as of ``mesh``."""
        if name not in self.names() and name in object_library():
            return find_object(name).surface()
        mesh = self.mesh(name)
        return mesh.vertices, mesh.surface_triangles

    def _listed(self) -> str:
        return ", ".join(self._meshes) or "none"
