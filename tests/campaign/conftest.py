from __future__ import annotations

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.testing.lab import FakeLab


@pytest.fixture
def simulate(tmp_path: Path) -> Callable[..., Any]:
    """Run a scenario, a coroutine function of a started `FakeLab`, in simulated time."""

    def run(scenario: Callable[[FakeLab], Coroutine[Any, Any, Any]], **options: Any) -> Any:
        clock = SimulatedClock()

        async def main() -> Any:
            lab = FakeLab(tmp_path / "data", clock, **options)
            lab.start()
            try:
                return await scenario(lab)
            finally:
                await lab.kill()

        return clock.run(main())

    return run
