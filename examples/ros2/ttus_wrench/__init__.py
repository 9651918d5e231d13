"""A ROS 2 node that renders a field of ttus_opt: poses in, wrenches out."""
