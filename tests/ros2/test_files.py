"""The description and the configuration fit the node."""

from __future__ import annotations

import ast
import xml.etree.ElementTree as ET
from pathlib import Path

import yaml

PACKAGE = Path(__file__).resolve().parents[2] / "deploy/ros2"


def test_one_joint_mimics_the_other() -> None:
    joints = {joint.get("name"): joint for joint in ET.parse(PACKAGE / "urdf/wsg50.urdf").getroot().iter("joint")}
    mimics = {name: mimic.get("joint") for name, joint in joints.items() if (mimic := joint.find("mimic")) is not None}
    assert mimics == {"finger_right_joint": "finger_left_joint"}
    for name in ("finger_left_joint", "finger_right_joint"):
        limit = joints[name].find("limit")
        assert limit is not None and float(limit.get("upper", 0)) == 0.055


def test_moveit_names_the_node_its_action_and_its_joint() -> None:
    from wsg_gateway_ros.node import PARAMETERS

    manager = yaml.safe_load((PACKAGE / "config/moveit_controllers.yaml").read_text())["moveit_simple_controller_manager"]
    assert manager["controller_names"] == ["wsg"]
    assert manager["wsg"]["joints"] == [PARAMETERS["joint"]] and manager["wsg"]["action_ns"] == "gripper_cmd"


def test_launch_file_sets_parameters_that_exist() -> None:
    from wsg_gateway_ros.node import PARAMETERS

    tree = ast.parse((PACKAGE / "launch/gripper.launch.py").read_text())
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    assert {"url", "gripper", "token_file", "ca_file", "gripper_command_position", "closing"} <= texts & PARAMETERS.keys()
