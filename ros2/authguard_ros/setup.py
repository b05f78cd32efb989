# SPDX-License-Identifier: Apache-2.0
"""The package as colcon builds it; what its scripts start is in `authguard-r`."""

from setuptools import setup

NAME = "authguard_ros"

setup(
    name=NAME,
    version="0.1.0",
    description="Starts the processes of AuthGuard-R on ROS 2.",
    license="Apache-2.0",
    maintainer="The AuthGuard-R authors",
    maintainer_email="authguard-r@example.org",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/guarded.launch.py"]),
    ],
    zip_safe=True,
    entry_points={
        "console_scripts": [
            f"gate_node = {NAME}.processes:gate_node",
            f"actuator = {NAME}.processes:actuator",
            f"deadman = {NAME}.processes:deadman",
            f"estimator = {NAME}.processes:estimator",
        ]
    },
)
