"""Every command as a method with typed parameters and a typed result; parameters that are None are not sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

if TYPE_CHECKING:
    from labdaemon.events.payloads import EventPart
    from labdaemon.stream import results

STOP_S = 15.0
SUBMIT_S = 60.0
CAPTURE_S = 120.0
"""How long these commands may take: a stop watches the table, a plan is checked, a capture may wait its turn."""


class CaptureParameters(TypedDict, total=False):
    """What may be stated of a capture: hertz, millimetres zero to peak, radians, seconds."""

    label: str
    sharp: bool
    frequency_hz: float
    excitation_amplitude_mm: float
    phase_rad: float
    group: str
    exposure_s: float
    request_id: str


def typed(name: str, answer: Any) -> Any:
    """An answer as the model of this name."""
    from labdaemon.stream import results  # the models take longer to load than `labdaemon stop` may take

    model = cast("type[EventPart]", getattr(results, name))
    return model.model_validate(answer)


class TypedCommands:
    """Commands as methods; `Client` is one. Each raises as `Client.call`."""

    def call(self, method: str, *, timeout_s: float | None = None, **params: Any) -> Any:
        """Do a command and return its result as it came."""
        raise NotImplementedError

    def _do(self, method: str, model: str, timeout_s: float | None = None, **params: Any) -> Any:
        given = {name: value for name, value in params.items() if value is not None}
        return typed(model, self.call(method, timeout_s=timeout_s, **given))

    def status(self) -> results.StatusResult:
        """What the daemon does now."""
        return cast("results.StatusResult", self._do("status", "StatusResult"))

    def rig(self) -> results.RigResult:
        """The rig: devices, cameras, limits, addresses."""
        return cast("results.RigResult", self._do("rig", "RigResult"))

    def submit(self, toml: str, *, request_id: str | None = None) -> results.SubmitResult:
        """Queue a campaign, given as the text of its file."""
        answer = self._do("campaign.submit", "SubmitResult", SUBMIT_S, toml=toml, request_id=request_id)
        return cast("results.SubmitResult", answer)

    def pause(self, campaign: str | None = None) -> results.CampaignResult:
        """Bring the table to rest and wait."""
        return cast("results.CampaignResult", self._do("campaign.pause", "CampaignResult", STOP_S, campaign=campaign))

    def resume(self, campaign: str | None = None, *, accept_changed_rig: bool | None = None) -> results.CampaignResult:
        """Continue a paused campaign."""
        params = {"campaign": campaign, "accept_changed_rig": accept_changed_rig}
        return cast("results.CampaignResult", self._do("campaign.resume", "CampaignResult", STOP_S, **params))

    def abort(self, campaign: str | None = None) -> results.CampaignResult:
        """End a campaign for good."""
        return cast("results.CampaignResult", self._do("campaign.abort", "CampaignResult", STOP_S, campaign=campaign))

    def campaigns(self, limit: int | None = None) -> results.CampaignListResult:
        """Campaigns, the newest first."""
        return cast("results.CampaignListResult", self._do("campaign.list", "CampaignListResult", limit=limit))

    def campaign(self, campaign: str | None = None) -> results.CampaignShowResult:
        """One campaign in full; the current one by default."""
        return cast("results.CampaignShowResult", self._do("campaign.show", "CampaignShowResult", campaign=campaign))

    def move(self, campaign: str, place: int = 0) -> results.MoveResult:
        """Give a queued campaign another place, counted from 0."""
        return cast("results.MoveResult", self._do("campaign.move", "MoveResult", campaign=campaign, place=place))

    def capture(self, **stated: Unpack[CaptureParameters]) -> results.CaptureReply:
        """Fire all shutters once; returns when they have opened."""
        return cast("results.CaptureReply", self._do("capture", "CaptureReply", CAPTURE_S, **stated))

    def stop(self) -> results.StopResult:
        """Bring the shaker to rest now."""
        return cast("results.StopResult", self._do("stop", "StopResult", STOP_S))

    def discover(self) -> results.DiscoverResult:
        """The OpenRPC document of the daemon's version."""
        return cast("results.DiscoverResult", self._do("rpc.discover", "DiscoverResult"))


class AsyncTypedCommands:
    """The same to be awaited; `AsyncClient` is one."""

    async def call(self, method: str, *, timeout_s: float | None = None, **params: Any) -> Any:
        """Do a command and return its result as it came."""
        raise NotImplementedError

    async def _do(self, method: str, model: str, timeout_s: float | None = None, **params: Any) -> Any:
        given = {name: value for name, value in params.items() if value is not None}
        return typed(model, await self.call(method, timeout_s=timeout_s, **given))

    async def status(self) -> results.StatusResult:
        """What the daemon does now."""
        return cast("results.StatusResult", await self._do("status", "StatusResult"))

    async def rig(self) -> results.RigResult:
        """The rig: devices, cameras, limits, addresses."""
        return cast("results.RigResult", await self._do("rig", "RigResult"))

    async def submit(self, toml: str, *, request_id: str | None = None) -> results.SubmitResult:
        """Queue a campaign, given as the text of its file."""
        answer = await self._do("campaign.submit", "SubmitResult", SUBMIT_S, toml=toml, request_id=request_id)
        return cast("results.SubmitResult", answer)

    async def pause(self, campaign: str | None = None) -> results.CampaignResult:
        """Bring the table to rest and wait."""
        answer = await self._do("campaign.pause", "CampaignResult", STOP_S, campaign=campaign)
        return cast("results.CampaignResult", answer)

    async def resume(
        self, campaign: str | None = None, *, accept_changed_rig: bool | None = None
    ) -> results.CampaignResult:
        """Continue a paused campaign."""
        params = {"campaign": campaign, "accept_changed_rig": accept_changed_rig}
        return cast("results.CampaignResult", await self._do("campaign.resume", "CampaignResult", STOP_S, **params))

    async def abort(self, campaign: str | None = None) -> results.CampaignResult:
        """End a campaign for good."""
        answer = await self._do("campaign.abort", "CampaignResult", STOP_S, campaign=campaign)
        return cast("results.CampaignResult", answer)

    async def campaigns(self, limit: int | None = None) -> results.CampaignListResult:
        """Campaigns, the newest first."""
        return cast("results.CampaignListResult", await self._do("campaign.list", "CampaignListResult", limit=limit))

    async def campaign(self, campaign: str | None = None) -> results.CampaignShowResult:
        """One campaign in full; the current one by default."""
        answer = await self._do("campaign.show", "CampaignShowResult", campaign=campaign)
        return cast("results.CampaignShowResult", answer)

    async def move(self, campaign: str, place: int = 0) -> results.MoveResult:
        """Give a queued campaign another place, counted from 0."""
        return cast("results.MoveResult", await self._do("campaign.move", "MoveResult", campaign=campaign, place=place))

    async def capture(self, **stated: Unpack[CaptureParameters]) -> results.CaptureReply:
        """Fire all shutters once; returns when they have opened."""
        return cast("results.CaptureReply", await self._do("capture", "CaptureReply", CAPTURE_S, **stated))

    async def stop(self) -> results.StopResult:
        """Bring the shaker to rest now."""
        return cast("results.StopResult", await self._do("stop", "StopResult", STOP_S))

    async def discover(self) -> results.DiscoverResult:
        """The OpenRPC document of the daemon's version."""
        return cast("results.DiscoverResult", await self._do("rpc.discover", "DiscoverResult"))
