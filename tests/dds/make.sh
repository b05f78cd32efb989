#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# A DDS with security, for tests: Debian's Cyclone DDS 0.10.2 unpacked into a folder, and its Python
# binding built against it. The wheels of ROS 2 carry no DDS security.
#
#     sh tests/dds/make.sh FOLDER
#
# Needs apt-get, dpkg, gcc and Python's headers; installs nothing outside the folder.
set -eu
mkdir -p "$1/packages" "$1/home"
folder=$(cd "$1" && pwd)

# apt drops its rights for a download, and says so where the folder is root's alone
(cd "$folder/packages" && apt-get download -q -o APT::Sandbox::User=root \
  libddsc0debian cyclonedds-dev cyclonedds-tools libcycloneddsidl0 \
  libiceoryx-binding-c2 libiceoryx-posh2 libiceoryx-hoofs2 libiceoryx-platform2 >/dev/null)
for package in "$folder"/packages/*.deb; do dpkg -x "$package" "$folder/packages/root"; done
cp -a "$folder"/packages/root/usr/. "$folder/home/"

# Debian has its libraries one folder deeper than the binding looks for them
arch=$(dpkg-architecture -qDEB_HOST_MULTIARCH 2>/dev/null || gcc -dumpmachine)
libraries="$folder/home/lib/$arch"
cp -r "$folder/home/include/$arch/." "$folder/home/include/"
mkdir -p "$folder/home/lib/cmake"
ln -sfn "$libraries/cmake/CycloneDDS" "$folder/home/lib/cmake/CycloneDDS"
for library in "$libraries"/libddsc.so* "$libraries"/libcycloneddsidl.so*; do
  ln -sfn "$library" "$folder/home/lib/"
done

python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check wheel "setuptools<70"
CYCLONEDDS_HOME="$folder/home" CMAKE_PREFIX_PATH="$folder/home" LD_LIBRARY_PATH="$libraries" \
  "$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
  --no-binary cyclonedds --no-build-isolation "cyclonedds==0.10.2"
ln -sfn "$libraries" "$folder/libraries"
