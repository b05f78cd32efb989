# SPDX-License-Identifier: Apache-2.0
"""The bounds of the gate's process: what it waits for, keeps and takes in, and how much of it.

Each bound is a number of this program; bounds of a signed file or a format stand beside its type.
Source: ADR 0039.
"""

from __future__ import annotations

from msgspec import Struct


class GateLimits(Struct, frozen=True, kw_only=True):
    """The bounds of the gate's process: what it waits for, keeps and takes in, and how much of it.

    Args:
        hello_s: a connection must send its hello within this, seconds.
        frame_s: a frame must be whole this long after its first byte, seconds.
        read_s: a client that reads nothing for this long is dropped, seconds.
        unread_bytes: answers that may wait for one client, bytes.
        chunk_bytes: bytes read from a client at a time.
        kept_files: open files that connections leave to the rest of the process.
        backlog: connections that the kernel keeps until the gate accepts them.
        accepted_at_once: connections accepted in one turn.
        waiting_requests: requests of one client that wait; the gate reads no more of it then.
        shed_proposals: proposals shed in a row; the gate reads no more of the client then.
        page_bytes: longest page of the log, bytes of records.
        searched_records: records searched for the last refusal.
        lock_answer_s: a gate answers other gates of its robot this often, seconds.
        lock_queue: gates that may ask between two answers.
        lock_pause_s: pause between two questions to another gate, seconds.
        look_s: open leases are checked this often, seconds; at most 0.1.
        flush_s: waiting records are written this often, seconds.
        listen_s: silence of clients is checked this often, seconds.
        maintenance_s: checkpoints and witnesses are checked this often, seconds.
        shred_s: envelopes whose keys are destroyed are removed this often, seconds.
        retention_ms: retention is checked this often, milliseconds.
        counts_ms: changed counts are logged this often, milliseconds.
        recovery_ms: recovery goes on without attested state after this, milliseconds.
        priority: added to the niceness of the process, where the system allows it.
        catch_up_ms: most time that one look adds to a simulation, milliseconds.
        short_plan_bytes: longest plan that is parsed in the gate's own turn, bytes.
        parse_s: longest time to parse one plan, seconds; the parser is ended then.
        long_plans_of_user: long plans of one user that wait.
        long_plans: long plans that wait.
        parser_bytes: most memory of the parser, bytes.
        parser_nice: added to the parser's niceness.
        part_characters: characters of an observed text that are searched in one turn.
        contexts: planners whose inputs are kept.
        contexts_of_user: planners of one user whose inputs are kept.
        remembered_answers: answers kept in memory beside the store.
        watch_ms: a lease is checked at least this often, milliseconds.
        stand_within_ms: a stopped robot stands within this, milliseconds; the default.
        safety_ms: longest answer time of an external safety checker, milliseconds.
        begin_within_ms: a controller confirms that it began within this, milliseconds.
        explain_within_ms: without a stop process a stop counts as known after this, ms.
        stream_slack_ms: a controller ends a stream this much after its duration, milliseconds.
        sample_gap_ms: samples closer together than this are shed, milliseconds.
        stream_record_ms: a stream has at most one record in this time, milliseconds.
        stop_answer_ms: a stop is answered within this, confirmed or not, milliseconds.
        stop_fold_ms: stops of one user and role within this share a record, milliseconds.
        joined_stops: stops that join one that is under way and have an answer.
        known_stops: stops that are recognized when they come again.
        same_stop_ms: reports of one stop come within this, milliseconds.
        stop_start_s: a stop process that is started serves within this, seconds.
        stop_connect_s: a stop process accepts the gate within this, seconds.
        stop_retry_s: a stop process that is gone is searched for this often, seconds.
        stop_end_s: a stop process ends within this, seconds; then it is killed.
        stop_heard_s: the stop process hears what is recorded this often, seconds.
        stop_ask_s: the stop process is asked this often whether it works, seconds.
        stop_within_s: without an answer of the stop process in this time nothing moves, seconds.
        stop_silent_looks: questions without an answer until the stop process counts as silent.
        stop_replaced_looks: questions without an answer until the stop process is replaced.
        emergency_answers: answers kept of each user in each role.
        emergency_users: users whose false calls are counted.
        emergency_flush_ms: waiting entries of the emergency journal are retried this often, ms.
        emergency_again_ms: the gate repeats a call of its own that failed after this, milliseconds.
        emergency_again_at_last_ms: longest time between two such calls, milliseconds.
        shown_emergencies: emergencies of unknown outcome that `status` shows.
        shown_alerts: alerts that `status` shows.
        counted_users: users whose refusals in a row are counted.
        kept_missions: verified missions kept in memory.
        kept_answers: answers of one person with one verdict kept of a request.
        order_valid_ms: longest validity of a signed order, milliseconds.
        shredded_keys: keys that one shredding order reaches.
        issued_missions: mission versions that are issued at one time.
        covers: missions whose sealing keys are in memory.
        skew_ms: most that the wall clock may be behind the last committed time, milliseconds.
        batch: transactions that share one write to disk.
        strange_rows: rows held at a time of a file that anyone may have written.
        known_values: values of the store kept in memory.
        open_segments: segments kept open for reading.
        waiting_refusals: refusals that wait for a commit; further ones are counted.
        windows: deduplication windows at one time.
        windows_of_client: deduplication windows of one client.
        ended_windows: deduplication windows that end in one flush.
        place_characters: characters of a place that distinguish two windows.
        room_ms: free space on the disk is checked this often, milliseconds.
        refusal_delay_ms: refusals wait this long for another commit, milliseconds.
        tree_page: records that one turn adds to the log's tree.
        growth_page: records that one turn counts.
        rotation_block: records that one turn moves into a segment: a complete subtree.
        rotation_kept: newest records that stay in the store; at most a quarter of a segment.
        rotation_again_ms: a failed rotation is tried again after this, milliseconds.
        witness_answer_bytes: longest answer of a witness, bytes.
        witness_s: longest exchange with a witness, seconds.
        witness_exchanges: exchanges with one witness that have not ended.
        witness_retry_ms: a witness that failed is asked again after this, milliseconds.
        witness_most_retry_ms: longest time between two questions to a witness, milliseconds.
        witness_sizes: sizes in a row that a witness may tell before it counts as silent.
        witness_look_s: pause between two looks at a witness's answer, seconds.
    """

    # connections
    hello_s: float = 2.0
    frame_s: float = 10.0
    read_s: float = 2.0
    unread_bytes: int = 1 << 20
    chunk_bytes: int = 1 << 12
    kept_files: int = 80
    backlog: int = 1_024
    accepted_at_once: int = 16
    waiting_requests: int = 8
    shed_proposals: int = 4
    page_bytes: int = 1 << 21
    searched_records: int = 1_000
    lock_answer_s: float = 1.0
    lock_queue: int = 128
    lock_pause_s: float = 0.02
    # clocks of the loop
    look_s: float = 0.05
    flush_s: float = 0.1
    listen_s: float = 1.0
    maintenance_s: float = 0.1
    shred_s: float = 0.05
    retention_ms: int = 60_000
    counts_ms: int = 10_000
    recovery_ms: int = 2_000
    priority: int = -5
    catch_up_ms: int = 10_000
    # plans
    short_plan_bytes: int = 1 << 12
    parse_s: float = 5.0
    long_plans_of_user: int = 2
    long_plans: int = 16
    parser_bytes: int = 1 << 30
    parser_nice: int = 10
    part_characters: int = 1_024
    contexts: int = 256
    contexts_of_user: int = 32
    remembered_answers: int = 1_024
    # robot and stops
    watch_ms: int = 100
    stand_within_ms: int = 2_000
    safety_ms: int = 50
    begin_within_ms: int = 1_000
    explain_within_ms: int = 500
    stream_slack_ms: int = 500
    sample_gap_ms: int = 10
    stream_record_ms: int = 1_000
    stop_answer_ms: int = 1_000
    stop_fold_ms: int = 100
    joined_stops: int = 64
    known_stops: int = 4_096
    same_stop_ms: int = 10_000
    stop_start_s: float = 60
    stop_connect_s: float = 5
    stop_retry_s: float = 1.0
    stop_end_s: float = 5.0
    stop_heard_s: float = 0.1
    stop_ask_s: float = 0.05
    stop_within_s: float = 0.3
    stop_silent_looks: int = 24
    stop_replaced_looks: int = 40
    # emergencies and alerts
    emergency_answers: int = 256
    emergency_users: int = 1_024
    emergency_flush_ms: int = 100
    emergency_again_ms: int = 1_000
    emergency_again_at_last_ms: int = 64_000
    shown_emergencies: int = 16
    shown_alerts: int = 20
    counted_users: int = 1_024
    # missions, approvals and keys
    kept_missions: int = 16
    kept_answers: int = 16
    order_valid_ms: int = 86_400_000
    shredded_keys: int = 4_096
    issued_missions: int = 64
    covers: int = 64
    # store and log
    skew_ms: int = 2_000
    batch: int = 64
    strange_rows: int = 16
    known_values: int = 64
    open_segments: int = 4
    waiting_refusals: int = 1_024
    windows: int = 1_024
    windows_of_client: int = 128
    ended_windows: int = 64
    place_characters: int = 200
    room_ms: int = 1_000
    refusal_delay_ms: int = 100
    tree_page: int = 1_024
    growth_page: int = 1_024
    rotation_block: int = 256
    rotation_kept: int = 4_096
    rotation_again_ms: int = 60_000
    witness_answer_bytes: int = 1 << 16
    witness_s: float = 5.0
    witness_exchanges: int = 2
    witness_retry_ms: int = 1_000
    witness_most_retry_ms: int = 60_000
    witness_sizes: int = 3
    witness_look_s: float = 0.01


#: The bounds in force.
LIMITS = GateLimits()
