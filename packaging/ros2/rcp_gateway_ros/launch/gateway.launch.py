"""Start the gateway: `ros2 launch rcp_gateway_ros gateway.launch.py config:=rcp.toml port:=8080`."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

CONFIG = Path(__file__).parents[1] / "config" / "gateway.toml"


def generate_launch_description() -> LaunchDescription:
    """Return the process, with SIGINT and SIGTERM long enough for the robots to come to rest."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=str(CONFIG), description="Configuration"),
            DeclareLaunchArgument("port", default_value="8080", description="Port to listen on"),
            ExecuteProcess(
                cmd=[
                    "rcpd",
                    "serve",
                    LaunchConfiguration("config"),
                    "--port",
                    LaunchConfiguration("port"),
                ],
                name="rcp_gateway",
                output="screen",
                sigterm_timeout="20",
                sigkill_timeout="10",
            ),
        ]
    )
