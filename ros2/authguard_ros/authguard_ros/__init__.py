# SPDX-License-Identifier: Apache-2.0
"""The processes of AuthGuard-R as a ROS 2 package. Their code is `authguard_r.integrations.ros`."""
