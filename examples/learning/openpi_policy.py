"""A policy that an openpi server computes, such as pi0 fine-tuned on a UR5, for `ur-emulator evaluate`.

    pip install '.[learning]' openpi-client
    PROMPT="put the part at its place" ur-emulator evaluate pick_and_place --workers 1 \\
        --policy examples/learning/openpi_policy.py:load \\
        --option control_mode=joint_position --option cameras=overview,wrist --latency 0.08

Observations have the layout of openpi's example for a UR5: joints (6) [rad], gripper (1), base_rgb and wrist_rgb
(224, 224, 3), prompt. Actions are chunks of joint angles and a gripper, 0 open to 1 closed, of which HORIZON are
executed before the next request.
"""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openpi_client import action_chunk_broker, image_tools, websocket_client_policy

HOST, PORT = os.environ.get("OPENPI_HOST", "localhost"), int(os.environ.get("OPENPI_PORT", "8000"))
HORIZON = int(os.environ.get("HORIZON", "10"))
PROMPT = os.environ.get("PROMPT", "bring the part to its goal")
PIXELS = 224
JOINTS, GRIPPER_CLOSED = slice(6, 12), 18  # in an observation, see `observed`


class OpenpiPolicy:
    """Asks the server for the next actions when those of the last answer are used up."""

    def __init__(self, env: Any) -> None:
        server = websocket_client_policy.WebsocketClientPolicy(HOST, PORT)
        self._policy = action_chunk_broker.ActionChunkBroker(server, HORIZON)
        self._has_gripper = env.task.gripper is not None

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._policy.reset()

    def __call__(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """The action for an observation."""
        numbers, pictures = seen["observation"], seen["pixels"]
        gripper = numbers[GRIPPER_CLOSED] if self._has_gripper else 0.0
        asked = {
            "joints": numbers[JOINTS],
            "gripper": np.array([gripper], np.float32),
            "base_rgb": image_tools.resize_with_pad(pictures["overview"], PIXELS, PIXELS),
            "wrist_rgb": image_tools.resize_with_pad(pictures["wrist"], PIXELS, PIXELS),
            "prompt": PROMPT,
        }
        *joints, gripper = np.asarray(self._policy.infer(asked)["actions"], np.float32)[:7]
        return np.array([*joints, 2.0 * gripper - 1.0] if self._has_gripper else joints, np.float32)


load = OpenpiPolicy
