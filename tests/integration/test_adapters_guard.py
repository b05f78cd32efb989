# SPDX-License-Identifier: Apache-2.0
"""Functions of a Python process behind a gate: real processes, real files.

Source: lessons L1, L4, L5, L16; docs/spec/adapters.md
"""

from __future__ import annotations

import asyncio
import inspect
import json
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import GateClient
from authguard_r.core.errors import EnvironmentFault, MalformedError, RefusedError
from authguard_r.integrations.functions import (
    Failed,
    GateGuard,
    NotDone,
    Refused,
    Repeated,
    functions,
)
from authguard_r.site.source import read_text, read_yaml
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, RunningGate, until
from fixtures.guarded_tools import (
    SCOPE,
    SIGN,
    Courier,
    confirm_stop,
    courier,
    often,
    shared_courier,
)
from fixtures.shared_gate import SharedGate


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def robot(shared: SharedGate, tmp_path: Path) -> Iterator[Courier]:
    with shared_courier(shared, tmp_path) as made:
        yield made


def refused(guard: GateGuard, tool: str, **arguments: Any) -> NotDone:
    """Return what the caller is told of a call that brings nothing back."""
    with pytest.raises(NotDone) as told:
        guard.call(tool, arguments)
    return told.value


def test_what_the_mission_grants_is_called_and_a_hijack_never_is(robot: Courier) -> None:
    with robot.guard() as guard:
        assert guard.call("navigate_to", {"destination": "Pharmacy"}) == SIGN
        told = refused(guard, "navigate_to", destination="Isolation Room")
    assert isinstance(told, Refused)
    assert told.reasons[0] == SCOPE
    assert str(told).startswith(f"refused: {SCOPE}")
    assert told.report["execution"] is None
    # what was called was rebuilt from what was authorized: the default speed is in it
    assert robot.calls() == [
        {"tool": "navigate_to", "arguments": {"destination": "Pharmacy", "speed": 0.5}}
    ]


def test_an_argument_that_is_none_is_left_out_and_a_needed_one_is_refused(robot: Courier) -> None:
    with robot.guard() as guard:
        given = {"destination": "Pharmacy", "speed": None, "via": None, "behavior_tree": None}
        assert guard.call("navigate_to", given) == SIGN
        told = refused(guard, "navigate_to", destination=None)
    assert told.reasons == ["VALUE_INVALID"]
    assert "destination: expected the name of a region" in str(told)
    assert "the same call will not pass later" in str(told)
    assert [call["arguments"]["speed"] for call in robot.calls()] == [0.5]


def test_a_decorated_function_keeps_its_face_and_loses_its_body(robot: Courier) -> None:
    """Positions are named, defaults are proposed, and nothing of the function is in reach."""
    with robot.connect() as guard:

        @guard.tool
        def navigate_to(destination: str, /, speed: float = 0.3, via: Any = None) -> str:
            """Go; every place has been approved by an operator."""
            assert via is None
            return robot.made("navigate_to", destination=destination, speed=speed)

        @guard.tool(name="scan")
        async def look() -> str:
            return robot.made("scan")

        assert navigate_to.__name__ == "navigate_to"
        assert navigate_to.__doc__ == "Go; every place has been approved by an operator."
        assert list(inspect.signature(navigate_to).parameters) == ["destination", "speed", "via"]
        assert inspect.iscoroutinefunction(look)
        assert not hasattr(navigate_to, "__wrapped__")
        assert navigate_to("Pharmacy") == SIGN
        assert asyncio.run(look()) == SIGN
        with pytest.raises(Refused):
            navigate_to("Isolation Room")
        for wrong in (
            partial(navigate_to, "Pharmacy", 0.3, None, "more"),
            partial(navigate_to, "Pharmacy", destination="Dock"),
            partial(navigate_to),
            partial(navigate_to, "Pharmacy", approved_by="operator-1"),
        ):
            with pytest.raises(Refused) as told:
                wrong()
            assert told.value.reasons
        assert guard.registered == ("navigate_to", "scan")
        assert "say" in guard.missing
    assert [(call["tool"], call["arguments"].get("speed")) for call in robot.calls()] == [
        ("navigate_to", 0.3),
        ("scan", None),
    ]


