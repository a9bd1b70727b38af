"""Senders: one attempt to deliver one notice to one target.

URLs are those of the configuration, never of a client, and redirects are not followed: what a
receiver answers cannot make the gateway call something else. Of an answer only the status is read.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import ssl
from email.message import EmailMessage
from email.utils import formatdate
from typing import Protocol

import aiosmtplib
import httpx
import msgspec

from rcp_kernel.clock import Clock
from rcp_kernel.errors import ConfigError
from rcp_triggers.config import Mail, Ntfy, Target, Webhook, secret_of
from rcp_triggers.notice import Delivery

__all__ = ["Failed", "Refused", "Sender", "sender_for"]

_REFUSED = (400, 413, 422)  # the message itself is at fault, and would be again
_PRIORITY = {"info": 3, "warning": 4, "critical": 5}
_PERMANENT = 500  # SMTP replies from here on are final


class Failed(Exception):
    """An attempt failed; another may succeed."""


class Refused(Exception):
    """The target refused this message for good."""


class Sender(Protocol):
    """Delivers to one target."""

    async def send(self, delivery: Delivery) -> None:
        """Try once.

        :raises Failed: it failed; try again.
        :raises Refused: it will never succeed.
        """
        ...

    async def close(self) -> None:
        """Release connections."""
        ...


def sender_for(name: str, target: Target, clock: Clock) -> Sender:
    """Return the sender of a target.

    :raises ConfigError: its CA file cannot be read.
    """
    match target:
        case Webhook():
            return _WebhookSender(target, _trusted(name, target), clock)
        case Ntfy():
            return _NtfySender(target, _trusted(name, target))
        case Mail():
            return _MailSender(target, _trusted(name, target))


def _trusted(name: str, target: Target) -> ssl.SSLContext:
    context = httpx.create_ssl_context(trust_env=False)
    if target.ca is not None:
        try:
            context.load_verify_locations(target.ca)
        except OSError as error:
            raise ConfigError(
                f"[features.triggers.targets.{name}] ca cannot be read ({error}): set it to a PEM "
                "file of certificates"
            ) from None
    return context


class _Poster:
    """Posts to one URL."""

    def __init__(self, url: str, timeout: float, trusted: ssl.SSLContext) -> None:
        self._url = url
        self._client = httpx.AsyncClient(
            timeout=timeout, follow_redirects=False, trust_env=False, verify=trusted
        )

    async def post(self, body: bytes, headers: dict[str, str]) -> None:
        """Post once; the answer's body is not read."""
        try:
            async with self._client.stream(
                "POST", self._url, content=body, headers=headers
            ) as response:
                status = response.status_code
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise Failed(f"{type(error).__name__}: {error}"[:200]) from error
        if status in _REFUSED:
            raise Refused(f"answered {status}")
        if 300 <= status < 400:
            raise Failed(f"answered {status}: redirects are not followed; set `url` to the target")
        if not 200 <= status < 300:
            raise Failed(f"answered {status}")

    async def close(self) -> None:
        """Close connections."""
        await self._client.aclose()


class _WebhookSender:
    """Signs as Standard Webhooks specify."""

    def __init__(self, target: Webhook, trusted: ssl.SSLContext, clock: Clock) -> None:
        self._poster = _Poster(target.url, target.timeout, trusted)
        self._key = secret_of(target)
        self._headers = {name.lower(): value for name, value in target.headers.items()}
        self._clock = clock
        self.close = self._poster.close

    async def send(self, delivery: Delivery) -> None:
        """Post it with its id, the time of this attempt, and the signature of all."""
        body, moment = delivery.body(), str(self._clock.now() // 1_000_000_000)
        signed = f"{delivery.id}.{moment}.".encode() + body
        signature = base64.b64encode(hmac.digest(self._key, signed, hashlib.sha256)).decode()
        headers = {
            **self._headers,
            "content-type": "application/json",
            "webhook-id": delivery.id,
            "webhook-timestamp": moment,
            "webhook-signature": f"v1,{signature}",
            "idempotency-key": delivery.id,
        }
        await self._poster.post(body, headers)


class _NtfySender:
    """Publishes in JSON, which has no limits on the characters of a title."""

    def __init__(self, target: Ntfy, trusted: ssl.SSLContext) -> None:
        server, _, self._topic = target.url.rpartition("/")
        self._poster = _Poster(server + "/", target.timeout, trusted)
        self._token = target.token
        self.close = self._poster.close

    async def send(self, delivery: Delivery) -> None:
        """Publish it."""
        message = {
            "topic": self._topic,
            "title": delivery.title,
            "message": delivery.text,
            "priority": _PRIORITY[delivery.notice.severity],
            "tags": ["white_check_mark" if delivery.type == "trigger.cleared" else "robot"],
        }
        headers = {"content-type": "application/json", "idempotency-key": delivery.id}
        if self._token is not None:
            headers["authorization"] = f"Bearer {self._token}"
        await self._poster.post(msgspec.json.encode(message), headers)


class _MailSender:
    """Sends e-mail; its Message-ID is the delivery's, so that a mailbox can tell repeats."""

    def __init__(self, target: Mail, trusted: ssl.SSLContext) -> None:
        self._target = target
        self._trusted = trusted

    async def send(self, delivery: Delivery) -> None:
        """Hand it over to the server."""
        target = self._target
        try:
            await aiosmtplib.send(
                self._message(delivery),
                sender=target.sender,
                recipients=list(target.to),
                hostname=target.host,
                port=target.port,
                username=target.user,
                password=target.password,
                use_tls=target.tls == "tls",
                start_tls=target.tls == "starttls",
                tls_context=None if target.tls == "none" else self._trusted,
                timeout=target.timeout,
            )
        except (aiosmtplib.SMTPRecipientsRefused, aiosmtplib.SMTPDataError) as error:
            raise (Refused if _permanent(error) else Failed)(str(error)[:200]) from error
        except (aiosmtplib.SMTPException, OSError) as error:
            raise Failed(f"{type(error).__name__}: {error}"[:200]) from error

    def _message(self, delivery: Delivery) -> EmailMessage:
        target, message = self._target, EmailMessage()
        message["From"] = target.sender
        message["To"] = ", ".join(target.to)
        message["Subject"] = delivery.title
        message["Date"] = formatdate(delivery.created / 1e9)
        message["Message-ID"] = f"<{delivery.id}@{target.sender.rpartition('@')[2]}>"
        message["Auto-Submitted"] = "auto-generated"
        message.set_content(delivery.text)
        return message

    async def close(self) -> None:
        """Nothing stays open."""


def _permanent(error: aiosmtplib.SMTPException) -> bool:
    if isinstance(error, aiosmtplib.SMTPRecipientsRefused):
        return all(one.code >= _PERMANENT for one in error.recipients)
    return isinstance(error, aiosmtplib.SMTPDataError) and error.code >= _PERMANENT
