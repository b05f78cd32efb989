#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# ROS 2 in an environment of its own, with what the tests of nodes need: its wheels start every Python
# of their environment anew.
#
#     sh tests/ros/make.sh FOLDER
#     AUTHGUARD_ROS=FOLDER python3 dev.py test tests/integration/test_ros_nodes.py
#
# Needs `.venv` (python3 dev.py setup), cmake, ninja, a C compiler and Python's headers.
set -eu
cd "$(dirname "$0")/../.."
uv=.venv/bin/uv
"$uv" venv --quiet --python .venv/bin/python "$1"
"$uv" pip install --quiet --python "$1/bin/python" --editable ".[ros]" \
  coverage==7.17.3 pytest==9.2.0 hypothesis==6.170.15 ros-kilted-rclpy==9.1.2 \
  ros-rmw-fastrtps-cpp==9.3.3 ros-std-msgs==5.5.1 ros-geometry-msgs==5.5.1 ros-std-srvs==5.5.1 \
  ros-test-msgs==2.3.0 ros-diagnostic-msgs==5.5.1 ros-lifecycle-msgs==2.3.0 ros-rcl-lifecycle==10.1.3 \
  colcon-common-extensions==0.3.0 "setuptools<80"
UV="$uv" bash tests/ros/build_interfaces.sh "$1"
