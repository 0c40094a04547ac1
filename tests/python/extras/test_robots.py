"""The environments and the gripper of the extras, with the packages that they are for."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
import wsg_gateway
from airo_robots.awaitable_action import ACTION_STATUS_ENUM
from gateways import Gateway, until
from gymnasium.utils.env_checker import check_env
from openpi_client.runtime.agent import Agent
from openpi_client.runtime.runtime import Runtime
from wsg_gateway.airo import WsgGripper
from wsg_gateway.gymnasium import GripperEnv
from wsg_gateway.openpi import GripperEnvironment


@pytest.fixture
def left(gateway: Gateway) -> Iterator[wsg_gateway.Control]:
    """Control of the gripper with a part of 20 mm, whose fingers are open."""
    with wsg_gateway.connect(gateway.url) as client, client["left"].control("robot") as gripper:
        gripper.release(60, 300)
        yield gripper


@pytest.mark.filterwarnings("error::UserWarning")
def test_gymnasium_accepts_the_environment(left: wsg_gateway.Control) -> None:
    check_env(GripperEnv(left, force_n=30, speed_mm_s=400), skip_render_check=True)


def test_episode_ends_with_a_held_part(left: wsg_gateway.Control) -> None:
    env = GripperEnv(left, force_n=30, speed_mm_s=400, open_mm=60)
    values, info = env.reset(seed=1)
    assert values[0] == pytest.approx(60, abs=0.1) and info["outcome"] == "SUCCESS"
    values, reward, terminated, truncated, _ = env.step(np.array([40 / 110, 0], np.float32))
    assert (values[2], reward, terminated, truncated) == (0, 0, False, False)
    values, reward, terminated, _, info = env.step(np.array([20 / 110, 1], np.float32))
    assert env.newest and env.newest.contact_width_mm == pytest.approx(20, abs=0.3)
    assert (values[2], reward, terminated, info["outcome"]) == (1, 1, True, "PART_HELD")
    env.reset()
    assert not left.holding


def test_environment_says_why_it_cannot_move(left: wsg_gateway.Control) -> None:
    env = GripperEnv(left, force_n=30)
    stop = left.fast_stop("a test")
    with pytest.raises(wsg_gateway.Refused, match="fast_stop"):
        env.step(np.array([40 / 110, 0], np.float32))
    left.acknowledge(stop.id)


def test_airo_gripper_holds_a_part(left: wsg_gateway.Control) -> None:
    gripper = WsgGripper(left, speed=0.3, max_grasp_force=30)
    assert gripper.max_grasp_force == 30 and gripper.gripper_specs.max_width == pytest.approx(0.11)
    assert gripper.move(0.05).wait() == ACTION_STATUS_ENUM.SUCCEEDED
    until(lambda: gripper.get_current_width() == pytest.approx(0.05, abs=0.0002))
    assert not gripper.is_an_object_grasped()
    assert gripper.close().wait() == ACTION_STATUS_ENUM.SUCCEEDED
    assert gripper.is_an_object_grasped()
    # Firmware 4 pushes with half of the nominal force.
    until(lambda: left.force_n == pytest.approx(40, abs=3))
    gripper.open().wait()
    assert not gripper.is_an_object_grasped()


def test_airo_motion_gives_way_to_a_newer_one(left: wsg_gateway.Control) -> None:
    gripper = WsgGripper(left, speed=0.3)
    gripper.move(0.03).wait()
    slow = gripper.move(0.1, speed=0.01)
    until(lambda: left.moving)
    gripper.move(0.05, speed=0.3).wait()
    assert slow.wait() == ACTION_STATUS_ENUM.SUCCEEDED
    until(lambda: gripper.get_current_width() == pytest.approx(0.05, abs=0.0002))


def test_airo_refusal_is_raised_by_wait(left: wsg_gateway.Control) -> None:
    with pytest.raises(wsg_gateway.Refused, match="out_of_range"):
        WsgGripper(left).move(5.0).wait()


class Squeeze(Agent):
    """A policy that closes the gripper after ten steps."""

    def __init__(self) -> None:
        self.steps, self.positions = 0, list[float]()

    def get_action(self, observation: dict) -> dict:
        self.steps += 1
        self.positions.append(float(observation["observation/gripper_position"][0]))
        return {"actions": np.array([0, 0, 0, float(self.steps > 10)])}

    def reset(self) -> None:
        self.steps = 0


def test_openpi_runtime_closes_the_gripper(left: wsg_gateway.Control) -> None:
    agent = Squeeze()
    environment = GripperEnvironment(left, open_mm=60, speed_mm_s=300, episode_steps=60)
    started = time.monotonic()
    Runtime(environment, agent, [], max_hz=50).run()
    # The steps do not wait for the motion.
    assert time.monotonic() - started < 5
    assert agent.positions[0] == pytest.approx(0, abs=0.01)
    # The part of 20 mm stops the fingers.
    assert agent.positions[-1] == pytest.approx(40 / 60, abs=0.02)
    until(lambda: left.width_mm == pytest.approx(60, abs=0.2))


def test_openpi_action_raises_a_refusal(left: wsg_gateway.Control) -> None:
    environment = GripperEnvironment(left, open_mm=60)
    environment.reset()
    stop = left.fast_stop("a test")
    environment.apply_action({"actions": [1.0]})
    with pytest.raises(wsg_gateway.Refused, match="fast_stop"):
        until(lambda: environment.apply_action({"actions": [1.0]}), 5)
    left.acknowledge(stop.id)
