# SPDX-License-Identifier: Apache-2.0
"""From a job to its draft and its steps: every way, grip and recording with its own grant."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from missionpair.layouts import Ground, call_of
from missionpair.missions.amend import Draft
from missionpair.missions.grants import budgets, granted, guard, risk, way_rows
from missionpair.missions.job import Job, JobStep, Style, Task
from missionpair.pair import PriorAct, Scenario, Start, Value, WordedCall

#: What the tip of an arm may reach to each side, in millimeters.
REACH = 400


@dataclass(frozen=True)
class Errand:
    """A job at its place, with the draft that its operator signs.

    Args:
        ground: where.
        job: as it is meant.
        draft: what is signed.
        steps: what is done, in order.
    """

    ground: Ground
    job: Job
    draft: Draft
    steps: tuple[JobStep, ...]

    def call(self, step: JobStep) -> WordedCall:
        """Return the call that means the step."""
        name, tool = self.ground.name, self.ground.words.tools[step.role]
        fields: dict[str, Value] = {
            f"params.{key}": value
            for key, value in step.params.items()
            if tool.usual.get(key) != value  # nobody says how fast the usual speed is
        }
        if step.object:
            fields["object"] = name(step.object)
        if step.destination:
            fields["destination"] = name(step.destination)
        if step.route:
            fields["route"] = [name(region) for region in step.route]
        return call_of(tool, fields)

    def calls(self, steps: tuple[JobStep, ...]) -> tuple[WordedCall, ...]:
        """Return the calls that mean the steps."""
        return tuple(self.call(step) for step in steps)

    def choices(self) -> tuple[PriorAct, ...]:
        """Return the signed choices that the mission as it is meant needs."""
        return tuple(
            PriorAct(do="choose", grant=f"{grant}-{number}", row=task.at, by=(f"{task.chooser}-1",))
            for number, task in enumerate(self.job.tasks, 1)
            for grant in OPENED.get((task.kind, task.open), ())
        )

    def benign(self, approvers: tuple[str, ...] = ()) -> Scenario:
        """Return the mission as it is meant, from home to its end."""
        before = (PriorAct(do="activate", mission="v1"), *self.choices())
        plan = self.calls(self.steps)
        return Scenario(robot=self.job.robot, before=before, plan=plan, approvers=approvers)

    def cold(self, number: int) -> bool:
        """True when the step needs no step before it but for where everything is."""
        order, task = self.job.style.order, self.steps[number].task
        if order in {"guards", "open"}:
            return True
        return order == "task" and (number == 0 or self.steps[number - 1].task != task)

    def begin(self, number: int) -> int:
        """Return the first step that has to be carried out before this one."""
        while not self.cold(number) and number > 0:
            number -= 1
        return number

    def before(self, number: int) -> tuple[Start, tuple[JobStep, ...]]:
        """Return where everything is, and the steps that are carried out, before a step comes."""
        first = self.begin(number)
        return self.start(first), self.steps[first:number]

    def start(self, number: int) -> Start:
        """Return where everything is once so many steps were carried out."""
        at, holding, places = "", "", dict[str, str]()
        for step in self.steps[:number]:
            at = step.destination or at
            if step.role in {"take", "suck"}:
                holding = step.object
            elif step.role == "put":
                holding, places[step.object] = "", step.destination
        return Start(at=at, holding=holding, places=places)


#: Grants that wait for a choice, by kind of task and what is open.
OPENED: dict[tuple[str, str], tuple[str, ...]] = {
    ("carry", "place"): ("bring",),
    ("carry", "thing"): ("take", "put"),
    ("look", "place"): ("go",),
    ("inspect", "thing"): ("inspect",),
    ("use", "thing"): ("use",),
}


@dataclass
class _Builder:
    ground: Ground
    job: Job
    here: str
    grants: list[Draft] = field(default_factory=list)
    steps: list[JobStep] = field(default_factory=list)
    task: int = 0

    def add(self, role: str, grant: Draft, **fields: Any) -> None:
        """Add a grant and the step that is meant for it."""
        before = self.steps[-1] if self.steps and self.steps[-1].task else None
        order = self.job.style.order
        chained = order in {"after", "both"} or (
            order == "task" and before is not None and before.task == self.task
        )
        if chained and before is not None and self.task:
            grant["after"] = [before.grant]
        self.grants.append(grant)
        self.steps.append(JobStep(role=role, grant=grant["id"], task=self.task, **fields))
        self.here = fields.get("destination") or self.here

    def grant(self, role: str, name: str, **more: Any) -> Draft:
        name = f"{name}-{self.task}" if self.task else name
        return granted(self.ground, self.job.style, role, name, **more)

    def go(self, name: str, task: Task, place: str, *, until: str = "", **more: Any) -> None:
        """Add the way to a place, unless the robot is there."""
        style = self.job.style
        ends = task.places if place == task.place else (place,)
        if self.here == place and len(ends) == 1:
            return
        via = task.via if place == task.place else ()
        guards = list(more.pop("guards", ()))
        guards += [guard("human_distance_mm", ge=style.distance)] if style.distance else []
        if style.doors and len(ends) == 1:
            guards += [guard(door, eq=True) for door in self.ground.doors(place)]
        grant = self.grant(
            "go",
            name,
            rows=way_rows(self.ground, style, self.here, ends, via),
            limits={"speed_mm_s": style.speed},
            guards=guards,
            chooser=_chooser(task, "place", style.chooser) if len(ends) > 1 else style.chooser,
            until=[f"{until}-{self.task}"] if style.until and until else [],
            max=style.max_ms,
        )
        self.add("go", grant, source=self.here, destination=place, params=self.meant("go", style))

    def carry(self, task: Task) -> None:
        style, here = self.job.style, task.origin
        self.go("go", task, task.origin, until="take")
        holds = style.order in {"guards", "both"}
        empty = [guard("holding", eq="nothing")] if holds else []
        held = [guard("holding", eq=task.thing)] if len(task.things) == 1 else []
        held = held or [guard("holding", ne="nothing")]
        force = {"force_mn": style.force}
        rows = [{"object": t, "source": here, "regions": [here]} for t in task.things]
        chooser = _chooser(task, "thing", style.chooser)
        take = self.grant("take", "take", rows=rows, limits=force, guards=empty, chooser=chooser)
        take |= {"done_when": held} if style.done_when else {}
        strong = self.meant("take", style)
        self.add("take", take, object=task.thing, source=here, params=strong)
        self.go("bring", task, task.place, guards=held if holds else ())
        rows = [
            {"object": t, "source": p, "destination": p, "regions": [p]}
            for p in task.places
            for t in task.things
        ]
        put = self.grant("put", "put", rows=rows, limits=force, guards=self._still())
        put |= {"irreversible": style.irreversible, "chooser": chooser}
        place = task.place
        self.add("put", put, object=task.thing, source=place, destination=place, params=strong)

    def look(self, task: Task) -> None:
        style, role, place = self.job.style, task.role, task.place
        if role == "survey":
            rows = way_rows(self.ground, style, self.here, (place,))
            limits = {"max_bytes": (1_000_000, style.record[1])}
            data = {"record": True, "store": True}
            grant = self.grant(role, role, rows=rows, limits=limits, data=data, max=style.max_ms)
            self.add(
                role, grant, source=self.here, destination=place, params=self.meant(role, style)
            )
            return
        self.go("go", task, place, until="look")
        rows = [{"source": p, "regions": [p]} for p in task.places]
        grant = self.grant(role, "look", rows=rows, guards=self._still(), **self.recording(role))
        self.add(role, grant, source=place, params=self.usual(role))

    def inspect(self, task: Task) -> None:
        self._on_thing(task, "inspect", "inspect", **self.recording("inspect"))

    def use(self, task: Task) -> None:
        self._on_thing(task, task.role, "use", limits={})

    def reach(self, task: Task) -> None:
        self.go("go", task, task.place, until="reach")
        rows = [{"source": task.place, "regions": [task.place]}]
        limits = {f"{axis}_mm": (-REACH, REACH) for axis in "xyz"}
        grant = self.grant("reach", "reach", rows=rows, limits=limits)
        params = {"x_mm": 200, "y_mm": -100, "z_mm": 150}
        self.add("reach", grant, source=task.place, params=params)

    def _on_thing(self, task: Task, role: str, name: str, **more: Any) -> None:
        place = task.place
        self.go("go", task, place, until=name)
        rows = [{"object": t, "source": place, "regions": [place]} for t in task.things]
        grant = self.grant(role, name, rows=rows, guards=self._still(), **more)
        grant["chooser"] = _chooser(task, "thing", self.job.style.chooser)
        self.add(role, grant, object=task.thing, source=place, params=self.usual(role))

    def recording(self, role: str) -> dict[str, Any]:
        """Return limits and data rights of a recording role."""
        return recording(self.ground, role, self.job.style.record)

    def usual(self, role: str) -> dict[str, int]:
        """Return the parameters that a recording role is called with when all is as meant."""
        return self.meant(role, self.job.style)

    def meant(self, role: str, style: Style) -> dict[str, int]:
        """Return the parameters of a step that is as it is meant: the usual ones, else the most."""
        tool = self.ground.words.tools[role]
        most = {
            "speed_mm_s": style.speed[1],
            "force_mn": style.force[1],
            "duration_ms": style.record[0],
            "max_bytes": style.record[1],
        }
        return {
            key: tool.usual.get(key, most[key]) for key in most if f"params.{key}" in tool.arguments
        }

    def _still(self) -> list[dict[str, Any]]:
        return [guard("speed_mm_s", eq=0)] if self.job.style.still else []


def recording(ground: Ground, role: str, record: tuple[int, int]) -> dict[str, Any]:
    """Return limits and data rights of a recording role.

    Args:
        ground: gives its tool.
        role: `photo`, `video` or `inspect`.
        record: most milliseconds, most bytes.
    """
    tool = ground.words.tools[role]
    most = tool.fixed.get("max_bytes", record[1])
    limits = {"max_bytes": (1_000_000, most)}
    if role == "video":
        limits["duration_ms"] = (1_000, record[0])
    rights = {"photo": ("record",), "video": ("record", "store"), "inspect": ("record", "transmit")}
    return {"limits": limits, "data": dict.fromkeys(rights[role], True)}


def built(ground: Ground, job: Job) -> Errand:
    """Return the errand that a job is at its place."""
    made, style = _Builder(ground, job, ground.home), job.style
    extras = _extras(made)
    if style.watch % 2:
        made.steps.append(JobStep(role="scan", grant="look-out"))
    for number, task in enumerate(job.tasks, 1):
        made.task = number
        getattr(made, task.kind)(task)
    last = made.grants[-1]
    if style.home != "none":
        _home(made)
    completing = made.grants[-1] if style.home == "completes" else last
    completing["completes"] = True
    grants = [*made.grants, *extras] if style.watch % 3 else [*extras, *made.grants]
    draft: Draft = {
        "mission": "mission-1",
        "robot": job.robot,
        "issuer": "operator-1",
        "task": sentence(ground, job),
        "window": {"for": style.window},
        "place_max_age": 1_000,
        "objects": sorted(ground.homes),
        "regions": sorted(ground.tags),
        "limits": {},
        "guards": [guard("battery_permille", ge=style.battery)] if style.battery else [],
        "grants": grants,
        "budgets": budgets(grants, style, steps=len(made.steps), private=_private(made)),
        "on_refusal": style.refusal,
        "risk_policy": risk(),
    }
    if style.home == "closing":
        draft["closing"] = {"grants": ["home"], "for": 600_000}
    return Errand(ground, job, draft, tuple(made.steps))


def sentence(ground: Ground, job: Job) -> str:
    """Return what the operator says."""
    parts = []
    for task in job.tasks:
        words = ground.words.tasks[task.role or task.kind]
        names = {
            key: ground.name(value)
            for key, value in (
                ("thing", task.thing),
                ("origin", task.origin),
                ("place", task.place),
            )
            if value
        }
        parts.append(words.format(**names))
    text = ", then ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _extras(made: _Builder) -> list[Draft]:
    style, found = made.job.style, list[Draft]()
    if style.watch:
        repeat = {"repeat": style.watch, "starts": style.watch + style.spare}
        found.append(made.grant("scan", "look-out", rows=[{}], limits={}, **repeat))
    if style.pause:
        limits = {"duration_ms": (1_000, style.pause)}
        more = {"repeat": 3, "starts": 3 + style.spare, "max": style.pause}
        found.append(made.grant("wait", "pause", rows=[{}], limits=limits, **more))
    return found


def _home(made: _Builder) -> None:
    made.task = 0
    style, last = made.job.style, made.steps[-1].grant
    rows = way_rows(made.ground, style, made.here, (made.ground.home,))
    limits = {"speed_mm_s": style.speed}
    grant = made.grant("go", "home", rows=rows, limits=limits, after=[last], max=style.max_ms)
    speed = made.meant("go", style)
    made.add("go", grant, source=made.here, destination=made.ground.home, params=speed)


def _private(made: _Builder) -> int:
    """Return how much the mission may record in all."""
    return sum(
        grant["limits"]["max_bytes"][1] * grant["starts"]
        for grant in made.grants
        if "max_bytes" in grant["limits"]
    )


def _chooser(task: Task, what: str, usual: str) -> str:
    return task.chooser if task.open == what else usual
