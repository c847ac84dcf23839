"""Installs the node, with its launch file, parameters and view; `colcon build` runs this."""

import os
import sys

from setuptools import setup

NAME = "clustermcl_ros"

# The first line of the script `amcl` names the Python that runs it. That of colcon is the system's,
# which has no clustermcl: name that of the virtual environment that is active during the build.
if venv := os.environ.get("VIRTUAL_ENV"):
    sys.executable = f"{venv}/bin/python"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/localization.launch.py"]),
        (f"share/{NAME}/config", ["config/amcl.yaml"]),
        (f"share/{NAME}/rviz", ["rviz/clustermcl.rviz"]),
    ],
    zip_safe=True,
    entry_points={"console_scripts": [f"amcl = {NAME}.amcl:main"]},
)
