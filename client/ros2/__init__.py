"""The ROS 2 driver: a robot with its controllers as nodes on rclpy. `driver` puts it together, `host` runs nodes."""
