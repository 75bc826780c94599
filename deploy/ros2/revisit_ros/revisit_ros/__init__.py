"""revisit in ROS 2. Only `messages`, `node`, `localize_node` and `enroll_node` import anything of ROS."""
