# SPDX-License-Identifier: Apache-2.0
"""Pairs and recorded tasks on a Ray cluster: the same results in the same order, whoever ran them.

A task that is lost with its process or machine is run again by Ray. Nothing is written but by the
process that asked, and no cluster is begun here: Ray's own listens on every interface. Needs
the extra `ray`. How-to: docs/howto/missionpair.md#on-a-cluster
"""

from __future__ import annotations

import os
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self, TypeVar

from missionpair import suites
from missionpair.campaign.plan import CampaignPlan
from missionpair.campaign.worker import TrialResult, Worker
from missionpair.pair import Suite

T = TypeVar("T")

_LOOPBACK = "127.0.0.1"
#: Seconds that an address has to answer in.
_PATIENCE_S = 5.0
#: Tasks that are under way at once, for each processor.
_AHEAD = 2


class ClusterError(Exception):
    """A cluster that cannot be had, or that lost a task for good.

    Args:
        message: what happened, and what to do.
        where: its address.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(f"{where}: {message}")
        self.message, self.where = message, where

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(ClusterError, where=self.where), (self.message,)


class Cluster:
    """A Ray cluster while it is used.

    Args:
        address: `auto` (the one of this machine), or `HOST:PORT`.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._ray: Any = None

    def __enter__(self) -> Self:
        """Connect.

        Raises:
            ClusterError: Ray is not installed, or nothing answers.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            self._ray = import_module("ray")
        except ImportError as error:
            raise self._error("install Ray: `pip install 'missionpair[ray]'`") from error
        # of this machine's loopback Ray would make the machine's own address
        is_here = self._host in {_LOOPBACK, "localhost"}
        options = {"_node_ip_address": _LOOPBACK} if is_here else {}
        try:
            self._require_heard()
            self._ray.init(self._address, log_to_driver=False, logging_level="ERROR", **options)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            why = str(error).partition("\n")[0]
            raise self._error(
                f"no Ray cluster answers there ({why}); begin one: `ray start`"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()

    def mapped(self, function: Callable[..., T], given: Iterable[tuple[Any, ...]]) -> Iterator[T]:
        """Yield what a function returns for each of the given arguments, in their order.

        Args:
            function: of a module that every machine of the cluster has.
            given: its arguments; taken as results are.

        Raises:
            ClusterError: a task was lost as often as Ray tries it.
            Exception: as the function raises.
        """
        ray, asked = self._ray, iter(given)
        remote = ray.remote(function)
        most = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        begun = deque(remote.remote(*one) for one in islice(asked, most))
        while begun:
            try:
                found: T = ray.get(begun.popleft())
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
            except ray.exceptions.RayError as error:
                why = str(error).partition("\n")[0]
                text = f"a task was lost for good ({why}); the written trials stay, run again"
                raise self._error(text) from error
            yield found
            begun += [remote.remote(*one) for one in islice(asked, 1)]

    @property
    def _host(self) -> str:
        return self._address.rpartition(":")[0]

    def _require_heard(self) -> None:
        """Try the address once: Ray itself tries for minutes, or begins a cluster for other words.

        Raises:
            OSError: nothing listens there.
            ValueError: it is no address.
        """
        if not self._host and self._address != "auto":
            raise ValueError("expected HOST:PORT or auto")
        if self._host:
            port = int(self._address.rpartition(":")[2])
            if not 0 < port < 1 << 16:
                raise ValueError("expected a port from 1 to 65535")
            socket.create_connection((self._host, port), timeout=_PATIENCE_S).close()

    def _error(self, message: str) -> ClusterError:
        return ClusterError(message, where=f"--ray {self._address}")


def on_cluster(worker: Worker, address: str, numbers: Iterable[int]) -> Iterator[TrialResult]:
    """Yield the trials of these pairs, in order, each pair run by some machine of a cluster.

    Args:
        worker: what is run; it holds what the log has already.
        address: as `Cluster` takes it.
        numbers: the pairs.

    Raises:
        ClusterError: as `Cluster`.
        Exception: as `Worker.trials`.
    """
    with Cluster(address) as cluster:
        known = (worker.digest, _parameters(worker))
        fixed = (worker.plan, known, worker.done, worker.held)
        for trials in cluster.mapped(pair_ran, ((*fixed, number) for number in numbers)):
            yield from trials


def pair_ran(
    plan: CampaignPlan,
    known: tuple[str, list[dict[str, Any]]],
    done: int,
    held: frozenset[str],
    number: int,
) -> list[TrialResult]:
    """Run one pair of a campaign here, and return its trials.

    Args:
        plan: what is asked for.
        known: the suite's digest, and the parameters of who takes part, where the run was begun.
        done: trials below this number are in the log.
        held: defenses that are held to the pair's benign run.
        number: the pair's.

    Raises:
        ClusterError: this machine has another version of the suite, or of a file that is named.
        Exception: as `Worker.trials`.
    """
    suite, found = _suite(plan.suite)
    if found != known[0]:
        text = f"a machine has another `{plan.suite}`: install one version everywhere"
        raise ClusterError(text, where=os.uname().nodename)
    with TemporaryDirectory(prefix="missionpair-") as folder:
        worker = Worker(plan, (suite, found), Path(folder) / "keys")
        if _parameters(worker) != known[1]:
            text = "a machine has another file of this name: copy the same one everywhere"
            raise ClusterError(text, where=os.uname().nodename)
        worker.done, worker.held = done, held
        return list(worker.trials(number))


def _parameters(worker: Worker) -> list[dict[str, Any]]:
    """Return what shapes planner, attacker and defenses, the digests of their files among it."""
    setting = worker.setting
    parts = (setting.planner, setting.attacker, *setting.defenses)
    return [dict(getattr(part, "parameters", {})) for part in parts]


@lru_cache(maxsize=1)
def _suite(name: str) -> tuple[Suite, str]:
    return suites.load(name)
