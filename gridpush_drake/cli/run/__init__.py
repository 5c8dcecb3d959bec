"""Commands that plan for a robot, and run one."""
