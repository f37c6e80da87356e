"""Objects by name, with category, dimensions and default material: ``config/objects.yaml``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import yaml

from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError
from defgrasp_ros.material_library import MaterialRecord, find_material
from defgrasp_ros.mesh.object_mesh import prepare_surface
from defgrasp_ros.mesh.tet_mesh import DEFAULT_ELEMENT_ORDER, TetMesh, made_element_order
from defgrasp_ros.object_model import ObjectModel

CATEGORIES = ("primitive", "hollow", "food", "organ")
SOLIDS = ("ellipsoid", "cylinder", "annulus", "ring", "cuboid", "prism", "wedge")
HOLLOWS = ("tube", "cup", "bowl", "bottle")
NATURALS = (
    *("banana", "strawberry", "lemon", "apple", "tomato", "pear", "egg", "potato", "bread"),
    *("heart", "kidney", "liver"),
)
SHAPES = (*SOLIDS, *HOLLOWS, *NATURALS)
"""Functions that make a shape of its dimensions."""


@dataclass(frozen=True)
class LibraryObject:
    """An object made by a formula.

    Args:
        name: Its name.
        category: One of ``CATEGORIES``.
        shape: One of ``SHAPES``.
        dimensions: Arguments of that function, mostly lengths [m].
        material: Default material.
    """

    name: str
    category: str
    shape: str
    dimensions: dict[str, Any]
    material: MaterialRecord

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Return its closed surface, standing on z = 0 and centred above the origin.

        Returns:
            Vertices [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside, shape
            ``(triangle, 3)``.
        """
        made = self._make()
        if not isinstance(made, TetMesh):
            return _placed(made[0]), made[1]
        used, triangles = np.unique(made.surface_triangles, return_inverse=True)
        return _placed(made.vertices[used]), triangles.reshape(-1, 3)

    def mesh(self, target_edge_length: float | None = None, element_order: int | None = None) -> TetMesh:
        """Return its tetrahedra, made once, then cached.

        Args:
            target_edge_length: Edge length [m]; None: for about 1 000 nodes.
            element_order: 1 or 2, see :class:`TetMesh`; None: 2.

        Raises:
            InvalidOptionsError: If an edge length is given for a hollow object, whose walls have their own.
            InvalidMeshError: As ``prepare_surface``.
        """
        order = made_element_order(element_order)
        made = self._make(order)
        if isinstance(made, TetMesh):
            if target_edge_length is not None:
                raise InvalidOptionsError(f"{self.name} is hollow: its mesh has a fixed target_edge_length")
            return TetMesh(_placed(made.vertices), made.tetrahedra, order)
        options = {"target_edge_length": target_edge_length, "element_order": order}
        return prepare_surface(_placed(made[0]), made[1], **options).logged()

    def model(self, target_edge_length: float | None = None, element_order: int | None = None) -> ObjectModel:
        """Return mesh and default material; arguments and errors as of ``mesh``."""
        return ObjectModel(self.name, self.mesh(target_edge_length, element_order), self.material.material)

    def _make(self, element_order: int = DEFAULT_ELEMENT_ORDER) -> TetMesh | tuple[np.ndarray, np.ndarray]:
        order = {"element_order": element_order} if self.shape in HOLLOWS else {}
        return _shape_function(self.shape)(**self.dimensions, **order)


@cache
def object_library() -> dict[str, LibraryObject]:
    """Return all objects by name, in the order of the file.

    Raises:
        InvalidOptionsError: If an entry lacks a key or names an unknown category, shape or material.
    """
    path = config_file("objects.yaml")
    library = {}
    for name, entry in yaml.safe_load(path.read_text()).items():
        try:
            category, shape, material = (entry.pop(key) for key in ("category", "shape", "material"))
            if category not in CATEGORIES or shape not in SHAPES:
                raise ValueError(f"category '{category}' or shape '{shape}' is unknown")
            library[name] = LibraryObject(name, category, shape, entry, find_material(material))
        except (KeyError, ValueError, NotFoundError) as error:
            raise InvalidOptionsError(f"{path}: {name}: {error}") from error
    return library


def find_object(name: str) -> LibraryObject:
    """Return the object of that name.

    Raises:
        NotFoundError: If there is none.
    """
    library = object_library()
    if name not in library:
        raise NotFoundError(f"object '{name}' is not in the library; known: {', '.join(library)}")
    return library[name]


def _shape_function(shape: str) -> Callable[..., TetMesh | tuple[np.ndarray, np.ndarray]]:
    from defgrasp_ros.objects import hollow, natural, primitives

    module = primitives if shape in SOLIDS else hollow if shape in HOLLOWS else natural
    return getattr(module, shape)


def _placed(vertices: np.ndarray) -> np.ndarray:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return vertices - [*(low + high)[:2] / 2.0, low[2]]
