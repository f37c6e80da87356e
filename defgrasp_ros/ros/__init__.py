"""The ROS 2 side: messages to domain objects and back, and the node that evaluates grasps on request."""
