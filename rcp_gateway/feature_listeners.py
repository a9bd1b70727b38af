"""The listeners of a feature, isolated from its errors; gaps in the record of one that keeps it."""

from __future__ import annotations

from rcp_kernel.contract.events import Event, EventHandler
from rcp_kernel.errors import QueueFull
from rcp_kernel.features import Durability
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.sessions.command import Command, CommandListener, Record
from rcp_kernel.sessions.session import Answer
from rcp_kernel.wire import Reply
from rcp_requests.journal import Idle

__all__ = ["DurableListener", "FeatureListener"]


class _Busy:
    idle = False


def _ignore(_command: Command, _step: Record) -> None:
    """Ignore a step of a command."""


def _ignore_event(_event: Event) -> None:
    """Ignore an event."""


class FeatureListener:
    """A feature's listeners, and what follows from their errors."""

    def __init__(
        self,
        on_event: EventHandler | None,
        on_command: CommandListener | None,
        health: FeatureHealth,
        *,
        feedback: bool,
    ) -> None:
        self.hears_events = on_event is not None
        self.on_event = on_event or _ignore_event
        self.failing = False
        self.hears_commands = on_command is not None
        self.hears_feedback = feedback
        self.on_command = on_command or _ignore
        may_idle = isinstance(on_command, Idle) and not callable(on_command.idle)
        self.state: Idle = on_command if may_idle else _Busy()  # pyright: ignore[reportAttributeAccessIssue]
        self.health = health

    def missed_event(self, event: Event, error: Exception) -> None:
        """Note that the feature did not accept an event."""
        self.health.failed("on_event", error, what=event.what, path=event.path)

    def missed_step(self, command: Command, step: Record, error: Exception) -> None:
        """Note that the feature did not accept a step."""
        self.health.failed("on_command", error, command=command.id, path=command.path)


class DurableListener(FeatureListener):
    """The listener of a feature that keeps records, and its `Durability`.

    Events that it did not accept are not confirmed: a write or command that was executed gets an
    error, a command that was not is refused. An event `unrecorded` is recorded instead. While the
    feature cannot accept even that, writes and commands are refused, as if a store could not be
    written; each refusal is an event too, and the first one that is accepted ends this state.
    """

    def __init__(
        self,
        on_event: EventHandler | None,
        on_command: CommandListener | None,
        health: FeatureHealth,
        durability: Durability,
        *,
        feedback: bool,
    ) -> None:
        super().__init__(on_event, on_command, health, feedback=feedback)
        self._durability = durability
        self.send_when_stored = durability.send_when_stored
        self.lost = 0
        """Number of events that were not recorded."""

    def missed_event(self, event: Event, error: Exception) -> None:
        """Record the gap for an event, with the few facts known to be valid."""
        super().missed_event(event, error)
        self._missed(event)

    def _missed(self, event: Event) -> None:
        self.lost += 1
        if not self.hears_events:
            return
        gap = Event(
            what="unrecorded",
            principal=event.principal,
            tenant=event.tenant,
            path=event.path,
            outcome="internal",
            facts={"event": event.what},
        )
        try:
            self.on_event(gap)
        except Exception as error:
            self.failing = True
            self.health.failed("on_event", error, what=gap.what)

    def missed_step(self, command: Command, step: Record, error: Exception) -> None:
        """Record the gap for a step of a command, which is then not confirmed."""
        super().missed_step(command, step, error)
        command.unrecorded = True
        requester = command.requester
        self._missed(
            Event(
                what="execute" if step.status == "accepted" else "command",
                principal=None if requester is None else requester.principal,
                tenant=command.tenant,
                path=command.path,
            )
        )

    def check(self) -> None:
        """Refuse a write or command whose record could not be stored.

        :raises QueueFull: it could not.
        """
        if self.failing:
            raise QueueFull(
                f"nothing can be recorded ({self.health.name}: {self.health.fault}); commands and "
                "writes are refused until this works again",
                remedy="Ask the operator to look into the log of the gateway.",
                retry_after=1.0,
            )
        self._durability.check()

    def send_estop_when_stored(self, send: Answer, reply: Reply) -> None:
        """Send the reply to an e-stop, in any case."""
        if self.failing:
            reply.message = f"{reply.message or ''} There is no audit record of it.".lstrip()
        self._durability.send_estop_when_stored(send, reply)
