"""Who gets in, as the rig file says it: off loopback no daemon starts without keys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.rig_sections import GatewaySection
from labdaemon.service.doors import open_doors
from labdaemon.service_section import ServiceSection, keys_folder, read_service
from labdaemon.stream.access import CLIENTS
from labdaemon.stream.listener import SocketFile
from labdaemon.testing.stream_daemon import FakeKeys


class Rig:
    """What of a rig's config is looked at."""

    def __init__(self, folder: Path, gateway: GatewaySection | None = None, **service: object) -> None:
        self.source, self.gateway = folder / "rig.toml", gateway
        self.service = ServiceSection.model_validate(service)


OUTSIDE = {"commands": "tcp://0.0.0.0:5570", "events": "tcp://127.0.0.1:5571"}


@pytest.mark.parametrize(
    ("service", "key"),
    [
        (OUTSIDE, "service.commands"),
        ({"events": "tcp://*:5571"}, "service.events"),
        ({"commands": "tcp://[::]:5570"}, "service.commands"),
        ({"commands": "tcp://lab-pc:*"}, "service.commands"),
        ({"commands": "tcp://192.0.2.7:5570", "events": "tcp://192.0.2.7:5571"}, "service.commands"),
        ({"commands": "tcp://127.0.0.1.example.org:5570"}, "service.commands"),
        ({"local_operators": "keys"}, "service.commands"),
    ],
)
def test_without_keys_it_does_not_start(tmp_path: Path, service: dict[str, str], key: str) -> None:
    for text in (None, "# no one yet\n"):
        if text is not None:
            (tmp_path / "keys").mkdir()
            (tmp_path / "keys" / CLIENTS).write_text(text)
        with pytest.raises(ConfigError, match="labdaemon keys make") as refused:
            open_doors(Rig(tmp_path, **service))  # type: ignore[arg-type]
        assert refused.value.key == key
        assert "\n" not in str(refused.value)
        assert refused.value.exit_status == 2


def test_keys_are_asked_for_where_the_address_needs_them(tmp_path: Path) -> None:
    FakeKeys(tmp_path / "keys")
    doors = open_doors(Rig(tmp_path, **OUTSIDE))  # type: ignore[arg-type]
    assert doors.access is doors.commands.access is not None
    assert doors.events.access is None
    doors = open_doors(Rig(tmp_path, local_operators="keys"))  # type: ignore[arg-type]
    assert doors.commands.access is doors.events.access is doors.access is not None


def test_on_loopback_no_keys_are_made(tmp_path: Path) -> None:
    doors = open_doors(Rig(tmp_path))  # type: ignore[arg-type]
    assert doors.access is doors.commands.access is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("operators", "place"),
    [
        (None, SocketFile(0o600)),
        ("owner", SocketFile(0o600)),
        ("group:lab", SocketFile(0o660, "lab")),
        ("all", SocketFile(0o666)),
    ],
)
def test_files_of_unix_sockets_say_who_is_an_operator(tmp_path: Path, operators: str | None, place: SocketFile) -> None:
    service = {"commands": "ipc:///run/c", "events": "ipc:///run/e", "local_operators": operators}
    doors = open_doors(Rig(tmp_path, **service))  # type: ignore[arg-type]
    assert doors.commands.place == doors.events.place == place


def test_the_daemons_own_key_is_made_on_first_need(tmp_path: Path) -> None:
    keys = FakeKeys(tmp_path / "keys")
    (keys.folder / "daemon.key").unlink()
    doors = open_doors(Rig(tmp_path, **OUTSIDE))  # type: ignore[arg-type]
    assert doors.access is not None
    assert doors.access.pair.public != keys.daemon.public
    assert replace(doors.access.pair).secret not in repr(doors.access.pair)


def test_service_is_read_whatever_else_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('[service]\nkeys = "../k"\n[shaker]\nnonsense = 1\n')
    assert keys_folder(path, read_service(path)) == tmp_path.parent / "k"
    path.write_text("service = 1\n")
    with pytest.raises(ConfigError, match="no table"):
        read_service(path)
