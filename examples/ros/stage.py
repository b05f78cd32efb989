# SPDX-License-Identifier: Apache-2.0
"""Processes of the story, their keys and files; whatever was started here is ended here."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any, Self

from authguard_r import AuthGuardError, ClientRole, GateClient, read_trust
from authguard_r.integrations.ros import RobotId

HERE = Path(__file__).resolve().parent
ROBOT = RobotId("courier-1")
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 90.0
CLI = (sys.executable, "-c", "import sys; from authguard_r.cli import main; sys.exit(main())")
NODES = "authguard_r.integrations.ros.nodes"
#: How messages are carried, as on a robot: on this machine alone, without shared memory.
PROFILE = HERE.parents[1] / "deploy" / "ros" / "loopback.xml"
#: The security of a shell that has one is not the bench's, and neither are its transports.
_DROPPED = ("ROS_SECURITY_", "FASTDDS_", "FASTRTPS_")

#: Set: the story was told to end. A signal's handler raises nothing: a process that is just being
#: started would be left behind.
OVER = threading.Event()

Line = dict[str, Any]


class StageError(Exception):
    """Something of the story did not come about; the message says what."""


def until(holds: Callable[[], Any], what: str) -> Any:
    """Return the first true answer.

    Raises:
        StageError: there was none in time, or the story was told to end.
    """
    end = time.monotonic() + PATIENCE_S
    while not (answer := holds()):
        if OVER.is_set():
            raise StageError("a signal told it to end")
        if time.monotonic() > end:
            raise StageError(f"{what} did not happen within {PATIENCE_S:.0f} s")
        time.sleep(0.02)
    return answer


def variables(folder: Path) -> dict[str, str]:
    """Return the variables of every process: this machine alone."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(_DROPPED)}
    return {
        **kept,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTDDS_DEFAULT_PROFILES_FILE": str(PROFILE),
        "ROS_STATIC_PEERS": "",
        "ROS_LOG_DIR": str(folder / "log"),
    }


