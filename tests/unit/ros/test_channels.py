# SPDX-License-Identifier: Apache-2.0
"""A topic is shown by a channel that the site has a label for, or by none.

Source: docs/spec/ros.md#shown-topics
"""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.core.provenance import Label
from authguard_r.integrations.ros.channels import require_channels
from authguard_r.integrations.ros.map import RosMap
from fixtures import scenarios
from fixtures.ros_keystores import example


def shown_by(channel: str) -> RosMap:
    ros = example()
    return replace(ros, shown={"sign": replace(ros.shown["sign"], channel=channel)})


def test_a_channel_that_the_site_does_not_have_is_refused_with_its_place() -> None:
    with pytest.raises(MalformedError) as failed:
        require_channels(shown_by("rumor"), scenarios.site())
    assert failed.value.where == "map.shown.sign.channel"


def test_shipped_channels_the_sites_own_and_none_are_taken() -> None:
    site = scenarios.site()
    for channel in ("", "ocr", "tool"):
        require_channels(shown_by(channel), site)
    own = replace(site, channels={Identifier("rumor"): Label.MEMORY})
    require_channels(shown_by("rumor"), own)