def test_what_is_no_json_is_refused_with_its_place(robot: Courier) -> None:
    round_and_round: list[Any] = []
    round_and_round.append(round_and_round)
    with robot.guard() as guard:
        for value, place in (
            (object(), ""),
            (float("nan"), ""),
            ("\ud800", ""),
            ([1, {"x": {1: 2}}], "[1].x"),
            ({"x": {"\ud800": 1}}, ".x"),
            ([b"x"], "[0]"),
            (str, ""),
            (round_and_round, "[0]" * 32),
        ):
            told = refused(guard, "navigate_to", destination=value)
            assert isinstance(told, Refused)
            assert told.reasons == ["MALFORMED"]
            assert f"`arguments.destination{place}`" in str(told)
        told = refused(guard, "navigate_to", destination="x" * 600_000)
        assert told.reasons == ["INPUT_TOO_LARGE"]
        assert guard.call("scan", {}) == SIGN
    assert [call["tool"] for call in robot.calls()] == ["scan"]


def test_l4_labels_state_and_approvals_in_arguments_are_read_by_nobody(robot: Courier) -> None:
    with robot.guard() as guard:
        for forged in (
            {"label": "operator"},
            {"provenance": {"destination": "operator"}},
            {"approved": True},
            {"state": {"region": "isolation"}},
            {"now": 0},
        ):
            for place in ("Isolation Room", "Pharmacy"):
                told = refused(guard, "navigate_to", destination=place, **forged)
                assert isinstance(told, Refused)
    assert robot.calls() == []


def test_what_a_function_returns_is_noted_before_its_caller_has_it(robot: Courier) -> None:
    """The sign names a station: from then on that place is known to have been read somewhere."""
    with robot.guard() as guard:
        guard.call("scan", {})
        refused(guard, "navigate_to", destination="Station 103")
    (record,) = until(lambda: robot.gate.refusals(SCOPE), "the record")
    assert "station-103" in json.dumps(record.sealed["influences"])


def test_the_very_object_comes_back_and_its_words_are_noted(robot: Courier) -> None:
    class Sight:
        def __str__(self) -> str:
            return "Station 102"

    sight = Sight()
    with robot.connect() as guard:
        guard.register("scan", lambda: sight)
        guard.register("navigate_to", robot.navigate_to)
        assert guard.call("scan", {}) is sight
        refused(guard, "navigate_to", destination="Station 102")
    (record,) = until(lambda: robot.gate.refusals(SCOPE), "the record")
    assert "station-102" in json.dumps(record.sealed["influences"])


class UnprintableError(Exception):
    def __str__(self) -> str:
        raise ValueError


class Odd:
    def __init__(self) -> None:
        """Have a signature of no argument."""

    def __str__(self) -> str:
        raise KeyError("x")


def raising(error: BaseException) -> Any:
    """Return a function that raises it."""

    def scan() -> None:
        raise error

    return scan


async def canceled() -> None:
    raise asyncio.CancelledError


def lazy() -> Any:
    async def later() -> None:
        raise AssertionError("it was awaited")

    return later()


def test_a_function_that_fails_has_failed_and_the_next_call_goes_on(robot: Courier) -> None:
    with robot.connect() as guard:
        guard.register("navigate_to", robot.navigate_to)
        for scan, said in (
            (raising(OSError("the lidar \ud800 is dark")), "OSError: the lidar"),
            (raising(UnprintableError()), "UnprintableError"),
            (raising(SystemExit()), "SystemExit"),
            (canceled, "CancelledError"),
            (lazy, "still to be done"),
            (lambda: (number for number in ()), "still to be done"),
            (Odd, "KeyError"),
            (lambda: "x" * 200_000, "withheld"),
        ):
            again(guard, "scan", scan)
            told = refused(guard, "scan")
            assert isinstance(told, Failed)
            assert told.report["execution"] == ("succeeded" if said == "withheld" else "failed")
            assert said in str(told)
        assert guard.call("navigate_to", {"destination": "Pharmacy"}) == SIGN


