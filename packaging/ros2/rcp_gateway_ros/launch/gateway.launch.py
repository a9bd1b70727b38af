"""Start the gateway: `ros2 launch rcp_gateway_ros gateway.launch.py config:=rcp.toml port:=8080`."""

import os
import secrets
import shutil
import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

CONFIG = Path(__file__).parents[1] / "config" / "gateway.toml"


def generate_launch_description() -> LaunchDescription:
    """Return the process, with SIGINT and SIGTERM long enough for the robots to come to rest.

    Without OPERATOR_KEY in the environment, a key for this run is made and told.
    """
    given = os.environ.get("OPERATOR_KEY")
    key = given or f"rcp_op_{secrets.token_urlsafe(24)}"
    if not given:  # not by LogInfo, which also writes it into a file that others may read
        sys.stderr.write(f"operator key: {key}\n")
    # pip's folder of programs need not be on the path of a workspace.
    program = ["rcpd"] if shutil.which("rcpd") else [sys.executable, "-m", "rcpd"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=str(CONFIG), description="Configuration"),
            DeclareLaunchArgument("port", default_value="8080", description="Port to listen on"),
            ExecuteProcess(
                cmd=[
                    *program,
                    "serve",
                    LaunchConfiguration("config"),
                    "--port",
                    LaunchConfiguration("port"),
                ],
                name="rcp_gateway",
                output="screen",
                additional_env={"OPERATOR_KEY": key},
                sigterm_timeout="20",
                sigkill_timeout="10",
            ),
        ]
    )
