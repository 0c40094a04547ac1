"""Starts the node of one gripper, and the publisher of its transforms."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "url": ("http://127.0.0.1:8080", "address of the gateway"),
    "gripper": ("left", "name of the gripper at the gateway"),
    "name": ("wsg", "name of the node, before the names of its actions and services"),
    "token_file": ("", "file with the token, if the gateway has credentials"),
    "ca_file": ("", "file with the certificate authority to trust, if it is your own"),
    "moveit": ("false", "goals have the position of the joint, and fingers that close push against any part"),
    "description": ("true", "publish the transforms of the URDF"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch wsg_gateway_ros gripper.launch.py` starts."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    urdf = Path(get_package_share_directory("wsg_gateway_ros")) / "urdf/wsg50.urdf"

    def for_moveit(yes: str, no: str) -> PythonExpression:
        return PythonExpression([f"'{yes}' if '", value["moveit"], f"' == 'true' else '{no}'"])

    parameters = {name: value[name] for name in ("url", "gripper", "token_file", "ca_file")}
    parameters |= {"gripper_command_position": for_moveit("joint", "gap"), "closing": for_moveit("clamp", "grip")}
    # Otherwise an empty text would be read as YAML, and be no text.
    parameters = {name: ParameterValue(text, value_type=str) for name, text in parameters.items()}
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=default, description=text) for name, (default, text) in ARGUMENTS.items()]
        + [
            Node(package="wsg_gateway_ros", executable="gripper", name=value["name"], parameters=[parameters]),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": urdf.read_text()}],
                condition=IfCondition(value["description"]),
            ),
        ]
    )
