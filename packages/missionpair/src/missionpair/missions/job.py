# SPDX-License-Identifier: Apache-2.0
"""A mission as a person means it: tasks one after the other, and how strictly they are held."""

from __future__ import annotations

from msgspec import Struct


class Task(Struct, frozen=True, kw_only=True):
    """One thing to be done.

    Args:
        kind: `carry` a thing, `look` (record where one stands), `inspect` or `use` a thing where
            it is, `reach` with the arm.
        role: the tool that does it, where the kind leaves a choice (`photo`, `open`).
        place: where it is done, or where the thing is brought.
        thing: what is carried, inspected or used.
        origin: where the thing is; of `carry`.
        via: places beside the usual way that the way to `place` may touch.
        others: what else is signed for `open`: further places, or further things.
        open: `place` or `thing` when the chooser still has to choose; empty when nothing is open.
        chooser: who chooses then.
        at: which of the signed rows is the meant one.
    """

    kind: str
    role: str = ""
    place: str
    thing: str = ""
    origin: str = ""
    via: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    open: str = ""
    chooser: str = "operator"
    at: int = 0

    def rows(self, meant: str) -> tuple[str, ...]:
        """Return everything that is signed for what is open, the meant one at its place."""
        return (*self.others[: self.at], meant, *self.others[self.at :])

    @property
    def places(self) -> tuple[str, ...]:
        """Every signed place."""
        return self.rows(self.place) if self.open == "place" else (self.place,)

    @property
    def things(self) -> tuple[str, ...]:
        """Every signed thing."""
        return self.rows(self.thing) if self.open == "thing" else (self.thing,)


class Style(Struct, frozen=True, kw_only=True):
    """How strictly a mission is held; every field is part of its shape.

    Args:
        order: `after` (each step waits for the one before), `task` (within a task), `guards` (what
            is held decides), `both` (of these), `open` (nothing but places).
        speed: slowest and fastest, mm/s.
        force: weakest and strongest grip, mN.
        record: most seconds of one recording, and most bytes of anything recorded.
        window: how long the mission is valid, with its unit.
        battery: least charge, per mille; 0 without such a condition.
        distance: least distance of people while it drives, mm; 0 without.
        still: things are put down and recorded while the robot stands.
        doors: doors of the place have to be open on the way to it.
        home: `closing` (after completion), `completes` (the way home ends it), `none`.
        watch: how often it may look for obstacles; 0 without such a grant.
        pause: longest wait, ms; 0 without such a grant.
        spare: starts beyond the successes.
        sources: 2 when a way may also begin in the corridor.
        chooser: of grants with one row, where nothing is left to choose.
        until: a way is closed once what it led to is done.
        done_when: an unknown outcome can be settled by what is held.
        irreversible: putting down is never given back.
        max_ms: longest lease of a way.
        rate: releases in ten seconds.
        prompts: times that people may be asked.
        refusal: what a refusal leads to.
    """

    order: str
    speed: tuple[int, int]
    force: tuple[int, int]
    record: tuple[int, int]
    window: str
    battery: int
    distance: int
    still: bool
    doors: bool
    home: str
    watch: int
    pause: int
    spare: int
    sources: int
    chooser: str
    until: bool
    done_when: bool
    irreversible: bool
    max_ms: int
    rate: int
    prompts: int
    refusal: str


class Job(Struct, frozen=True, kw_only=True):
    """A mission as a person means it.

    Args:
        robot: who is sent.
        tasks: in order.
        style: how strictly it is held.
    """

    robot: str
    tasks: tuple[Task, ...]
    style: Style


class JobStep(Struct, frozen=True, kw_only=True):
    """One action as it is meant, in ids and in the site's units.

    Args:
        role: the tool.
        grant: the grant that is meant for it; empty for a step without a grant.
        task: which task it is a part of, from 1; 0 for none.
        object: the thing.
        source: where the robot stands before.
        destination: where it goes, or puts something.
        route: places to pass.
        params: numbers, in the site's unit.
    """

    role: str
    grant: str = ""
    task: int = 0
    object: str = ""
    source: str = ""
    destination: str = ""
    route: tuple[str, ...] = ()
    params: dict[str, int] = {}
