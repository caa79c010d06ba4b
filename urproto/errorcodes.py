"""Texts for the error codes in the controller's log. The wording is ours, because a controller usually sends no text.

Source of numbers, arguments and meaning: the error table of the vendor's public C++ libraries. The texts are only shown
to people; drivers evaluate the code and the level.
"""

from typing import Final

from urproto.joints import JOINT_LABELS

_TEXTS: Final[dict[int, str]] = {
    50: "The arm has no 48 V supply",
    57: "The brakes could not be released",
    58: "The encoder of a motor is not calibrated",
    59: "A motor draws too much current",
    60: "The arm returned too much energy",
    61: "The arm at rest draws too much current",
    62: "A joint is too warm",
    71: "A joint failed its self-test at startup",
    74: "A joint's encoder gave a warning",
    75: "A joint's encoder reports an error",
    100: "The robot changed mode",
    101: "A real robot is connected",
    102: "No real robot is connected: running in simulation",
    103: "The safety control board does not communicate properly",
    104: "An empty command was sent to the robot",
    111: "An external force pulls the robot: check mounting and payload",
    115: "The robot type is unknown",
    116: "The real-time part of the controller gave a warning",
    117: "The safety control board could not be restarted",
    150: "The arm is close to a joint limit",
    151: "The arm is close to the tool orientation limit",
    152: "The arm is close to a safety plane",
    153: "The position deviates from the path",
    154: "The position is in a singularity",
    155: "The robot cannot hold its position: check the payload",
    156: "Wrong payload or mounting, or the arm was pushed while freedrive began",
    157: "A collision was detected",
    158: "A collision was detected; the payload is set to 0 kg: check whether that is correct",
    159: "The position deviates from the path; the payload is set to 0 kg: check whether that is correct",
    160: "The arm was switched off: joints disagree",
    161: "The arm was moved while it was off",
    162: "The protective stop was probably caused by a wrong payload",
    163: "More than 50 protective stops on one joint within eight hours",
    164: "A wrist is close to a safety plane",
    171: "There is a problem with a blend",
    172: "Illegal control mode",
    173: "The joint torques are too high",
    174: "The joint torques changed too abruptly",
    191: "A safety limit was violated",
    192: "The safety system found a fault",
    193: "A joint reports a fault",
    194: "A part of the robot has not booted, or is not ready",
    195: "The conveyor is too fast to track",
    196: "A movep is too fast",
    197: "Blend radii overlap",
    200: "The safety control board found a fault in its hardware",
    201: "The safety control board is not configured correctly",
    202: "The safety configuration is invalid",
    203: "The displayed safety configuration is not the active one",
    204: "The path failed its check",
    205: "The target speed does not match the target position",
    206: "The target speed of a joint does not match its target position",
    207: "The input of a fieldbus was disconnected",
    209: "A protective stop was requested by the program",
    210: "The socket is read-only: scripts need a port that takes them and, on e-Series, remote control",
    211: "The operational mode changed",
    212: "Names collide in the loaded program",
    213: "The calibration of the arm is missing or belongs to another arm",
    217: "A string begins with white space",
    218: "A thread used too much time",
    219: "A path offset moves too fast",
    222: "A tracked frame moves too fast",
    271: "The program is in an infinite loop: put sync() or sleep() into loops that do not move the robot",
    309: "The keep-alive of the safety control board failed",
    400: "The elbow is close to a safety plane",
    403: "The tool flange is close to the lower arm: risk of clamping",
}

_ARGUMENTS: Final[dict[int, dict[int, str]]] = {
    62: {1: "above 80 °C", 3: "under load for too long while at rest", 11: "above 85 °C, switched off"},
    171: {
        0: "a waypoint of a movec was skipped",
        1: "the radius in a movec is too small",
        3: "a waypoint of a servoc was skipped",
        **dict.fromkeys(range(4, 8), "overlapping blends in a movej, a waypoint was skipped"),
        9: "a waypoint of a movep was skipped",
        10: "the radius in a movep is too small",
        **dict.fromkeys(range(11, 15), "overlapping blends in a movel, a waypoint was skipped"),
    },
    191: {
        1: "joint position",
        2: "joint speed",
        3: "tool speed",
        4: "tool position",
        5: "tool orientation",
        6: "power",
        7: "joint torque",
        8: "joint torque",
        12: "momentum",
        14: "it does not slow down for a stop",
        15: "it moves while it must stand still",
        16: "it takes too long to stop",
        **{32 + number: f"speed of {name}" for number, name in enumerate(JOINT_LABELS)},
    },
    195: {1: "joint speed", 2: "tool speed", 3: "momentum"},
    204: {
        1: "the target position jumped",
        2: "target position and target speed are inconsistent",
        3: "it would stop too abruptly",
        4: "it did not stop in time",
        5: "the target given by the program is out of reach or not a number",
        6: "the target computed by the blend is out of reach or not a number",
        7: "a joint would accelerate too much near a singularity",
    },
    219: {1: "joint speed", 2: "tool speed", 3: "momentum"},
    222: {1: "joint speed", 2: "tool speed", 3: "momentum"},
}
_OF_JOINTS: Final = frozenset({153, 157, 158, 159, 163, 173, 174, 193, 206})  # arguments 0 to 5 are joints


def error_text(code: int, argument: int | None = None) -> str:
    """Text for an error code, with the meaning of its argument if one is given; neutral for unknown codes."""
    text = _TEXTS.get(code, f"Error code C{code}")
    if argument is None:
        return text
    if code in _OF_JOINTS and 0 <= argument < len(JOINT_LABELS):
        return f"{text}: {JOINT_LABELS[argument]}"
    detail = _ARGUMENTS.get(code, {}).get(argument)
    return f"{text}: {detail}" if detail else text
