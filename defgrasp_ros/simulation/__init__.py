"""GPU and CPU simulation of a deformable object between two pads over a platform. Knows nothing of ROS or files."""

import warp as wp

# Standard output belongs to the caller, and a machine without a GPU is nothing to warn of.
wp.config.log_level = wp.LOG_ERROR
