"""Candidate grasps of a parallel-jaw gripper for an object of which only the surface is known."""

from defgrasp_ros.sampling.antipodal import AntipodalGrasp, antipodal_grasps
from defgrasp_ros.sampling.clearance import Fit, HandFit
from defgrasp_ros.sampling.sampler import SAMPLERS, sample_grasps

__all__ = ["SAMPLERS", "AntipodalGrasp", "Fit", "HandFit", "antipodal_grasps", "sample_grasps"]
