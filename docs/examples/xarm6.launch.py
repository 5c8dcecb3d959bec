"""Starts an xArm 6's driver and gridpush: ros2 launch xarm6.launch.py robot_ip:=192.168.1.20 scenario:=cell.yaml.

It needs ROS 2 with xarm_ros2. Nothing moves without go:=true. The tracker of the object is started beside it.
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
    "joint_trajectory_controller/joint_trajectory:=/xarm6_traj_controller/joint_trajectory",
]
"""What the xArm's driver calls gridpush's topics; without a sensor of force there is no wrench."""


def generate_launch_description() -> LaunchDescription:
    """The driver, and `gridpush robot`, which looks or, with go:=true, moves."""
    driver = PathJoinSubstitution(
        [FindPackageShare("xarm_controller"), "launch", "xarm6_control_rviz_display.launch.py"]
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
                launch_arguments={"robot_ip": LaunchConfiguration("robot_ip")}.items(),
            ),
            ExecuteProcess(cmd=[*command, *NAMES], output="screen", condition=UnlessCondition(go)),
            ExecuteProcess(
                cmd=[*command, "--go", *NAMES], output="screen", condition=IfCondition(go)
            ),
        ]
    )
