# SPDX-License-Identifier: Apache-2.0
"""Twelve tasks of a person who knows only `--help` and what the program prints.

    python twelve_tasks.py FOLDER

Each task begins with the list of commands. A command that a message names is typed as it stands.
The program is the one beside this Python, in CI a wheel's. Files and a planner are the person's
surroundings; FOLDER is new or empty. Exit 1: a task could not be done; its last output is shown.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from authguard_r import ClientRole, GateClient

PROGRAM = Path(sys.executable).with_name("authguard")
ROOM = """\
  store-room:
    {map: main, floor: 1, points: [[44000, 0], [46000, 0], [46000, 2000], [44000, 2000]],
     approach: [45000, 1000], %s: [staff], names: [Store Room]}
"""
PLANS = "ex/hospital/replies"


class LostError(Exception):
    """The help or a message does not say how to go on."""


class Person:
    """Somebody at a terminal, in a folder of the own.

    Args:
        folder: the folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._env = {**os.environ, "HOME": str(folder), "COLUMNS": "100"}
        self.gate: subprocess.Popen[bytes] | None = None

    def types(self, line: str, *, code: int = 0) -> str:
        """Type a command line; return what it prints.

        Raises:
            LostError: it ended with another exit code.
        """
        done = subprocess.run(
            [PROGRAM, *shlex.split(line)],
            cwd=self.folder,
            env=self._env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=120,
            check=False,
        )
        if done.returncode != code:
            raise LostError(f"$ authguard {line}\n{done.stdout}(exit {done.returncode})")
        return done.stdout

    def finds(self, pattern: str, text: str) -> str:
        """Return what a pattern finds in a text: its group, else all of it."""
        found = re.search(pattern, text)
        if found is None:
            raise LostError(f"no `{pattern}` in:\n{text}")
        return found[1] if found.groups() else found[0]

    def looks_up(self, *words: str) -> str:
        """Go down the lists of commands to one; return its help."""
        shown = self.types("")
        for number, word in enumerate(words, 1):
            self.finds(rf"(?m)^  {word} ", shown)
            shown = self.types(f"{' '.join(words[:number])} -h")
        return shown

    def keeps(self, **defaults: str) -> None:
        """Write what the help calls defaults into the environment, as it says."""
        self._env |= {f"AUTHGUARD_{name.upper()}": value for name, value in defaults.items()}

    def plans(self, reply: str) -> list[str]:
        """Let the planner propose a saved reply; return the reasons of its last step."""
        plan = (self.folder / PLANS / reply).read_bytes()
        socket = self.folder / "run" / "gate.sock"
        with GateClient.connect(socket, role=ClientRole.PLANNER) as planner:
            return list(planner.propose(plan)["steps"][-1]["reasons"])


def finds_the_examples(me: Person) -> None:
    """1: get files to begin with."""
    me.finds("--out", me.looks_up("examples"))
    me.types("examples --out ex")


def makes_keys(me: Person) -> None:
    """2: make a set-up to try things out."""
    me.finds("DIR|folder", me.looks_up("keys", "init"))
    me.types("keys init trust --site ex/hospital/site.yaml")


def describes_a_room(me: Person) -> None:
    """3: describe a new room, with a mistake that the program names."""
    text = (me.folder / "ex/hospital/site.yaml").read_text()
    site = me.folder / "site.yaml"
    me.looks_up("site", "check")
    site.write_text(text.replace("regions:\n", "regions:\n" + ROOM % "tag", 1))
    shown = me.types("site check site.yaml", code=4)
    me.finds(r"regions\.store-room: .*`tag`", shown)
    site.write_text(text.replace("regions:\n", "regions:\n" + ROOM % "tags", 1))
    me.finds("sound", me.types("site check site.yaml"))


def drafts_a_mission(me: Person) -> None:
    """4: turn a sentence into a draft; the open questions say what to answer."""
    me.finds("--answer", me.looks_up("mission", "draft"))
    sentence = "mission draft 'Deliver P1 to station 101' --robot courier-1 --site site.yaml"
    shown = me.types(sentence, code=3)
    fields = re.findall(r"\(at (\w+)\)", shown)
    said = {"window": "25 min", "issuer": "operator-1"}
    answers = " ".join(f"--answer {field}='{said[field]}'" for field in fields)
    me.types(f"{sentence} {answers} --out draft.yaml")
    me.types("mission compile draft.yaml --site site.yaml --out drafted.json")


def signs_without_options(me: Person) -> None:
    """5: sign the mission; the help names the variables of the defaults."""
    shown = me.looks_up("mission", "sign")
    for name in ("KEY", "TRUST", "SITE"):
        me.finds(f"AUTHGUARD_{name}", shown)
    key = "trust/keys/operator-1.key.pem"
    me.keeps(key=key, trust="trust", site="ex/hospital/site.yaml")
    me.types("mission compile ex/hospital/mission.yaml --out v1.json")
    me.finds(rf"key: {key} \(from", me.types("mission sign v1.json --out v1.token --yes"))


