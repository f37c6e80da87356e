"""Start the evaluator in a full ROS installation: ``ros2 launch defgrasp_ros evaluator.launch.py``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the node with its parameter file, namespace and log level as arguments."""
    default_parameters = PathJoinSubstitution([FindPackageShare("defgrasp_ros"), "config", "evaluator.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=default_parameters, description="Parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node"),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            Node(
                package="defgrasp_ros",
                executable="defgrasp_evaluator",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
                emulate_tty=True,
            ),
        ]
    )
