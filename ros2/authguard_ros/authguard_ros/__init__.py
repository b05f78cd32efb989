# SPDX-License-Identifier: Apache-2.0
"""The processes of AuthGuard-R as a package of ROS 2. What they do is in `authguard_r.ros`."""
