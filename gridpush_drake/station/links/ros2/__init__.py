"""ROS 2 as a link: its messages, and the node that reads and writes them."""
