"""Start the evaluator in a full ROS installation: ``ros2 launch defgrasp_ros evaluator.launch.py``.

``ros2 launch defgrasp_ros evaluator.launch.py --show-args`` lists the arguments.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the node with its parameter file, namespace, log level and autostart as arguments."""
    default_parameters = PathJoinSubstitution([FindPackageShare("defgrasp_ros"), "config", "evaluator.yaml"])
    autostart = ParameterValue(LaunchConfiguration("autostart"), value_type=bool)
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=default_parameters, description="Parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node"),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="false: a lifecycle manager configures and activates"
            ),
            LifecycleNode(
                package="defgrasp_ros",
                executable="defgrasp_evaluator",
                name="defgrasp_evaluator",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file"), {"autostart": autostart}],
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
                emulate_tty=True,
            ),
        ]
    )
