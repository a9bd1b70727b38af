"""What the clients of all WebSockets share: turns of the loop, pauses, flushing and the end."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from itertools import count as counting
from typing import Any

import pytest
from structlog.testing import capture_logs

from configuration import backend, configuration, key
from rcp_kernel.contract.peer import UNKNOWN
from rcp_kernel.values import Encoding
from rcp_web import socket_client
from rcp_web.socket_client import SocketClient
from transports.robot import KEY
from transports.scripted_socket import Place, ScriptedSocket

BACKLOG = 40  # replies
NEVER = 1000.0  # s of a turn that is not used up
BAD = b'{"n":"bad"}'
LONG = b'{"n":"long"}'


class Echo(SocketClient):
    """Says again what it is told; a `long` message takes until the test ends it."""

    def __init__(self, place: Place, socket: ScriptedSocket, *, known: bool = True) -> None:
        api = place.server.client_api
        who = (api.authenticate(KEY) if known else None, None)
        super().__init__(api, who, Encoding.JSON, socket, UNKNOWN, BACKLOG)
        self.connection.set_callbacks(
            hello=lambda _hello: {}, released=self._gate.put_back, cut=self._cut_off
        )
        self.handled: list[bytes] = []
        self.busy = False
        self.released = 0
        self._agree()

    def _agree(self) -> None:
        self._plain = not self._socket.compresses
        if self._plain:
            self._outbox.send_frames(self._socket.head, self._socket.pass_on)

    def _handle(self, data: bytes) -> None:
        self.handled.append(data)
        if data == BAD:
            raise ZeroDivisionError
        if data == LONG:
            self.busy = True
            self._gate.review()
        else:
            self._outbox.put(data)

    def done(self) -> None:
        self.busy = False
        self._gate.review()

    def _waits(self) -> bool:
        return self.busy

    def _failed(self, data: bytes, error: Exception) -> None:
        self._outbox.put(b'{"n":"sorry"}')

    def oversized(self, size: int) -> None:
        self._outbox.put(b'{"n":"oversized"}')

    def garbled(self, data: bytes) -> None:
        raise AssertionError(data)

    def _release(self) -> None:
        self.released += 1
        self.connection.close(resumable=False)


@pytest.fixture(scope="module")
def shared() -> Generator[Place]:
    place = Place()
    place.serve(configuration() + backend() + key("op", KEY, role="operator"))
    yield place
    place.close()


@pytest.fixture
def place(shared: Place, monkeypatch: pytest.MonkeyPatch) -> Place:
    monkeypatch.setattr(socket_client, "_TURN", NEVER)
    return shared


def connected(
    place: Place, *, known: bool = True, compresses: bool = False
) -> tuple[ScriptedSocket, Echo]:
    socket = ScriptedSocket(place)
    socket.compresses = compresses
    with place.inside():
        client = Echo(place, socket, known=known)
        socket.attach(client)
    return socket, client


def messages(count: int) -> list[bytes]:
    return [b'{"n":%d}' % number for number in range(count)]


def turn(place: Place, count: int = 1) -> None:
    async def go() -> None:
        for _ in range(count):
            await asyncio.sleep(0)

    place.do(go())


def numbers(socket: ScriptedSocket) -> list[Any]:
    return [reply["n"] for reply in socket.replies]


def test_all_messages_of_a_read_are_answered_when_it_has_ended(place: Place) -> None:
    socket, client = connected(place)
    socket.inbound.extend(messages(5))
    with place.inside():
        for data in messages(4):
            client.received(data)
        assert not socket.replies
        client.settled()
    assert numbers(socket) == [0, 1, 2, 3]


def test_compressed_messages_are_not_framed_ahead(place: Place) -> None:
    socket, _client = connected(place, compresses=True)
    socket.write_frames = pytest.fail  # type: ignore[method-assign, assignment] - of this socket alone
    for number in (1, 5):
        socket.inbound.extend(messages(number))
        socket.read(number)
    assert numbers(socket) == [0, 0, 1, 2, 3, 4]


def test_a_used_up_turn_keeps_the_rest_for_the_next_ones_in_order(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    socket, client = connected(place)
    monkeypatch.setattr(socket_client, "_TURN", 0.0005)
    clock = counting()  # each look at the clock is a tenth of a millisecond later
    monkeypatch.setattr(socket_client, "perf_counter", lambda: next(clock) * 0.0001)
    socket.inbound.extend(messages(20))
    socket.read(20)
    assert 0 < len(client.handled) < 10
    assert not socket.reading
    turn(place, 20)
    assert client.handled == messages(20)
    assert numbers(socket) == list(range(20))
    assert socket.reading


def test_frames_that_are_no_messages_use_up_a_turn_too(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    socket, client = connected(place)
    monkeypatch.setattr(socket_client, "_TURN", -1.0)
    with place.inside():
        client.other_frame()
        assert socket.reading
        client.other_frame()
        assert not socket.reading
        client.settled()
    turn(place, 2)
    assert socket.reading


def test_many_short_reads_of_one_turn_of_the_loop_count_together(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    socket, client = connected(place)
    monkeypatch.setattr(socket_client, "_TURN", 0.0005)
    clock = counting()
    monkeypatch.setattr(socket_client, "perf_counter", lambda: next(clock) * 0.0001)
    socket.inbound.extend(messages(20))
    while socket.reading and socket.inbound:
        socket.read(1)
    assert 1 < len(client.handled) < 10
    turn(place, 2)
    assert socket.reading


def test_later_messages_wait_for_one_that_is_still_being_handled(place: Place) -> None:
    socket, client = connected(place)
    socket.inbound.extend([LONG, *messages(3)])
    socket.read(2)
    assert client.handled == [LONG]
    assert not socket.reading
    turn(place, 5)
    assert client.handled == [LONG]
    with place.inside():
        client.done()
    assert client.handled == [LONG, *messages(1)]
    assert socket.reading


def test_one_message_that_cannot_be_handled_takes_no_other_with_it(place: Place) -> None:
    socket, client = connected(place)
    socket.inbound.extend([BAD, b" " * (socket.limit + 1), *messages(1)])
    socket.read(3)
    assert client.handled == [BAD, *messages(1)]
    assert numbers(socket) == ["sorry", "oversized", 0]


def test_a_client_that_does_not_take_its_replies_is_not_read_until_it_does(place: Place) -> None:
    socket, client = connected(place)
    socket.writable = False
    socket.inbound.extend(messages(3 * BACKLOG))
    socket.read(3 * BACKLOG)
    assert BACKLOG <= len(client.handled) <= BACKLOG + 32
    assert not socket.reading
    assert not socket.replies
    turn(place, 5)
    assert not socket.replies
    socket.take()
    turn(place, 5)
    assert numbers(socket) == list(range(3 * BACKLOG))
    assert socket.reading


def test_what_is_left_after_a_write_is_sent_when_the_client_reads_again(place: Place) -> None:
    socket, client = connected(place)
    socket.writable = False
    with place.inside():
        client.connection.outbox.put(b'{"n":1}')
        client.flush()
    assert not socket.replies
    socket.take()
    assert numbers(socket) == [1]


def test_a_client_that_says_nothing_of_itself_is_turned_away(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_client, "_PATIENCE", 0.0)
    socket, _client = connected(place, known=False)
    known, _other = connected(place)
    turn(place, 3)
    assert (socket.code, known.code) == (1008, None)


def test_a_session_that_has_ended_is_said_and_closed(place: Place) -> None:
    socket, client = connected(place)
    with place.inside():
        client.connection.outbox.put(b'{"n":"last"}')
        client.connection.expelled = True
        client.flush()
    assert numbers(socket) == ["last"]
    assert socket.code == 1008


def test_an_error_while_sending_closes_with_a_code_and_is_logged(place: Place) -> None:
    socket, client = connected(place)

    def broken(_parts: list[bytes]) -> None:
        raise ZeroDivisionError

    socket.write_frames = broken  # type: ignore[method-assign] - of this socket alone
    with capture_logs() as said, place.inside():
        for data in messages(2):
            client.connection.outbox.put(data)
        client.flush()
    assert socket.code == 1011
    (entry,) = (one for one in said if one["event"] == "websocket_failed")
    assert entry["transport"] == place.server.client_api.name


def test_a_client_that_reads_nothing_is_cut_off_when_memory_runs_out(place: Place) -> None:
    socket, client = connected(place)
    cut = client.connection.outbox.backlog.close_client
    assert cut is not None
    with place.inside():
        cut()
    assert socket.code == 1013


def test_nothing_is_handled_for_a_client_that_is_gone(place: Place) -> None:
    socket, client = connected(place)
    socket.inbound.extend([LONG, *messages(3)])
    socket.read(4)
    socket.lose(1006)
    with place.inside():
        client.done()
    assert client.handled == [LONG]
    assert client.released == 1
    assert client.gone.is_set()
