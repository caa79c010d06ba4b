"""Names that exist on the controller and are not emulated.

A program may contain them; it ends with an error when it calls one.
"""

from typing import Final

from urscript.builtins import Library

__all__ = ["LIBRARY"]

LIBRARY: Final = Library("refused")

# chapter note: (first CB3 version, first e-Series version, names); None: never on that series. The minor versions
# of the newer ones are guesses where the function list has them as 5.1x and 5.2x.
_REFUSED: Final[dict[str, tuple[tuple[str | None, str | None, str], ...]]] = {
    "conveyor tracking": (
        (
            "3.0",
            "5.0",
            "conveyor_pulse_decode encoder_enable_pulse_decode encoder_enable_set_tick_count encoder_get_tick_count"
            " encoder_set_tick_count encoder_unwind_delta_tick_count get_conveyor_tick_count set_conveyor_tick_count"
            " track_conveyor_circular track_conveyor_linear stop_conveyor_tracking",
        ),
    ),
    "screw driving": ((None, "5.0", "screw_driving end_screw_driving"),),
    "path offsets": (
        (
            None,
            "5.9",
            "path_offset_enable path_offset_disable path_offset_set path_offset_get path_offset_set_alpha_filter"
            " path_offset_set_max_offset",
        ),
    ),
    "tuning of the motion controller": (
        ("3.0", "5.0", "pause_on_error_code"),
        (None, "5.10", "high_holding_torque_enable high_holding_torque_disable"),
        (None, "5.19", "tool_wrench_limit_set"),
        (None, "5.20", "jerk_gain_scaling_set jerk_gain_scaling_get"),
    ),
    "a moving base": ((None, "5.20", "get_base_acceleration set_base_acceleration"),),
    "the base light": ((None, "5.20", "set_baselight_off set_baselight_iec set_baselight_solid"),),
    "payload estimation": ((None, "5.20", "estimate_payload"),),
    "Ethernet/IP": (("3.0", "5.0", "eip_writer_factory eip_reader_factory"),),
    "interpreter mode": (("3.12", "5.6", "interpreter_mode end_interpreter clear_interpreter"),),
    "ROS 2": (
        (
            None,
            "5.10",
            "ros_publisher_factory ros_subscriber_factory ros_service_client_factory ros_action_client_factory",
        ),
    ),
    "Euromap 67": (
        (
            "3.0",
            "5.0",
            "set_euromap_output get_euromap_input get_euromap_output set_euromap_runstate_dependent_choice",
        ),
    ),
    "the world model": (
        (
            None,
            "5.10",
            "add_frame attach_frame delete_all_frames delete_frame move_frame get_pose convert_pose reset_world_model"
            " is_frame get_frame_parent get_children frame_tracking_enable frame_tracking_disable",
        ),
        (None, "5.20", "set_mass_properties set_payload_from_attached_frames"),
    ),
}

for _note, _rows in _REFUSED.items():
    for _cb3, _e, _names in _rows:
        for _name in _names.split():
            LIBRARY.refuse(_name, cb3=_cb3, e=_e, note=_note)
