"""`/system/configuration`: its state, proposals and confirmations."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_configuration.seal import SealError, SealKey
from rcp_kernel.errors import InvalidValue, PreconditionFailed, UnsupportedOperation
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.configuration import FileState, ServedConfiguration
from rcp_kernel.sessions.session import Session

__all__ = ["PATH", "ConfigurationRequest", "ConfigurationService", "ConfigurationState"]

PATH = "/system/configuration"
_Digest = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class ConfigurationRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Either a proposal or a confirmation."""

    propose: Annotated[str, Meta(max_length=1_400_000)] | None = None
    """A whole file, sealed to `key`."""
    confirm: _Digest | None = None
    """Digest of the file that is on probation."""
    seconds: Annotated[float, Meta(ge=1, le=3600)] = 60.0
    """After which the gateway rolls back, unless the file is confirmed."""
    restart: bool = False
    """Whether the gateway may restart if the file needs it, which brings its robots to rest."""


class ConfigurationState(FileState, frozen=True, kw_only=True, omit_defaults=True):
    """The state of the file, and the key to which a proposal must be sealed."""

    key: str


class ConfigurationService:
    """Passes what clients ask to the file."""

    def __init__(self, host: FeatureHost) -> None:
        self._host = host
        self._key = SealKey()
        self._file: ServedConfiguration | None = None

    def serve(self, file: ServedConfiguration) -> None:
        """Take the file."""
        self._file = file

    def view(self, session: Session) -> ConfigurationState:
        """Return the state."""
        file = self._file
        return self._shown(FileState(digest="") if file is None else file.state)

    def _shown(self, state: FileState) -> ConfigurationState:
        return ConfigurationState(**msgspec.structs.asdict(state), key=self._key.public)

    def execute(
        self, session: Session, value: ConfigurationRequest, *, dry_run: bool
    ) -> ConfigurationState:
        """Check and apply a proposal, or confirm it.

        :raises RcpError: it is refused.
        """
        file = self._file
        if file is None:
            raise UnsupportedOperation("this gateway serves no configuration file")
        if (value.propose is None) == (value.confirm is None):
            raise InvalidValue("write either `propose` or `confirm`", path=PATH)
        principal = session.principal
        if value.confirm is not None:
            if dry_run:
                return self._shown(file.state)
            state, outcome = file.confirm(value.confirm, via=principal.via), "confirmed"
        else:
            text = self._opened(value.propose or "")
            if dry_run:
                file.check(text, restart=value.restart)
                return self._shown(file.state)
            state = file.propose(
                text,
                by=principal.name,
                via=principal.via,
                seconds=value.seconds,
                restart=value.restart,
            )
            outcome = "proposed"
        self._host.note(
            "configuration",
            principal=principal,
            session=session,
            path=PATH,
            outcome=outcome,
            digest=state.digest,
        )
        return self._shown(state)

    def _opened(self, sealed: str) -> str:
        try:
            return self._key.opened(sealed).decode()
        except SealError as error:
            raise PreconditionFailed(
                f"the proposal is {error}", path=PATH, remedy=f"Read `key` of {PATH} again."
            ) from None
        except UnicodeDecodeError:
            raise InvalidValue("the file is not UTF-8", path=PATH) from None