def starts_a_gate(me: Person) -> None:
    """6: configure and run a gate, with an organization that asks a second person."""
    me.looks_up("risk-policy", "make")
    me.types("risk-policy make --organization hospital --out policy.yaml")
    policy = me.folder / "policy.yaml"
    policy.write_text(policy.read_text().replace("tau_1: 30", "tau_1: 10"))
    officer = "--key trust/keys/safety-officer-1.key.pem"
    me.types(f"risk-policy sign policy.yaml {officer} --yes --out policy.token")
    me.looks_up("gate-config", "make")
    me.types("gate-config make --demo --robot courier-1 --trust trust --out gate.token")
    me.finds("--simulate", me.looks_up("gate"))
    words = (
        "gate --demo --simulate --robot courier-1 --trust trust --site ex/hospital/site.yaml "
        "--binding ex/hospital/binding.yaml --config gate.token --risk-policy policy.token "
        "--store robot.db --gate run"
    )
    log = me.folder / "gate.log"
    with log.open("wb") as out:
        line = [PROGRAM, *words.split()]
        me.gate = subprocess.Popen(line, cwd=me.folder, stdout=out, stderr=subprocess.STDOUT)
    end = time.monotonic() + 60
    while b"serving" not in log.read_bytes():
        if time.monotonic() > end or me.gate.poll() is not None:
            raise LostError(log.read_text())
        time.sleep(0.05)
    me.keeps(gate="run", store="robot.db")
    me.looks_up("mission", "activate")
    me.finds("active", me.types("mission activate v1.token"))


def looks_where_the_robot_is(me: Person) -> None:
    """7: see where the robot is and what it holds."""
    me.looks_up("status")
    me.finds(r"robot: at dock, holds nothing", me.types("status"))


def learns_why_it_refused(me: Person) -> None:
    """8: find out why the gate refused, from the status on."""
    if "OBJECT_OUT_OF_SCOPE" not in (reasons := me.plans("06-wrong-package.json")):
        raise LostError(f"the planner's wrong package: {reasons}")
    command = me.finds(
        r"last refusal, .*\(authguard (explain(?: \d+| --refusal)?)\)", me.types("status")
    )
    shown = me.types(command)
    me.finds("OBJECT_OUT_OF_SCOPE at object", shown)
    me.finds("to do: ", shown)


def answers_a_request(me: Person) -> None:
    """9: answer an open request, as a supervisor."""
    if (reasons := me.plans("01-collect.json")) != ["APPROVAL_REQUIRED"]:
        raise LostError(f"the planner's collection: {reasons}")
    command = me.finds(
        r"REQUEST 1: navigate .* left: authguard (approvals show 1)", me.types("status")
    )
    me.finds("WHAT  navigate", me.types(command))
    command = me.finds(r"to do: authguard (approvals approve 1)", me.types("explain"))
    supervisor = "--key trust/keys/supervisor-1.key.pem"
    me.types(f"{command} {supervisor} --yes")
    me.plans("01-collect.json")  # it moves now, and asks for the next step
    me.finds("robot: at pharmacy", me.types("status"))


def stops_and_resumes(me: Person) -> None:
    """10: stop the robot that has moved, and resume the mission."""
    me.looks_up("stop")
    command = me.finds("until `authguard (resume)`", me.types("stop --reason 'a child'"))
    me.finds("resume.*ends the stop", me.types("status"))
    me.finds("token", me.types(f"{command} -h"))
    me.finds("active", me.types(f"{command} v1.token"))


def revokes_the_mission(me: Person) -> None:
    """11: end the mission."""
    me.looks_up("mission", "revoke")
    me.finds("revoked", me.types("mission revoke v1.token"))
    me.finds("revoked|no active mission", me.types("status"))


def verifies_the_log(me: Person) -> None:
    """12: verify the log, and see what was refused in it."""
    me.looks_up("audit", "verify")
    me.types("audit verify robot.db")
    me.finds("refused", me.looks_up("audit", "show"))
    me.finds("OBJECT_OUT_OF_SCOPE", me.types("audit show robot.db --refused"))


TASKS: tuple[Callable[[Person], None], ...] = (
    finds_the_examples,
    makes_keys,
    describes_a_room,
    drafts_a_mission,
    signs_without_options,
    starts_a_gate,
    looks_where_the_robot_is,
    learns_why_it_refused,
    answers_a_request,
    stops_and_resumes,
    revokes_the_mission,
    verifies_the_log,
)


def main() -> int:
    """Do all tasks in order; return the exit code."""
    me = Person(Path(sys.argv[1]).resolve())
    me.folder.mkdir(parents=True, exist_ok=True)
    try:
        for task in TASKS:
            print(f"{task.__doc__ or task.__name__}".strip(), flush=True)
            task(me)
    except LostError as error:
        print(error)
        return 1
    finally:
        if me.gate is not None:
            me.gate.terminate()
            me.gate.wait(timeout=30)
    print(f"{len(TASKS)} tasks done with the help and messages of the program alone")
    return 0


if __name__ == "__main__":
    sys.exit(main())
