"""Starts a UR5e's driver and gridpush: ros2 launch ur5e.launch.py robot_ip:=192.168.1.10 scenario:=cell.yaml.

It needs ROS 2 with ur_robot_driver. Nothing moves without go:=true. The tracker of the object is started beside it.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.conditions import IfCondition, UnlessCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

NAMES = [
    "--ros-args",
    "-r",
    "wrench:=/force_torque_sensor_broadcaster/wrench",
    "-r",
    "joint_trajectory_controller/joint_trajectory:=/scaled_joint_trajectory_controller/joint_trajectory",
]
"""What the UR's driver calls gridpush's topics."""


def generate_launch_description() -> LaunchDescription:
    """The driver, and `gridpush robot`, which looks or, with go:=true, moves."""
    driver = PathJoinSubstitution(
        [FindPackageShare("ur_robot_driver"), "launch", "ur_control.launch.py"]
    )
    command = ["gridpush", "robot", "--ros2", "--scenario", LaunchConfiguration("scenario")]
    go = LaunchConfiguration("go")
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip"),
            DeclareLaunchArgument("scenario"),
            DeclareLaunchArgument("go", default_value="false"),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(driver),
                launch_arguments={
                    "ur_type": "ur5e",
                    "robot_ip": LaunchConfiguration("robot_ip"),
                    "launch_rviz": "false",
                }.items(),
            ),
            ExecuteProcess(cmd=[*command, *NAMES], output="screen", condition=UnlessCondition(go)),
            ExecuteProcess(
                cmd=[*command, "--go", *NAMES], output="screen", condition=IfCondition(go)
            ),
        ]
    )