class Actor:
    """A process that tells lines of JSON, and may be told lines.

    Args:
        name: for its files and messages.
        words: what starts it.
        folder: for what it writes to standard error.
    """

    def __init__(self, name: str, words: list[str], folder: Path) -> None:
        self.name = name
        self.lines: list[Line] = []
        self._errors = folder / f"{name}.err"
        with self._errors.open("w") as errors:
            self.process = subprocess.Popen(  # noqa: S603 - our own programs, no shell
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=variables(folder),
            )
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def _read(self) -> None:
        for line in self.process.stdout or ():
            text = line.strip()
            if text.startswith("{"):
                self.lines.append(json.loads(text))
            elif text == "ready":
                self.lines.append({"event": "ready"})

    def tell(self, line: str) -> int:
        """Tell it a line; return when, on the machine's monotonic clock in nanoseconds."""
        told_ns = time.monotonic_ns()
        if self.process.stdin is None:
            raise StageError(f"`{self.name}` hears nothing")
        try:
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()
        except OSError as error:
            raise StageError(f"`{self.name}` ended: {self.why()}") from error
        return told_ns

    def events(self, event: str, after_ns: int = 0) -> list[Line]:
        """Return what it told of a kind since then."""
        recent = takewhile(lambda line: line.get("ns", 0) >= after_ns, reversed(self.lines))
        return [line for line in recent if line.get("event") == event][::-1]

    def next(self, event: str, after_ns: int = 0) -> Line:
        """Wait for the first line of a kind since then.

        Raises:
            StageError: it ended, or told nothing in time.
        """

        def found() -> Line | None:
            if self.process.poll() is not None:
                raise StageError(f"`{self.name}` ended: {self.why()}")
            return next(iter(self.events(event, after_ns)), None)

        line: Line = until(found, f"`{event}` of `{self.name}`")
        return line

    def ready(self) -> Line:
        """Wait until it says that it is ready."""

        def is_ready() -> Line | None:
            if self.process.poll() is not None:
                raise StageError(f"`{self.name}` ended: {self.why()}")
            said = (x for x in self.lines if x.get("ready") is True or x.get("event") == "ready")
            return next(said, None)

        line: Line = until(is_ready, f"the start of `{self.name}`")
        return line

    def said(self) -> str:
        """Return what it wrote to standard error."""
        return self._errors.read_text()

    def why(self) -> str:
        """Return its last words: on standard error, or else the last line that it told."""
        told = json.dumps(self.lines[-1]) if self.lines else ""
        return self.said().strip()[-2_000:] or told

    def logged(self) -> list[Line]:
        """Return every whole line of JSON of its standard error."""
        whole, _, _ = self.said().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines() if line.startswith("{")]

    def kill(self) -> int:
        """Kill it as a crash would; return when, on the machine's monotonic clock."""
        killed_ns = time.monotonic_ns()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(PATIENCE_S)
        return killed_ns

    def end(self) -> int:
        """End it, by force if it does not go; return its exit code."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()
        finally:
            self._reading.join(5)
            for pipe in (self.process.stdin, self.process.stdout):
                with suppress(OSError):
                    if pipe is not None:
                        pipe.close()


class Watch:
    """What happens at a gate, as it happens: the log counts a refusal that comes again.

    Args:
        client: connected; it belongs to the watch from now on.
    """

    def __init__(self, client: GateClient) -> None:
        self.events: list[Line] = []
        self._client = client
        self._told = client.watch()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with suppress(AuthGuardError), self._client:  # the gate has gone
            self.events.extend(self._told)

    def next(self, seen: int, event: str, outcome: str) -> Line:
        """Wait for a decision or an end that came out so, of the events after the first `seen`.

        Raises:
            StageError: there was none in time.
        """

        def found() -> Line | None:
            new = (e for e in self.events[seen:] if e.get("event") == event)
            return next((e for e in new if outcome in {e.get("outcome"), _ended(e)}), None)

        line: Line = until(found, f"`{event}` at the gate")
        return line


def _ended(event: Line) -> str | None:
    execution = event.get("execution") or {}
    return execution.get("outcome")


class Stage:
    """The set: keys of everybody, a gate, ROS's processes; a context manager.

    Args:
        folder: for all of it; empty.
        domain: the ROS domain that the story has to itself.
        at: where the robot stands at first, in meters.
    """

    def __init__(self, folder: Path, domain: int, at: tuple[float, float]) -> None:
        self.folder = folder
        self.run = folder / "run"
        self.store, self.trust = folder / "robot.db", folder / "trust"
        self.map = folder / "map.yaml"
        self._at = at
        self._actors: list[Actor] = []
        self.run.mkdir(mode=0o755)
        text = (HERE / "map.yaml").read_text()
        self.map.write_text(text.replace("domain: 42", f"domain: {domain}"))

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        """Start everything, each once the one before is there."""
        site, trust, keys = str(HERE / "site.yaml"), str(self.trust), self.trust / "keys"
        run, path = str(self.run), str(self.map)
        self.authguard("keys", "init", trust, "--site", site)
        config = str(self.folder / "gate.token")
        words = ["--robot", ROBOT, "--trust", trust, "--out", config]
        self.authguard("gate-config", "make", "--demo", *words)
        binding = str(HERE / "binding.yaml")
        places = ["--site", site, "--trust", trust, "--gate", run]
        files = ["--binding", binding, "--config", config, "--store", str(self.store)]
        self.gate = self._add(
            "gate", [*CLI, "gate", *places, *files, "--robot", ROBOT, "--demo", "--json"]
        )
        self.watch = Watch(self.operator())
        x, y = map(str, self._at)
        self.robot = self._add("robot", [sys.executable, str(HERE / "robot.py"), path, run, x, y])
        key = str(keys / f"estimator-{ROBOT}")
        mine = ["--key", f"{key}.key.pem", "--cert", f"{key}.cert.pem"]
        self.estimator = self._add(
            "estimator", [*_node("estimator"), "--map", path, *places, *mine, "--demo"]
        )
        self.node = self._add(
            "node", [*_node("node"), "--map", path, *places, "--binding", binding, "--demo"]
        )
        self.deadman = self._add("deadman", [*_node("deadman"), path, "--demo"])
        until(lambda: self.deadman_said("armed"), "an armed dead-man")
        planner = [sys.executable, str(HERE / "planner.py"), path]
        self.planner = self._add("planner", planner)

    def _add(self, name: str, words: list[str]) -> Actor:
        made = Actor(name, words, self.folder)
        self._actors.append(made)
        made.ready()
        return made

    def deadman_said(self, event: str) -> list[Line]:
        """Return the dead-man's lines of a kind."""
        return [line for line in self.deadman.logged() if line.get("event") == event]

    def authguard(self, *words: str) -> Line:
        """Run a command of the program; return the JSON object that it prints.

        Raises:
            StageError: it failed.
        """
        done = subprocess.run(  # noqa: S603 - our own program, no shell
            [*CLI, *words, "--json"],
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_S,
            env=variables(self.folder),
        )
        if done.returncode != 0:
            raise StageError(f"authguard {' '.join(words)}: {done.stderr.strip()[-2_000:]}")
        said: Line = json.loads(done.stdout or "{}")
        return said

    def sign(self, draft: str, before: Path | None = None) -> Path:
        """Compile a draft, sign it as the operator, and make it active; return the token."""
        site = ["--site", str(HERE / "site.yaml")]
        name = Path(draft).stem
        made, token = self.folder / f"{name}.json", self.folder / f"{name}.token"
        more = [] if before is None else ["--supersedes", str(before)]
        words = [str(HERE / draft), *site, "--out", str(made), "--no-input", *more]
        self.authguard("mission", "compile", *words)
        key = str(self.trust / "keys" / "operator-1")
        mine = ["--key", f"{key}.key.pem", "--cert", f"{key}.cert.pem"]
        self.authguard("mission", "sign", str(made), *mine, *site, "--out", str(token), "--yes")
        words = ["--trust", str(self.trust), *site, "--store", str(self.store)]
        self.authguard("mission", "activate", str(token), *words)
        return token

    def operator(self) -> GateClient:
        """Return a connected client that reads the log and asks what would be decided."""
        verifier = read_trust(self.trust)
        return GateClient.connect(
            self.run / "gate.sock", role=ClientRole.OPERATOR, verifier=verifier, robot=ROBOT
        )

    def close(self) -> None:
        """End everything that was started, the gate last."""
        order = sorted(self._actors, key=lambda actor: actor.name == "gate")
        for actor in order:
            actor.end()


def _node(name: str) -> list[str]:
    return [sys.executable, "-m", f"{NODES}.{name}"]
