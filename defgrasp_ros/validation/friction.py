"""Coulomb's law: when a block slips, that it does not creep before, and how it slides."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.simulation.kernels_progress import TOLERANCE
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, relative, vanishing
from defgrasp_ros.validation.rigs import ALONG_Y, Rig, rectangular_pads

STEP = 1.0 / 200.0
FRICTION = 0.5
MODULI = (2e4, 2e5, 2e6, 2e9)
EXTENTS, MESHES = (0.016, 0.02, 0.016), ((3, 4, 3), (4, 5, 4), (6, 8, 6))
STEPS = (1.0 / 100.0, 1.0 / 200.0, 1.0 / 400.0)
FORCE = 0.2
"""Sum of both pads' normal forces [N]."""
PADS = rectangular_pads(0.0055, 0.006)
"""Smaller than the faces, so that their edges cut through surface triangles."""
GRASPS = (
    (ALONG_Y, 0.010, (0.6, 0.0, 0.8)),
    (Grasp(np.zeros(3), np.array([0.0, math.sin(0.25), 0.0, math.cos(0.25)])), 0.010, (1.0, 0.0, 0.0)),
    (Grasp(np.zeros(3), np.array([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])), 0.008, (0.0, 0.8, -0.6)),
)
"""A gripper along y, one turned by 0.5 rad about its closing axis, one along x; half the width that it grasps [m];
direction of the load."""
LEVELS = (0.98, 0.99, 1.01, 1.02)
"""Loads, relative to mu times the pads' forces [-]."""
SOFT_HOLD, STIFF_HOLD = 0.15, 0.05
"""How long each load acts: until a soft block has given way, and a stiff one, which does so at once [s]."""
SLIDING_DEFICIT = 0.005
"""A block slides where its contacts carry less than all but this share of the load [-]."""