def again(guard: GateGuard, name: str, function: Any) -> None:
    """Register a function in the place of another, as no program can."""
    guard._functions.tools.pop(name, None)
    guard.register(name, function)


def test_an_exception_is_handed_on_as_the_cause(robot: Courier) -> None:
    error = OSError("dark")
    with robot.connect() as guard:
        guard.register("scan", raising(error))
        assert refused(guard, "scan").__cause__ is error


def test_the_same_key_is_the_same_call_and_its_object_is_not_told_twice(robot: Courier) -> None:
    with robot.guard() as guard:
        assert guard.call("scan", {}, key="scan-1") == SIGN
        with pytest.raises(Repeated) as told:
            guard.call("scan", {}, key="scan-1")
        assert told.value.report["repeated"]
        assert told.value.report["execution"] == "succeeded"
    assert len(robot.calls()) == 1


def test_async_functions_run_in_the_loop_of_whoever_awaits(robot: Courier) -> None:
    loops: list[Any] = []

    async def scan() -> int:
        loops.append(asyncio.get_running_loop())
        return len(loops)

    async def talk(guard: GateGuard) -> None:
        assert await guard.acall("scan", {}) == 1
        assert loops[0] is asyncio.get_running_loop()

    with robot.connect() as guard:
        guard.register("scan", scan)
        asyncio.run(talk(guard))
        assert guard.call("scan", {}) == 2
        assert guard.call("scan", {}) == 3
        assert loops[1] is loops[2] is not loops[0]


def test_who_is_canceled_stops_waiting_and_the_call_goes_on(robot: Courier) -> None:
    async def talk(guard: GateGuard) -> None:
        asked = asyncio.create_task(guard.acall("scan", {}))
        await asyncio.to_thread(until, robot.calls, "the call")
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked
        robot.go.set()
        assert await guard.acall("navigate_to", {"destination": "Pharmacy"}) == SIGN

    def scan() -> None:
        robot.made("scan")
        robot.go.wait()

    with robot.connect() as guard:
        guard.register("scan", scan)
        guard.register("navigate_to", robot.navigate_to)
        asyncio.run(talk(guard))
    assert len(robot.calls()) == 2


def test_what_the_program_gives_beside_is_handed_on_and_nothing_that_is_decided(
    robot: Courier,
) -> None:
    def navigate_to(destination: str, speed: float, who: object = None) -> object:
        return who

    me = object()
    with robot.connect() as guard:
        guard.register("navigate_to", navigate_to)
        assert guard.call("navigate_to", {"destination": "Pharmacy"}, beside={"who": me}) is me
        for name in ("destination", "speed", "behavior_tree"):
            with pytest.raises(TypeError, match="decided by the gate"):
                guard.call("navigate_to", {"destination": "Dock"}, beside={name: "Office 1"})
        assert "destination" in guard.decided("navigate_to")


def test_a_guarded_function_that_calls_another_is_told_and_nothing_waits_for_ever(
    robot: Courier,
) -> None:
    with robot.connect() as guard:
        guard.register("navigate_to", robot.navigate_to)
        guard.register("scan", lambda: guard.call("navigate_to", {"destination": "Pharmacy"}))
        told = refused(guard, "scan")
    assert isinstance(told, Failed)
    assert "its turn never comes" in str(told)
    assert robot.calls() == []


