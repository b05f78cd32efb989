#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Run a command on ROS 2 in a network of its own, with shared memory of its own: nobody else is there.
# DDS uses UDP, as deploy/ros/ros.env says: over shared memory a process that is killed may leave a lock
# that no other can take.
#
#     sh tests/ros/alone.sh ENVIRONMENT/bin/python ...
set -eu
# what the wheels of ROS tell their own children is not for another environment
for name in $(env | sed -n 's/^\(_*ROS_WHEELS[A-Z_]*\)=.*/\1/p'); do unset "$name"; done
profile="$(cd "$(dirname "$0")/../.." && pwd)/deploy/ros/loopback.xml"
ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT FASTDDS_DEFAULT_PROFILES_FILE="$profile" \
  exec unshare --map-root-user --net --mount sh -c \
  'ip link set lo up && mount -t tmpfs shm /dev/shm && exec "$@"' sh "$@"
