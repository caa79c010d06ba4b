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
    "path offsets": (
        (
            None,
            "5.9",
            "path_offset_enable path_offset_disable path_offset_set path_offset_get path_offset_set_alpha_filter"
            " path_offset_set_max_offset",
        ),
    ),
    "Modbus": (
        (
            "3.0",
            "5.0",
            "modbus_add_signal modbus_delete_signal modbus_get_signal_status modbus_send_custom_command"
            " modbus_set_digital_input_action modbus_set_output_register modbus_set_output_signal"
            " modbus_set_signal_update_frequency modbus_set_runstate_dependent_choice"
            " read_port_bit read_port_register write_port_bit write_port_register",
        ),
        (
            None,
            "5.10",
            "modbus_add_rw_signal modbus_get_error modbus_get_time_since_signal_invalid modbus_set_signal_watchdog"
            " modbus_reset_connection",
        ),
    ),
    "Ethernet/IP needs a fieldbus interface, which is hardware": (
        ("3.0", "5.0", "eip_writer_factory eip_reader_factory"),
    ),
    "XML-RPC": (("3.0", "5.0", "rpc_factory"),),
    "interpreter mode": (("3.12", "5.6", "interpreter_mode end_interpreter clear_interpreter"),),
    "ROS 2 objects belong to PolyScope X, another product": (
        (
            None,
            "5.10",
            "ros_publisher_factory ros_subscriber_factory ros_service_client_factory ros_action_client_factory",
        ),
    ),
    "Euromap 67 is a hardware interface to moulding machines": (
        (
            "3.0",
            "5.0",
            "set_euromap_output get_euromap_input get_euromap_output set_euromap_runstate_dependent_choice",
        ),
    ),
    "frames are not tracked: a movement keeps to the base frame": (
        (None, "5.10", "frame_tracking_enable frame_tracking_disable"),
    ),
}

for _note, _rows in _REFUSED.items():
    for _cb3, _e, _names in _rows:
        for _name in _names.split():
            LIBRARY.refuse(_name, cb3=_cb3, e=_e, note=_note)
