"""A campaign's folder, made before its first frame: a data-set folder that `labdaemon process` takes as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.open_steps import group_sizes
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.steps import Plan
from labdaemon.capture.paths import campaign_folder
from labdaemon.capture.recorder import Recorder
from labdaemon.durable import move_durably, write_durably
from labdaemon.errors import StorageError
from labdaemon.journal import transitions
from labdaemon.journal.records import CampaignRecord
from labdaemon.journal.storage import JournalError


def prepare_folder(data: Path, campaign: str, files: Mapping[str, str]) -> Path:
    """Make the folder with these files (name to text) in it; files that are there already stay as they are.

    Raises
    ------
    StorageError
        The disk is full or cannot be written.
    """
    folder = campaign_folder(data, campaign)
    for name, text in files.items():
        if not (folder / name).exists():
            write_durably(folder / name, text)
    return folder


@dataclass(frozen=True, slots=True)
class CampaignFiles:
    """Keeps a campaign's folder and result files from its start to its end, off the event loop.

    Attributes
    ----------
    files
        Name and text of what each folder starts with: ``rig.toml`` and the surveys.
    """

    recorder: Recorder
    data: Path
    queue: MeasurementQueue
    reporter: CampaignReporter
    files: Mapping[str, str]

    async def open(self, record: CampaignRecord, plan: Plan) -> None:
        """Make the folder, and its result files as the journal has them; waits while the disk takes nothing.

        Raises
        ------
        StorageError
            The folder cannot be made: a reason to fail this campaign, and no other.
        """
        files = {**self.files, "campaign.toml": record.toml}
        sizes = group_sizes(plan)

        async def work() -> None:
            await self.recorder.on_disk(prepare_folder, self.data, record.id, files)
            await self.queue.resume(record.id, sizes)

        await self.reporter.with_disk_retry(work)

    async def renew(self, record: CampaignRecord) -> None:
        """Write the result files of a campaign that was paused anew: another program may have written to them."""
        try:
            await self.queue.rewrite(record.id)
        except JournalError:
            raise
        except StorageError:
            return  # they are written when it ends in any case, and that failure is reported

    async def accept(self, record: CampaignRecord, digest: str) -> None:
        """Take the rig as it is now, for a campaign that was planned for another: by us and by `process`.

        Waits while the disk takes nothing.

        Raises
        ------
        StorageError
            The folder refuses the files.
        """
        await self.recorder.write(transitions.accept_digest, record.id, digest)
        await self.reporter.with_disk_retry(
            lambda: self.recorder.on_disk(renew_folder, self.data, record.id, self.files)
        )

    async def close(self, record: CampaignRecord) -> StorageError | None:
        """Write the result files as the journal has them, synced; the reason where the folder refuses them."""
        try:
            await self.reporter.with_disk_retry(lambda: self.queue.close(record.id))
        except JournalError:
            raise
        except StorageError as exc:  # the caller pauses the campaign: it has not ended while its files lack rows
            return exc
        return None


def renew_folder(data: Path, campaign: str, files: Mapping[str, str]) -> list[str]:
    """Make the folder with these files in it; a file that says something else is kept under another name.

    Captures to come are measured with the rig as it is now, and `labdaemon process` reads the same files.

    Returns
    -------
    list of str
        New names of files that gave way, as ``rig-1.toml``.

    Raises
    ------
    DataError
        The disk is full or cannot be written.
    """
    folder = campaign_folder(data, campaign)
    moved: list[str] = []
    for name, text in files.items():
        path = folder / name
        if path.is_file() and path.read_bytes() != text.encode():
            moved.append(_free_name(path).name)
            move_durably(path, folder / moved[-1])
    prepare_folder(data, campaign, files)
    return moved


def _free_name(path: Path) -> Path:
    """A name next to a file's that no other file has."""
    number = 1
    while (other := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
        number += 1
    return other
