"""Asks a running evaluator what candidate grasps are worth.

Example::

    with GraspEvaluatorClient() as client:
        answer = client.evaluate_grasps(MeshFile("banana.stl"), Material(youngs_modulus=1e5), grasps)
    for evaluation in answer.evaluations:
        print(evaluation.grasp_id, evaluation.code.name, evaluation.metrics.max_von_mises_stress)

Needs ROS 2 and the interface package ``defgrasp_interfaces``, but neither simulator nor GPU: it runs wherever the
planner runs.
"""

from defgrasp_ros.client.answer import EvaluationAnswer, EvaluationProgress
from defgrasp_ros.client.evaluator_client import DEFAULT_EVALUATOR, GraspEvaluatorClient
from defgrasp_ros.client.failures import EvaluatorGoneError, refusal
from defgrasp_ros.client.goal import EvaluationGoal
from defgrasp_ros.ros.object_source import MeshData, MeshFile, RegisteredObject, Surface

__all__ = [
    "DEFAULT_EVALUATOR",
    "EvaluationAnswer",
    "EvaluationGoal",
    "EvaluationProgress",
    "EvaluatorGoneError",
    "GraspEvaluatorClient",
    "MeshData",
    "MeshFile",
    "RegisteredObject",
    "Surface",
    "refusal",
]
