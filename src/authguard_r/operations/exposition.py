# SPDX-License-Identifier: Apache-2.0
"""Counts in the text format of Prometheus, and the small server that hands them out."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.registry import Collector

from authguard_r.core.errors import AuthGuardError

_NAME = re.compile(r"\A[a-z][a-z0-9_]{0,63}\Z")
#: A label's value is a code or a role: nothing that a mission or a planner could have spelled.
_LABEL = re.compile(r"\A[A-Za-z][A-Za-z0-9_]{0,63}\Z")
_PATIENCE_S = 10


def exposition(metrics: dict[str, Any]) -> bytes:
    """Return counts as text.

    Args:
        metrics: name to number, or to numbers by label; anything else is left out, so that no
            words of a mission can get here.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Once(metrics))
    return generate_latest(registry)


class _Once(Collector):
    """Hands one reading over (`prometheus_client.registry.Collector`)."""

    def __init__(self, metrics: dict[str, Any]) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        """Yield every metric that is a number, or numbers by codes."""
        for name, value in sorted(self._metrics.items()):
            if _NAME.match(name):
                yield _family(name, value)


def _family(name: str, value: Any) -> Metric:
    """Return one metric; a name that ends in `_total` only grows."""
    kind = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
    if not isinstance(value, dict):
        family = kind(f"authguard_{name}", _words(name))
        if _is_number(value):
            family.add_metric([], value)
        return family
    family = kind(f"authguard_{name}", _words(name), labels=["kind"])
    for of, number in sorted(value.items()):
        if _LABEL.match(of) and _is_number(number):
            family.add_metric([of], number)
    return family


def _words(name: str) -> str:
    return name.removesuffix("_total").replace("_", " ")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def serve(host: str, port: int, read: Callable[[], dict[str, Any]]) -> None:
    """Answer every scrape with a fresh reading, until interrupted."""

    class Answer(BaseHTTPRequestHandler):
        timeout = _PATIENCE_S

        def do_GET(self) -> None:
            """Answer one scrape; a gate that is away is 503, so that its absence is seen."""
            if self.path != "/metrics":
                self.send_error(404)
                return
            try:
                body = exposition(read())
            except AuthGuardError as error:
                self.send_error(503, str(error.reason))
                return
            self.send_response(200)
            self.send_header("Content-Type", CONTENT_TYPE_PLAIN_0_0_4)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            """Say nothing: a scrape every few seconds is no news."""

    with ThreadingHTTPServer((host, port), Answer) as server:
        server.daemon_threads = True
        sys.stdout.write(f"http://{host}:{server.server_port}/metrics\n")
        sys.stdout.flush()
        server.serve_forever(poll_interval=0.1)