def test_a_stop_is_made_good_by_the_functions_that_stop_the_robot(robot: Courier) -> None:
    told, stood = stopped_in_flight(robot, stops=("halt", ("say", {})))
    assert stood["stopped"]
    assert told.report["execution"] == "aborted"
    assert [call["tool"] for call in robot.calls()] == ["navigate_to", "halt", "say"]


@pytest.mark.parametrize("stops", [(), ("nobody",), (("halt", {"x": 1}),)])
def test_without_such_functions_nobody_says_that_the_robot_stands(
    stops: Any, robot: Courier
) -> None:
    told, stood = stopped_in_flight(robot, stops=stops)
    assert not stood["stopped"]
    assert told.report["execution"] == "unknown"
    assert robot.gate.client(ClientRole.OPERATOR).status()["mission"]["status"] == "suspended"


def stopped_in_flight(robot: Courier, *, stops: Any) -> tuple[Failed, dict[str, Any]]:
    """Return what a caller is told whose function hangs, once an operator has stopped it.

    While it hangs on nothing else begins: it may still move the robot.
    """

    def navigate_to(destination: str, speed: float) -> None:
        robot.made("navigate_to")
        robot.go.wait()

    with robot.connect(stops=stops) as guard, ThreadPoolExecutor(1) as pool:
        guard.register("navigate_to", navigate_to)
        guard.register("scan", robot.scan)
        guard.register("say", lambda: robot.made("say"))
        if "halt" in str(stops):
            guard.register("halt", lambda: robot.made("halt"))
        asked = pool.submit(refused, guard, "navigate_to", destination="Pharmacy")
        until(robot.calls, "the call")
        with GateClient.connect(
            robot.gate.stop_socket, role=ClientRole.OPERATOR, allow_shadow=True
        ) as lane:
            stood = lane.stop("someone is in the way")
        told = asked.result()
        assert isinstance(told, Failed)
        before = len(robot.calls())
        assert isinstance(refused(guard, "scan"), NotDone)
        assert len(robot.calls()) == before
        robot.go.set()
    if not stood["stopped"]:
        confirm_stop(robot.gate)  # another test would find the stop that nobody confirmed
    return told, stood


def test_an_async_function_that_is_stopped_is_canceled(robot: Courier) -> None:
    ends: list[str] = []

    async def navigate_to(destination: str, speed: float) -> None:
        robot.made("navigate_to")
        try:
            await asyncio.sleep(3_600)
        finally:
            ends.append("ended")

    async def talk(guard: GateGuard) -> None:
        asked = asyncio.create_task(guard.acall("navigate_to", {"destination": "Pharmacy"}))
        await asyncio.to_thread(until, robot.calls, "the call")
        connect = partial(GateClient.connect, robot.gate.stop_socket, role=ClientRole.OPERATOR)
        with await asyncio.to_thread(connect, allow_shadow=True) as lane:
            await asyncio.to_thread(lane.stop, "someone is in the way")
        with pytest.raises(Failed, match="aborted"):
            await asked
        await asyncio.to_thread(until, lambda: ends, "the function's end")

    with robot.connect(stops=("halt",)) as guard:
        guard.register("navigate_to", navigate_to)
        guard.register("halt", lambda: None)
        asyncio.run(talk(guard))


