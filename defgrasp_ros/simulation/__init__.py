"""GPU and CPU simulation of a deformable object between two pads over a platform. Knows nothing of ROS or files."""

import warp as wp

# Standard output belongs to the caller; Warp's banner and load messages would end up there.
wp.config.quiet = True
