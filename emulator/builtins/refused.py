"""Functions that exist on the controller but are not emulated.

A program may mention them; it ends with an error when it calls one.
"""

from typing import Final

from urscript.builtins import Library

LIBRARY: Final = Library("refused")

# Note: (first CB3 version, first e-Series version, names); None: not on that series. The minor versions of the
# newer ones are guesses where the function list only says 5.1x and 5.2x.
_REFUSED: Final[dict[str, tuple[tuple[str | None, str | None, str], ...]]] = {
    "Ethernet/IP needs a fieldbus interface, which is hardware": (
        ("3.0", "5.0", "eip_writer_factory eip_reader_factory"),
    ),
    "ROS 2 objects belong to PolyScope X, another product": (
        (
            None,
            "5.10",
            "ros_publisher_factory ros_subscriber_factory ros_service_client_factory ros_action_client_factory",
        ),
    ),
    "MotionPlus, which moves along tool paths of a CAM program, is a separate licence": (
        (  # Script Manual 5.11 and 5.12, module motionplus; the first version is a guess
            None,
            "5.0",
            "mc_add_circular mc_add_linear mc_add_path mc_get_target_rtcp_speed mc_initialize mc_load_path "
            "mc_run_motion mc_set_pcs mc_set_speed_factor",
        ),
    ),
    "Euromap 67 is a hardware interface to moulding machines": (
        (
            "3.0",
            "5.0",
            "set_euromap_output get_euromap_input get_euromap_output set_euromap_runstate_dependent_choice",
        ),
    ),
}

for _note, _rows in _REFUSED.items():
    for _cb3, _e, _names in _rows:
        for _name in _names.split():
            LIBRARY.refuse(_name, cb3=_cb3, e=_e, note=_note)
