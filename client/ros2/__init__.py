"""ROS 2 without ROS: topics of a controlled robot on a DDS domain. `bridge` has the idea, `dds` the wire."""
