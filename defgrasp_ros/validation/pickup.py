"""The whole experiment: after each pickup the pads must carry the weight, and press as they were told."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.validation.bodies import block
from defgrasp_ros.validation.case import Case, Experiment, relative, vanishing

FROM_ABOVE = Rotation.from_euler("x", np.pi)


def force_balance(device: str, youngs_modulus: float) -> Iterator[Case]:
    """Three grasps of a block: centred, off centre, turned about the vertical."""
    model = block((0.03, 0.03, 0.03), (3, 3, 3), Material(youngs_modulus))
    turned = Rotation.from_euler("z", 20.0, degrees=True) * FROM_ABOVE
    grasps = [
        Grasp(np.zeros(3), FROM_ABOVE.as_quat(), "centred"),
        Grasp(np.array([0.004, 0.002, 0.003]), FROM_ABOVE.as_quat(), "off centre"),
        Grasp(np.zeros(3), turned.as_quat(), "turned"),
    ]
    options = EvaluationOptions(pickup_hold_time=0.5)
    evaluations = evaluate_grasps(model, grasps, load_gripper(), options, device)
    name = f"pickup, E = {youngs_modulus:.0e} Pa".replace("e+0", "e")
    held = [evaluation for evaluation in evaluations if evaluation.code is ResultCode.OK]
    source = "F = 1.3 m g / mu holds a block with flush pads; the turned grasp turns the block flush"
    yield vanishing(f"{name}: grasps not held", len(grasps) - len(held), 0.0, source)
    weight = np.array([0.0, 0.0, model.mass * STANDARD_GRAVITY])
    totals = [sum(finger.forces.sum(axis=0) for finger in evaluation.contacts) for evaluation in held]
    error = max(np.linalg.norm(total - weight) for total in totals) / model.weight
    source = "equilibrium; the object is brought to rest to 1e-6 of its size in a step, 1e-3 of its weight in forces"
    yield vanishing(f"{name}: pads' forces - m g, relative to m g", error, 1e-3, source)
    ratios = [evaluation.applied_force / evaluation.target_force for evaluation in held]
    source = "the target; the squeeze ends at a deviation of 1e-4"
    worst = max(ratios, key=lambda ratio: abs(ratio - 1.0))
    yield relative(f"{name}: applied / target force", worst, 1.0, 1.01e-4, source)


EXPERIMENTS = tuple(
    Experiment(f"pickup, E = {modulus:g} Pa", partial(force_balance, youngs_modulus=modulus), quick=modulus == 2e5)
    for modulus in (2e4, 2e5, 2e6, 2e9)
)