def test_eight_threads_with_a_thousand_calls_lose_and_reorder_nothing(
    shared: SharedGate, tmp_path: Path
) -> None:
    count, threads = 1_000, 8
    with (
        shared_courier(shared, tmp_path, activate=False) as robot,
        robot.connect() as guard,
    ):
        robot.gate.activate(often(robot.gate, count=count))
        done: list[tuple[int, int]] = []

        def scan(mine: tuple[int, int] | None = None) -> tuple[int, int]:
            assert mine is not None
            done.append(mine)
            return mine

        def work(thread: int) -> list[Any]:
            return [
                guard.call("scan", {}, beside={"mine": (thread, number)})
                for number in range(count // threads)
            ]

        guard.register("scan", scan)
        with ThreadPoolExecutor(threads) as pool:
            answers = list(pool.map(work, range(threads)))
    each = range(count // threads)
    assert answers == [[(thread, number) for number in each] for thread in range(threads)]
    assert len(done) == len(set(done)) == count
    for thread in range(threads):
        assert [number for who, number in done if who == thread] == list(each)


def test_a_gate_that_is_killed_in_mid_call_is_told_and_found_again(tmp_path: Path) -> None:
    def scan() -> str:
        robot.made("scan")
        robot.go.wait()
        return "x"

    with (
        courier(tmp_path) as robot,
        robot.connect() as guard,
        ThreadPoolExecutor(1) as pool,
    ):
        guard.register("scan", scan)
        guard.register("navigate_to", robot.navigate_to)
        asked = pool.submit(refused, guard, "scan")
        until(robot.calls, "the call")
        robot.gate.kill9()
        told = asked.result()
        assert isinstance(told, Failed)
        assert told.report["execution"] == "unknown"
        away = refused(guard, "navigate_to", destination="Pharmacy")
        assert isinstance(away, Refused)
        assert away.reasons == ["SERVICE_UNAVAILABLE"]
        robot.go.set()
        robot.gate.start_gate()
        operator = robot.gate.client(ClientRole.OPERATOR)
        until(lambda: operator.status()["heard"]["controller_ms"] is not None, "the controller")
        back = refused(guard, "navigate_to", destination="Isolation Room")
        assert isinstance(back, Refused)
        assert back.reasons != ["SERVICE_UNAVAILABLE"]
    assert len(robot.calls()) == 1


def generates() -> Iterator[int]:
    yield 1


def test_what_cannot_be_a_tool_is_said_when_it_is_registered(robot: Courier) -> None:
    with robot.connect() as guard:
        for name, function, said in (
            ("open_every_door", lambda: None, "expected a tool of the binding"),
            ("scan", None, "expected a function"),
            ("scan", 5, "expected a function"),
            ("scan", generates, "a generator"),
            ("scan", lambda *places: None, "with names"),
            ("scan", dict, "signature"),
            ("navigate_to", lambda destination: None, "takes `speed`"),
            ("say", lambda text: None, "does not forward"),
        ):
            with pytest.raises(MalformedError, match=said):
                guard.register(name, function)
        assert guard.registered == ()


def test_a_tool_has_one_function_and_one_without_is_not_asked_for(robot: Courier) -> None:
    with robot.guard(stops=("halt",)) as guard:
        with pytest.raises(MalformedError, match="expected one function"):
            guard.register("scan", robot.scan)
        guard.register("halt", lambda: None)
        for name in ("take_photo", "open_every_door", "halt"):
            with pytest.raises(MalformedError, match="expected a registered function"):
                guard.call(name, {})
        assert guard.call("scan", {}) == SIGN


def test_another_planners_released_action_is_called_without_anybodys_beside(
    robot: Courier,
) -> None:
    with robot.connect() as guard:
        guard.register("scan", lambda mine=None: robot.made("scan", mine=mine))
        other = robot.gate.client(ClientRole.PLANNER, "other")
        told = other.propose(b"scan()")
        assert told["steps"][0]["execution"]["outcome"] == "succeeded"
        bound = other.propose(b'navigate_to(destination="Pharmacy")')
        assert bound["steps"][0]["execution"]["outcome"] == "not_started"
    assert robot.calls() == [{"tool": "scan", "arguments": {"mine": None}}]


def test_two_planners_of_one_tool_at_once_never_have_each_others_beside(robot: Courier) -> None:
    """Whose release it is, its ticket says: not the tool's name, and not the time."""
    rounds, over = 150, threading.Event()
    with robot.connect() as guard:
        guard.register("scan", lambda mine=None: mine)
        other = robot.gate.client(ClientRole.PLANNER, "other")

        def meanwhile() -> int:
            done = 0
            while not over.is_set():
                told = other.propose(b"scan()")["steps"][0]["execution"]
                done += told["outcome"] == "succeeded"
            return done

        mine, number, end = 0, 0, time.monotonic() + PATIENCE_S
        with ThreadPoolExecutor(1) as pool:
            theirs = pool.submit(meanwhile)
            try:  # on a busy machine all of these rounds may find the robot at the other's
                while number < rounds or (not mine and time.monotonic() < end):
                    number += 1
                    with suppress(NotDone):
                        assert guard.call("scan", {}, beside={"mine": number}) == number
                        mine += 1
            finally:
                over.set()
            assert theirs.result() > 0
        assert mine > 0


def test_in_shadow_mode_calls_go_as_they_went_and_the_gate_says_what_it_would_do(
    tmp_path: Path,
) -> None:
    with courier(tmp_path, mode=Mode.SHADOW) as robot:
        with robot.connect(shadow=True) as guard:
            guard.register("navigate_to", robot.navigate_to)
            guard.register("open_every_door", partial(robot.made, "open_every_door"))
            guard.register("scan", raising(OSError("dark")))
            for place in ("Isolation Room", "Pharmacy"):
                assert guard.call("navigate_to", {"destination": place}) == SIGN
            assert guard.call("open_every_door", {}) == SIGN
            with pytest.raises(Failed, match="dark"):
                guard.call("scan", {})
            with pytest.raises(Failed, match="not_started"):
                guard.call("navigate_to", {"to": "Pharmacy"})
        gate = robot.gate
        gate.stop_process("gate")
        words = ("audit", "show", gate.store, "--would-refuse", "--json")
        done = subprocess.run([AUTHGUARD, *words], capture_output=True, text=True, check=True)
        would = [record["open"]["reasons"][0] for record in json.loads(done.stdout)["records"]]
        assert would[:2] == [SCOPE, "TOOL_UNKNOWN"]
        # as the planner wrote them: nothing is rebuilt, nothing is kept back
        assert [call["arguments"] for call in robot.calls()] == [
            {"destination": "Isolation Room", "speed": None},
            {"destination": "Pharmacy", "speed": None},
            {},
        ]


def test_in_shadow_mode_what_cannot_be_noted_is_not_handed_out(tmp_path: Path) -> None:
    with courier(tmp_path, mode=Mode.SHADOW) as robot, robot.connect(shadow=True) as guard:
        guard.register("scan", robot.gate.kill9)
        with pytest.raises(Failed, match="could not be recorded"):
            guard.call("scan", {})


def test_a_guard_in_shadow_mode_does_not_go_past_a_gate_that_enforces(robot: Courier) -> None:
    with pytest.raises(RefusedError, match="the gate enforces"):
        robot.connect(shadow=True)


def test_a_gate_that_does_not_come_is_said(tmp_path: Path) -> None:
    gate = RunningGate()  # it is never started
    robot = Courier(gate, tmp_path)
    try:
        with pytest.raises(EnvironmentFault, match="the gate did not come in time"):
            robot.connect(within_s=0.5)
        with pytest.raises(EnvironmentFault, match="expected a folder"):
            robot.connect(run=tmp_path / "nowhere")
    finally:
        gate.end()


def test_a_guard_that_is_closed_says_so(robot: Courier) -> None:
    """Of a call that runs nobody knows what becomes; one that waits for its turn is none."""

    def scan() -> None:
        robot.made("scan")
        robot.go.wait()

    async def talk() -> None:
        first, *others = (asyncio.create_task(guard.acall("scan", {})) for _ in range(3))
        await asyncio.to_thread(until, robot.calls, "the call")
        waits = pool.submit(guard.call, "scan", {})
        await asyncio.to_thread(guard.close)
        with pytest.raises(Failed, match="unknown"):
            await first
        for other in (*others, asyncio.wrap_future(waits)):
            with pytest.raises((EnvironmentFault, NotDone)):
                await other

    guard = robot.connect()
    guard.register("scan", scan)
    with ThreadPoolExecutor(1) as pool:
        asyncio.run(talk())
    guard.close()
    robot.go.set()
    with pytest.raises(EnvironmentFault, match="is closed"):
        guard.call("scan", {})
    assert len(robot.calls()) == 1


def test_a_call_that_came_too_late_is_told(robot: Courier, monkeypatch: pytest.MonkeyPatch) -> None:
    gone: Future[Any] = Future()
    gone.cancel()
    with robot.guard() as guard:
        monkeypatch.setattr(guard, "_ask", lambda *_, **__: gone)
        with pytest.raises(EnvironmentFault, match="closed"):
            guard.call("scan", {})
        with pytest.raises(EnvironmentFault, match="closed"):
            asyncio.run(guard.acall("scan", {}))


def test_a_guard_that_is_closed_at_once_ends(robot: Courier) -> None:
    for _ in range(20):
        robot.connect().close()


def test_a_caller_whose_loop_has_ended_leaves_nothing_begun(robot: Courier) -> None:
    """The turn comes after the caller has gone: a coroutine function begins nowhere."""
    began = threading.Event()

    async def navigate_to(destination: str, speed: float) -> None:
        robot.made("navigate_to")

    def scan() -> None:
        began.set()
        robot.go.wait()

    async def leave(guard: GateGuard) -> None:
        waiting = asyncio.create_task(guard.acall("navigate_to", {"destination": "Pharmacy"}))
        await asyncio.sleep(0)
        waiting.cancel()

    with robot.connect() as guard, ThreadPoolExecutor(1) as pool:
        guard.register("navigate_to", navigate_to)
        guard.register("scan", scan)
        first = pool.submit(guard.call, "scan", {})
        until(began.is_set, "the first call")
        asyncio.run(leave(guard))
        robot.go.set()
        first.result()
        until(lambda: any(r.kind == "outcome" for r in robot.gate.news()[-1:]), "the outcome")
    assert robot.calls() == []


def test_a_function_has_to_return_what_the_binding_demands(tmp_path: Path) -> None:
    plain = read_yaml(read_text(scenarios.HOSPITAL / "binding.yaml"), where="binding")
    assert isinstance(plain, dict)
    plain["tools"]["scan"]["succeeds"] = {"success": True}
    binding = tmp_path / "binding.json"
    binding.write_text(json.dumps(plain))
    found = [{"success": False}, "success", {"success": True}]
    with courier(tmp_path, binding=binding) as robot, robot.connect() as guard:
        guard.register("scan", lambda: found[0])
        for _ in range(2):
            assert refused(guard, "scan").report["execution"] == "failed"
            found.pop(0)
        assert guard.call("scan", {}) == {"success": True}


def test_an_answer_that_is_not_kept_here_is_told_as_none(
    robot: Courier, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(functions, "MAX_KEPT", 0)
    with robot.guard() as guard:
        told = refused(guard, "scan")
    assert isinstance(told, Failed)
    assert "not of this process" in str(told)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_guard_that_breaks_down_lets_nobody_wait_for_ever(
    robot: Courier, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(now_ms: int) -> Any:
        monkeypatch.undo()
        raise ValueError("a fault of its own")

    with robot.connect() as guard, ThreadPoolExecutor(1) as pool:
        guard.register("scan", lambda: (robot.made("scan"), robot.go.wait()))
        asked = pool.submit(guard.call, "scan", {})
        until(robot.calls, "the call")
        monkeypatch.setattr(guard._ends._driver.session, "tick", broken)
        with pytest.raises((EnvironmentFault, Failed)):
            asked.result()
        until(lambda: not guard._background._thread.is_alive(), "the thread's end")
        with pytest.raises(EnvironmentFault, match="is closed"):
            guard.call("scan", {})
