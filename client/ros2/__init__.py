"""The ROS 2 driver: a robot and its controllers as nodes on rclpy. `driver` assembles the nodes, `host` runs them."""
