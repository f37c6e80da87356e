"""Materials by name, with their sources: ``config/materials.yaml``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache

import yaml

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidMaterialError, NotFoundError
from defgrasp_ros.material import Material

BASES = ("data sheet", "handbook", "literature", "estimate")
"""How the numbers of a material are known, see the head of the file."""


@dataclass(frozen=True)
class MaterialRecord:
    """A material of the library.

    Args:
        name: Its name.
        material: Elasticity, density and friction.
        basis: One of ``BASES``.
        source: Where the numbers come from, and what is doubtful about them.
        yield_stress: Stress at which it yields [Pa]; None: it does not, or it is not known.
        breaking_stress: Stress at which it breaks [Pa]; None: not known.

    Raises:
        InvalidMaterialError: If a value is outside its range.
    """

    name: str
    material: Material
    basis: str
    source: str
    yield_stress: float | None = None
    breaking_stress: float | None = None

    def __post_init__(self) -> None:
        if self.basis not in BASES:
            raise InvalidMaterialError(f"{self.name}: basis = '{self.basis}' is unknown; known: {', '.join(BASES)}")
        if not self.source:
            raise InvalidMaterialError(f"{self.name}: source is empty; say where the numbers come from")
        for name in ("yield_stress", "breaking_stress"):
            if getattr(self, name) is not None:
                require_in_range(
                    InvalidMaterialError, f"{self.name}: {name}", getattr(self, name), 0.0, low_open=True, unit="Pa"
                )


@cache
def material_library() -> dict[str, MaterialRecord]:
    """Return all materials by name, in the order of the file.

    Raises:
        InvalidMaterialError: If a value in the file is missing, unknown or outside its range.
    """
    path = config_file("materials.yaml")
    properties = [field.name for field in dataclasses.fields(Material)]
    library = {}
    for name, entry in yaml.safe_load(path.read_text()).items():
        try:
            material = Material(**{key: _number(key, entry.pop(key)) for key in properties})
            library[name] = MaterialRecord(name, material, **entry)
        except (KeyError, TypeError, InvalidMaterialError) as error:
            raise InvalidMaterialError(f"{path}: {name}: {error}") from error
    return library


def _number(name: str, value: object) -> float:
    if not isinstance(value, float):  # YAML takes 2e5 for text; 2.0e+5 is a number
        raise InvalidMaterialError(f"{name} = {value!r} is not a number such as 2.0e+5")
    return value


def find_material(name: str) -> MaterialRecord:
    """Return the material of that name.

    Raises:
        NotFoundError: If there is none.
    """
    library = material_library()
    if name not in library:
        raise NotFoundError(f"material '{name}' is unknown; known: {', '.join(library)}")
    return library[name]
