# SPDX-License-Identifier: Apache-2.0
"""A map, a binding and a site that do not fit each other are never served.

What each kind becomes, tests/ros/test_calls.py looks at. Spec page: docs/spec/ros.md#calls
"""

from __future__ import annotations

import pytest
import yaml

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.binding import Binding
from authguard_r.ros.calls import fitted
from authguard_r.site.model import Site
from authguard_r.site.source import parse_site, read_site
from authguard_r.tools.given import given_binding
from fixtures.ros_keystores import example, map_of, plain_map
from fixtures.scenarios import ROOT

HERE = ROOT / "examples" / "ros"


@pytest.fixture(scope="module")
def site() -> Site:
    return read_site(HERE / "site.yaml")


@pytest.fixture(scope="module")
def binding(site: Site) -> Binding:
    return given_binding(str(HERE / "binding.yaml"), site)


def brakeless() -> Site:
    """Return the example's site with a robot of which nobody knows how it brakes."""
    plain = yaml.safe_load((HERE / "site.yaml").read_text())
    for name in ("brake_mm_s2", "reaction_ms"):
        del plain["robots"]["courier-1"]["profile"][name]
    return parse_site(yaml.safe_dump(plain), where="site")


def test_the_examples_robot_is_served_whole(site: Site, binding: Binding) -> None:
    spoken = fitted(binding, example(), site)
    assert spoken.tools.keys() == {"send_action_goal", "publish", "call_service"}


def test_another_robots_map_is_served_by_no_gate_of_the_site(site: Site, binding: Binding) -> None:
    with pytest.raises(MalformedError, match="a robot of the site") as caught:
        fitted(binding, map_of({**plain_map(), "robot": "courier-9"}), site)
    assert caught.value.where == "map.robot"


def test_a_robot_that_nobody_knows_to_stand_has_no_streams(binding: Binding) -> None:
    with pytest.raises(MalformedError, match="how it brakes") as caught:
        fitted(binding, example(), brakeless())
    assert caught.value.where == "mediated.drive"
    still = plain_map()
    del still["mediated"]["drive"]
    assert "publish" not in fitted(binding, map_of(still), brakeless()).tools


def test_a_name_that_is_no_way_of_the_binding_is_not_served(site: Site, binding: Binding) -> None:
    plain = plain_map()
    plain["mediated"]["light"]["private"] = "/lamp"
    with pytest.raises(MalformedError, match="a way of the binding") as caught:
        fitted(binding, map_of(plain), site)
    assert caught.value.where == "mediated.light"
