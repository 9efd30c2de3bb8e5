"""Everything that can go wrong, by who is at fault and whether trying again can help.

Each message says what happened, where (device, file or key) and what to do about it. The command line prints
it as one line and exits with `exit_status`; the service retries only what says `retryable`.
"""

from __future__ import annotations

from pathlib import Path


class LabdaemonError(Exception):
    """Root of all errors that labdaemon raises on purpose."""

    retryable = False
    exit_status = 1


class UsageError(LabdaemonError):
    """The caller asked for something that makes no sense; the message says what to write instead."""

    exit_status = 2


class ConfigError(LabdaemonError):
    """A file that a person writes (rig, campaign) is wrong.

    Parameters
    ----------
    message
        What is wrong and what would be right.
    source
        The file it was read from.
    key
        The key's path in it, as `phase[2].frequency_hz`.
    """

    exit_status = 2

    def __init__(self, message: str, *, source: Path | str | None = None, key: str | None = None) -> None:
        self.source: Path | str | None = source
        self.key: str | None = key
        where = ": ".join(str(part) for part in (source, key) if part is not None)
        super().__init__(f"{where}: {message}" if where else message)


class DataError(LabdaemonError):
    """A frame, survey or journal on disk cannot be used.

    Parameters
    ----------
    message
        What is wrong with it and what to do.
    file
        The file at fault.
    """

    exit_status = 2

    def __init__(self, message: str, *, file: Path | str | None = None) -> None:
        self.file = file
        super().__init__(f"{file}: {message}" if file is not None else message)


class SetupError(DataError):
    """What all results of a camera depend on is wrong; nothing is worth capturing until a person has mended it."""


class StorageError(DataError):
    """A file or folder cannot be written (or a disk cannot be read)."""


class StorageUnavailable(StorageError):
    """The disk takes nothing now, and may again without a person's edit: full, locked, read-only, not answering.

    Nothing was lost: what had been committed stays, what had not is repeated.
    """

    retryable = True
    exit_status = 1


class StorageFull(StorageUnavailable):
    """No space is left, or a quota is used up."""


class DeviceError(LabdaemonError):
    """A device did not do what it was asked. Root of transport and protocol faults.

    Parameters
    ----------
    message
        What happened and what to do.
    device
        The device's name in the rig file.
    """

    def __init__(self, message: str, *, device: str | None = None) -> None:
        self.device = device
        super().__init__(f"{device}: {message}" if device else message)


class TransportError(DeviceError):
    """The wire failed: port gone, cable out, no answer in time."""

    retryable = True


class ProtocolError(DeviceError):
    """The device answered, but not in its protocol."""

    retryable = True


class DeviceRefused(DeviceError):
    """The device understood and said no: its own error queue, a property that is read-only, a full card."""


class DriverFault(DeviceError):
    """A driver raised what no driver should: a slip in it, or in a library under it. Connecting anew may help."""

    retryable = True


class ServiceFailure(LabdaemonError):
    """A running service ended by itself; its cause says why. Never exit status 2: a restart may help."""


class InterlockError(LabdaemonError):
    """A limit was crossed, so the shaker was stopped. Never retried by itself."""


class RestUnconfirmed(InterlockError):
    """The table was stopped by all that is left, and nothing that can see confirms that it rests.

    Parameters
    ----------
    message
        What was seen and tried; names the emergency stop.
    table
        ``moving`` where something sees motion, else ``unconfirmed``.
    """

    def __init__(self, message: str, *, table: str = "unconfirmed") -> None:
        self.table = table
        super().__init__(message)


class LimitError(ConfigError):
    """A campaign asks for more than the table, the disk or a camera can do."""