def threshold(
    device: str, youngs_modulus: float, cells: tuple[int, int, int], steps: Sequence[float], poses: tuple = GRASPS
) -> Iterator[Case]:
    """Pull a held block with loads around mu N, one world for each load and grasp; the worst step and grasp counts."""
    model = block(EXTENTS, cells, Material(youngs_modulus, 0.3, 1000.0, FRICTION))
    of_step = len(poses) * len(LEVELS)
    grasps, widths, directions = ([entry for entry in column for _ in LEVELS] for column in zip(*poses, strict=True))
    grasps, widths = grasps * len(steps), np.tile(widths, len(steps))
    directions, levels = np.tile(directions, (len(steps), 1)), np.tile(LEVELS, len(steps) * len(poses))
    rig = Rig(model, PADS, device, len(levels))
    rig.set_gravity(np.zeros(3))
    rig.place_pads(grasps, FORCE, widths)
    rig.active = np.arange(0, of_step, len(LEVELS))
    rig.squeeze(FORCE, STEP, 20)
    for world in np.setdiff1d(rig.every, rig.active):
        rig.branch(len(LEVELS) * (world % of_step // len(LEVELS)), world)
    pull = (FRICTION * rig.pad_forces() / model.mass)[:, None] * directions
    for h, worlds in zip(steps, rig.every.reshape(len(steps), -1), strict=True):
        rig.active = worlds
        for share in (0.3, 0.6, 0.9):
            rig.set_gravity(share * pull)
            rig.step(STEP, quasi_static=True)
        rig.set_gravity(levels[:, None] * pull)
        rig.step(h, round((SOFT_HOLD if youngs_modulus < 1e6 else STIFF_HOLD) / h), quasi_static=True)
    carried = -np.einsum("wj,wj->w", rig.total_forces(), directions) / (FRICTION * rig.pad_forces())
    slides = carried < (1.0 - SLIDING_DEFICIT) * levels
    thresholds = [_bracket(of_pose) for of_pose in slides.reshape(-1, len(LEVELS))]
    sliding_friction = list(carried[slides])
    name = f"friction, E = {youngs_modulus:.0e} Pa, {'x'.join(str(n) for n in cells)} cells".replace("e+0", "e")
    worst = f"worst of {len(poses)} grasps and steps of " + ", ".join(f"{1e3 * h:g}" for h in steps) + " ms"
    source = f"Coulomb; {worst}; bracketed by loads of " + ", ".join(f"{level:g}" for level in LEVELS)
    yield relative(f"{name}: load at slip / (mu N)", _worst(thresholds), 1.0, 0.02, source)
    source = f"Coulomb; {worst}; 0.02: a block that turns while it slides carries less"
    yield relative(f"{name}: friction when sliding / (mu N)", _worst(sliding_friction), 1.0, 0.02, source)


def _bracket(slides: np.ndarray) -> float:
    """Middle between the largest load that a block bears and the smallest under which it slides; nan without both."""
    first = int(np.argmax(slides))
    if not slides[first:].all() or not 0 < first:
        return math.nan
    return 0.5 * (LEVELS[first - 1] + LEVELS[first])


def _worst(ratios: list[float]) -> float:
    """The ratio farthest from 1; nan if there is none."""
    return max(ratios, key=lambda ratio: math.inf if math.isnan(ratio) else abs(ratio - 1.0), default=math.nan)


def creep(device: str, youngs_modulus: float) -> Iterator[Case]:
    """Hold a block at 95 % of its limit for 5 s of dynamic steps."""
    duration = 5.0
    model = block(EXTENTS, (4, 5, 4), Material(youngs_modulus, 0.3, 1000.0, FRICTION))
    rig = Rig(model, PADS, device)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([ALONG_Y], FORCE, EXTENTS[1] / 2)
    rig.squeeze(FORCE, STEP, 40)
    rig.set_gravity(np.array([0.0, 0.0, -0.95 * FRICTION * rig.pad_forces()[0] / model.mass]))
    rig.step(STEP, 100, quasi_static=True)
    start = rig.positions()
    rig.step(STEP, round(duration / STEP), quasi_static=False)
    name = f"creep in 5 s at 0.95 mu N, E = {youngs_modulus:.0e} Pa [m]".replace("e+0", "e")
    crept = np.abs(rig.positions() - start).max()
    yield vanishing(name, crept, 1e-6, "stick; a thousandth of what regularised laws of friction creep")


def sliding(device: str) -> Iterator[Case]:
    """A stiff plate thrown over the platform loses mu g of its speed per second, then stands still."""
    friction, speed, steps = 0.3, 0.2, 8
    rig = Rig(block((0.03, 0.03, 0.01), (3, 3, 1), Material(2e9, 0.3, 1000.0, friction)), PADS, device)
    rig.put_on_platform()
    rig.step(STEP, 5, quasi_static=True)
    rig.simulator.set_velocity(rig.every, np.array([speed, 0.0, 0.0]))
    rig.step(STEP, steps, quasi_static=False)
    lost = (speed - rig.mean_velocity()[0, 0]) / (steps * STEP)
    source = "mu g; residual of 1e-6 m g, and rocking of the thrown plate"
    yield relative("sliding plate: deceleration [m/s^2]", lost, friction * STANDARD_GRAVITY, 1e-3, source)
    rig.step(STEP, 20, quasi_static=False)
    rest = np.abs(rig.simulator.velocities(rig.every)).max()
    limit = TOLERANCE * STANDARD_GRAVITY * STEP * len(rig.model.mesh.vertices)
    yield vanishing("sliding plate: speed after it stopped [m/s]", rest, limit, "stick; 1e-6 m g on a single node")


def slope(device: str) -> Iterator[Case]:
    """A plate on a slope just below and just above the friction angle; the slope is a tilted gravity."""
    friction, steps = 0.7, 40
    tilts = np.radians([-0.1, 0.1]) + math.atan(friction)
    model = block((0.03, 0.03, 0.01), (3, 3, 1), Material(2e9, 0.3, 1000.0, friction))
    rig = Rig(model, PADS, device, len(tilts))
    rig.put_on_platform()
    rig.step(STEP, 5, quasi_static=True)
    rig.set_gravity(STANDARD_GRAVITY * np.column_stack([np.sin(tilts), np.zeros(2), -np.cos(tilts)]))
    rig.step(STEP, 10, quasi_static=False)
    before, speed = rig.simulator.positions(rig.every), rig.mean_velocity()[:, 0]
    rig.step(STEP, steps, quasi_static=False)
    crept = np.abs(rig.simulator.positions(rig.every)[0] - before[0]).max()
    limit = steps * TOLERANCE * STANDARD_GRAVITY * STEP**2 * len(model.mesh.vertices)
    source = "stick below atan(mu); a residual of 1e-6 m g on a single node in each step"
    yield vanishing("slope 0.1 deg below atan(mu): motion in 0.2 s [m]", crept, limit, source)
    expected = STANDARD_GRAVITY * (math.sin(tilts[1]) - friction * math.cos(tilts[1]))
    gained = (rig.mean_velocity()[1, 0] - speed[1]) / (steps * STEP)
    source = "g (sin - mu cos) = 0.021 m/s^2; 1e-6 m g in each direction is 1e-3 of it"
    yield relative("slope 0.1 deg above atan(mu): acceleration [m/s^2]", gained, expected, 2e-3, source)


QUICK_POSES = dict.fromkeys(MODULI, GRASPS) | {2e9: GRASPS[1:]}
"""The stiffest block takes longest."""

EXPERIMENTS = (
    *(
        Experiment(
            f"friction threshold, E = {modulus:g} Pa",
            partial(threshold, youngs_modulus=modulus, cells=MESHES[0], steps=STEPS[1:2], poses=poses),
        )
        for modulus, poses in QUICK_POSES.items()
    ),
    *(
        Experiment(
            f"friction threshold, E = {modulus:g} Pa, {'x'.join(map(str, cells))} cells",
            partial(threshold, youngs_modulus=modulus, cells=cells, steps=STEPS),
            quick=False,
        )
        for modulus in MODULI
        for cells in MESHES
    ),
    *(
        Experiment(f"creep, E = {modulus:g} Pa", partial(creep, youngs_modulus=modulus), quick=modulus == 2e5)
        for modulus in MODULI
    ),
    Experiment("sliding plate", sliding),
    Experiment("slope", slope),
)
