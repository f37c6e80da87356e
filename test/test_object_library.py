"""Objects and materials that come with the package."""

import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import InvalidOptionsError, NotFoundError
from defgrasp_ros.material_library import BASES, find_material, material_library
from defgrasp_ros.mesh.quality import dihedral_angles
from defgrasp_ros.objects import find_object, object_library
from defgrasp_ros.objects.revolution import resampled, revolved

HOLLOW = [name for name, entry in object_library().items() if entry.category == "hollow"]
EXACT_VOLUMES = {
    "sphere": 4.0 / 3.0 * np.pi * 0.02**3,
    "ellipsoid": 4.0 / 3.0 * np.pi * 0.0185 * 0.018 * 0.0225,
    "cuboid": 0.06 * 0.03 * 0.02,
    "cylinder": np.pi * 0.02**2 * 0.06,
    "annulus": np.pi * (0.03**2 - 0.015**2) * 0.02,
    "ring": 2.0 * np.pi**2 * 0.03 * 0.006**2,
    "prism_6": 1.5 * 3.0**0.5 * 0.025**2 * 0.05,
    "tube_wide": np.pi * (0.03**2 - 0.026**2) * 0.05,
}


def test_library_is_as_large_as_the_study():
    """At least the 34 objects of the study, of all kinds, each with a material."""
    library = object_library()
    assert len(library) >= 34
    assert {entry.category for entry in library.values()} == {"primitive", "hollow", "food", "organ"}


@pytest.mark.parametrize("name", object_library())
def test_surface_is_a_solid_on_the_ground(name):
    """Closed, wound outwards, one piece, of a size for a gripper, standing on z = 0 above the origin."""
    surface = trimesh.Trimesh(*find_object(name).surface(), process=False)
    assert surface.is_watertight and surface.is_winding_consistent and surface.volume > 0.0
    assert surface.body_count == 1
    assert surface.bounds[0, 2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(surface.bounds[:, :2].sum(axis=0), 0.0, atol=1e-12)
    assert 0.01 < surface.extents.max() < 0.2
    assert np.sort(surface.extents)[0] < 0.085  # one side at least fits into the hand


@pytest.mark.parametrize("name", EXACT_VOLUMES)
def test_volumes_are_those_of_the_formulae(name):
    """Facets and rounded edges take away less than 3 %."""
    surface = trimesh.Trimesh(*find_object(name).surface(), process=False)
    assert 0.97 < surface.volume / EXACT_VOLUMES[name] < 1.0 + 1e-9


@pytest.mark.parametrize("name", HOLLOW)
@pytest.mark.parametrize("element_order", [1, 2])
def test_walls_have_their_thickness(name, element_order):
    """The volume of a wall is its area times its thickness, less or more where it is curved; elements are sound."""
    entry = find_object(name)
    mesh = entry.mesh(element_order=element_order)
    assert 800 <= len(mesh.vertices) <= 1500
    wall = entry.dimensions["wall"]
    surface = trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)
    # Outer and inner side together have twice the area of the middle, and the rim little.
    rim = surface.area - 2.0 * mesh.volume / wall
    assert -0.02 * surface.area < rim < 0.2 * surface.area
    assert np.degrees(dihedral_angles(mesh).min()) > 2.0


def test_hollow_objects_have_a_fixed_mesh():
    """An edge length has no meaning for them, and is not passed over."""
    with pytest.raises(InvalidOptionsError, match="cup is hollow"):
        find_object("cup").mesh(0.01)


@pytest.mark.parametrize("name", ["strawberry", "apple_slice", "cube"])
def test_solids_are_meshed_to_about_a_thousand_nodes(name):
    """By default, with the volume of the surface and no bad element; the ring is too thin for so few nodes."""
    entry = find_object(name)
    mesh = entry.mesh()
    surface = trimesh.Trimesh(*entry.surface(), process=False)
    assert 800 <= len(mesh.vertices) <= (2000 if name == "ring" else 1300)
    assert mesh.volume == pytest.approx(surface.volume, rel=1e-6)
    assert np.degrees(dihedral_angles(mesh).min()) > 5.0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", [name for name in object_library() if name not in HOLLOW])
def test_every_solid_is_meshed(name):
    """The same of all of them."""
    test_solids_are_meshed_to_about_a_thousand_nodes(name)


def test_apple_slice_lies_on_its_cut_face():
    """A good part of its surface is on the ground, and it stands there."""
    surface = trimesh.Trimesh(*find_object("apple_slice").surface(), process=False)
    on_ground = (surface.triangles[:, :, 2] < 1e-6).all(axis=1)
    assert surface.area_faces[on_ground].sum() > 0.15 * surface.area
    base = surface.triangles[on_ground][:, :, :2].reshape(-1, 2)
    assert (base.min(axis=0) < surface.center_mass[:2]).all() and (surface.center_mass[:2] < base.max(axis=0)).all()


def test_unknown_names_are_listed():
    """The error names what there is."""
    with pytest.raises(NotFoundError, match="'unicorn'.*sphere.*kidney"):
        find_object("unicorn")
    with pytest.raises(NotFoundError, match="'unobtainium'.*skin.*glass"):
        find_material("unobtainium")


def test_materials_are_complete_and_sourced():
    """The named ones are there; every number has a source, and the softest is a gel, the stiffest glass."""
    library = material_library()
    wanted = "skin tofu gelatin banana tomato rubber latex foam bread heart_muscle polyethylene abs glass"
    assert set(wanted.split()) <= set(library)
    assert any(name.startswith("silicone") for name in library)
    for record in library.values():
        assert record.basis in BASES and len(record.source) > 20
    moduli = {name: record.material.youngs_modulus for name, record in library.items()}
    assert max(moduli, key=moduli.get) == "glass"
    assert library["tofu"].breaking_stress == 3e3


def test_revolution_is_closed_and_even():
    """A sphere's profile gives a closed sphere whose triangles have about the area that was asked for."""
    angles = np.linspace(-np.pi / 2.0, np.pi / 2.0, 33)
    profile = 0.03 * np.column_stack([np.cos(angles), np.sin(angles)])
    spacing = float(np.linalg.norm(profile[1] - profile[0]))
    surface = trimesh.Trimesh(*revolved(profile, spacing), process=False)
    assert surface.is_watertight and surface.is_winding_consistent
    assert surface.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.03**3, rel=0.01)
    assert surface.area_faces.max() < 4.0 * np.median(surface.area_faces)


def test_resampling_keeps_corners():
    """Every corner is a point, and no step is longer than asked for."""
    corners = np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.05]])
    points = resampled(corners, 0.007)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= 0.007 + 1e-12
    for corner in corners:
        assert np.linalg.norm(points - corner, axis=1).min() < 1e-12
