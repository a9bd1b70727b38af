"""Laws of the chain: whatever single thing is done to the record is found, and nothing else is."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from plugins.audit.test_audit import Timers
from rcp_audit.throttle import DenialThrottle
from rcp_store.chain import GENESIS, Head, Row, link, parse_head, written
from rcpd.verification import verify


def chain(count: int, *, after: Head = (0, GENESIS), pruned: bool = False) -> list[Row]:
    rows: list[Row] = []
    seq, digest = after
    for _ in range(count):
        seq += 1
        record = {"seq": seq, "time": "2026-01-01T00:00:00.000000000Z", "what": "write"}
        if pruned and seq == after[0] + count:
            record |= {"what": "prune", "to": after[0], "hash": after[1].hex()}
        data = msgspec.json.encode(record)
        digest = link(digest, data)
        rows.append((seq, digest, data))
    return rows


def head(rows: list[Row]) -> Head:
    return rows[-1][:2]


chains = st.integers(2, 30).map(chain)


@given(chains)
def test_a_chain_that_nobody_touched_verifies(rows: list[Row]) -> None:
    verdict = verify(rows, None, [head(rows), (0, GENESIS), rows[0][:2]])
    assert verdict.findings == []
    assert (verdict.count, verdict.first, verdict.head) == (len(rows), 1, head(rows))


@given(chains, st.data())
def test_any_changed_bit_is_found(rows: list[Row], data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(rows) - 1))
    seq, digest, text = rows[place]
    part = data.draw(st.sampled_from(["hash", "record"]))
    changed = bytearray(digest if part == "hash" else text)
    bit = data.draw(st.integers(0, len(changed) * 8 - 1))
    changed[bit // 8] ^= 1 << bit % 8
    row = (seq, bytes(changed), text) if part == "hash" else (seq, digest, bytes(changed))
    found = verify([*rows[:place], row, *rows[place + 1 :]], None).findings
    assert seq in [number for number, _ in found]


@given(chains, st.data())
def test_any_removed_record_is_found_and_named(rows: list[Row], data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(rows) - 1))
    found = verify([*rows[:place], *rows[place + 1 :]], None, [head(rows)]).findings
    assert found[0][0] == rows[place][0]


@given(chains, st.data())
def test_any_two_records_that_changed_places_are_found(
    rows: list[Row], data: st.DataObject
) -> None:
    first = data.draw(st.integers(0, len(rows) - 2))
    second = data.draw(st.integers(first + 1, len(rows) - 1))
    swapped = list(rows)
    swapped[first] = (rows[first][0], *rows[second][1:])
    swapped[second] = (rows[second][0], *rows[first][1:])
    found = verify(swapped, None).findings
    assert found[0][0] == rows[first][0]


@given(chains, st.data())
def test_an_inserted_record_is_found(rows: list[Row], data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(rows) - 1))
    seq = rows[place][0]
    text = msgspec.json.encode({"seq": seq, "what": "write", "forged": True})
    before = rows[place - 1][1] if place else GENESIS
    moved = [(n + 1, digest, told) for n, digest, told in rows[place:]]
    found = verify([*rows[:place], (seq, link(before, text), text), *moved], None).findings
    assert found


@given(chains, st.data())
def test_an_end_that_was_cut_off_is_found_by_a_head_kept_elsewhere(
    rows: list[Row], data: st.DataObject
) -> None:
    kept = data.draw(st.integers(0, len(rows) - 1))
    assert verify(rows[:kept], None, [head(rows)]).findings == [
        (kept + 1, f"missing: the head is record {len(rows)}")
    ]
    assert verify(rows[:kept], None).findings == []  # nothing else can tell


@given(chains)
def test_a_chain_that_was_made_anew_is_found_by_a_head_kept_elsewhere(rows: list[Row]) -> None:
    text = msgspec.json.encode({"seq": 1, "what": "write", "forged": True})
    forged: list[Row] = [(1, link(GENESIS, text), text)]
    anew = forged + chain(len(rows) - 1, after=forged[0][:2])
    assert verify(anew, None).findings == []
    assert verify(anew, None, [head(rows)]).findings


def test_a_pruned_chain_verifies_only_if_a_record_tells_of_the_pruning() -> None:
    old = chain(5)
    anchor = head(old)
    told, untold = chain(4, after=anchor, pruned=True), chain(4, after=anchor)
    assert verify(told, anchor).findings == []
    assert verify(untold, anchor).findings
    assert verify(told[1:], told[0][:2]).findings  # the anchor was moved


def test_a_restart_on_a_shorter_chain_is_found() -> None:
    rows = chain(5)

    def restarted(rows: list[Row], left: Head) -> list[Row]:
        seq = len(rows) + 1
        data = msgspec.json.encode({"seq": seq, "what": "start", "head": written(left)})
        return [*rows, (seq, link(rows[-1][1], data), data)]

    assert verify(restarted(rows, head(rows)), None).findings == []
    assert verify(restarted(rows, rows[2][:2]), None).findings == []  # a crash wrote the head late
    assert verify(restarted(rows[:3], head(rows)), None).findings[0][0] == 4


@given(st.integers(0, 2**60), st.binary(min_size=32, max_size=32))
def test_a_head_reads_as_it_was_written(seq: int, digest: bytes) -> None:
    assert parse_head(written((seq, digest))) == (seq, digest)


def test_a_flood_that_lasts_is_summed_up_in_ever_longer_windows() -> None:
    told: list[dict[str, float]] = []
    timers = Timers()
    flood = DenialThrottle(timers.loop, 3, told.append)
    passed = 0
    for length in (1, 2, 4, 8, 16, 32, 60, 60):
        for _ in range(length * 4):
            passed += flood.passes("x", {"principal": "x"}, "/p", "forbidden")
        timers.take()()
    assert passed == 3
    flood.close()
    assert sum(t["count"] for t in told) == 4 * 183 - 3
    assert [t["seconds"] for t in told] == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
