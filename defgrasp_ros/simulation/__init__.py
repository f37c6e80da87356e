"""GPU and CPU simulation of a deformable object between two pads over a platform. Knows nothing of ROS or files."""
