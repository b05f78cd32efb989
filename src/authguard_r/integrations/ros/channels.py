# SPDX-License-Identifier: Apache-2.0
"""The input channels that a map names are the site's: no topic is shown by one without a label.

Spec page: docs/spec/ros.md#shown-topics
"""

from __future__ import annotations

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.ros.map import RosMap
from authguard_r.site.channels import channel_labels
from authguard_r.site.model import Site


def require_channels(ros: RosMap, site: Site) -> None:
    """Require that every channel of what is shown has a label.

    Raises:
        MalformedError: the first that has none, with its place.
    """
    known = channel_labels(site.channels)
    for key, shown in ros.shown.items():
        if shown.channel and shown.channel not in known:
            raise MalformedError(
                f"expected a channel of the site, got `{shown.channel}`",
                where=f"map.shown.{key}.channel",
            )
