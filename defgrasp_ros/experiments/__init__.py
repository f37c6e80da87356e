"""The grasp experiments of the protocol, and the measures taken from them."""

from defgrasp_ros.experiments.evaluate import evaluate_grasps

__all__ = ["evaluate_grasps"]
