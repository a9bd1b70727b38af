"""The ROS 2 package: a launch file and a configuration; the gateway is installed with pip."""

from pathlib import Path

from setuptools import setup

NAME = "rcp_gateway_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [str(path) for path in Path("launch").glob("*.py")]),
        (f"share/{NAME}/config", [str(path) for path in Path("config").glob("*.toml")]),
    ],
    install_requires=["setuptools", "rcp-gateway"],
    zip_safe=True,
    license="Apache-2.0",
)
