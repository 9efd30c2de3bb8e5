"""`labdaemon measure` as a person runs it: discs drawn here, blurred by summing instants."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.cli.main import main
from labdaemon.processing.result_reader import read_csv
from labdaemon.processing.tables import MEASUREMENT_COLUMNS

PLACES = np.array([(90.3, 80.2), (230.7, 81.1), (91.2, 200.4), (231.5, 199.6)])
MOTION = np.array([(3.0, 0.0), (0.0, 5.0), (2.0, 2.0), (6.0, -1.0)])


def frame(path: Path, motion: np.ndarray, seed: int, *, shift: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Four dots of radius 9 px on white labels, 16-bit grey, four times oversampled."""
    rng = np.random.default_rng(seed)
    dark = np.zeros((280 * 4, 320 * 4), np.float32)
    phases = (np.arange(64) + 0.5) * np.pi / 64
    for place, a in zip(PLACES, motion, strict=True):
        for phase in phases if a.any() else [0.0]:
            x, y = (place + shift + a * np.cos(phase) + 0.5) * 4 - 0.5
            disc = np.zeros_like(dark)
            cv2.circle(disc, (round(x * 64), round(y * 64)), 36 * 64, 1.0, -1, cv2.LINE_8, 6)
            dark += disc / (len(phases) if a.any() else 1)
    dark = cv2.GaussianBlur(dark, (0, 0), 0.8 * 4)
    dark = cv2.resize(dark, (320, 280), interpolation=cv2.INTER_AREA)
    light = 30000 * (1 - 0.9 * dark)
    light += rng.normal(0, 1, light.shape) * np.sqrt(400 + 6.0 * light)
    assert cv2.imwrite(str(path), np.clip(light, 0, 65535).astype(np.uint16))
    return path


@pytest.fixture(scope="module")
def sharp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frame(tmp_path_factory.mktemp("f") / "sharp.png", np.zeros((4, 2)), 1)


@pytest.fixture(scope="module")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frame(tmp_path_factory.mktemp("f") / "run 7.png", MOTION, 2, shift=(21.0, -8.0))


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["labdaemon", "measure", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    return int(left.value.code or 0)


def check(rows: list, names: list[str]) -> None:
    assert [row["target"] for row in rows] == names
    for row, place, a in zip(rows, PLACES, MOTION, strict=True):
        assert row["capture"] == "run 7"
        assert row["camera"] == ""
        assert np.hypot(float(row["x_px"]) - place[0] - 21, float(row["y_px"]) - place[1] + 8) < 0.1
        got = np.array([float(row["ax_px"]), float(row["ay_px"])])
        assert min(np.hypot(*(got - a)), np.hypot(*(got + a))) < 0.15


def test_every_dot_is_measured_to_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, sharp: Path, blurred: Path
) -> None:
    out = tmp_path / "made" / "out.csv"
    assert run(monkeypatch, "--sharp", sharp, blurred, "--out", out, "--overlay", tmp_path) == 0
    check(read_csv(out), ["T01", "T02", "T03", "T04"])
    assert capsys.readouterr().out == ""
    assert (tmp_path / "overlay" / "run 7.png").exists()


def test_or_to_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], sharp: Path, blurred: Path
) -> None:
    assert run(monkeypatch, "--sharp", sharp, "--sharp", sharp, blurred) == 0
    text = capsys.readouterr().out
    assert text.splitlines()[0] == ",".join(MEASUREMENT_COLUMNS)
    check(list(csv.DictReader(io.StringIO(text))), ["T01", "T02", "T03", "T04"])


def test_patches_of_any_texture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sharp: Path, blurred: Path) -> None:
    boxes = [f"{int(x) - 19},{int(y) - 19},39,39" for x, y in PLACES]
    options = [part for box in boxes for part in ("--patch", box)]
    out = tmp_path / "out.csv"
    assert run(monkeypatch, "--sharp", sharp, blurred, *options, "--out", out) == 0
    rows = read_csv(out)
    assert [row["target"] for row in rows] == ["P01", "P02", "P03", "P04"]
    for row, a in zip(rows, MOTION, strict=True):
        got = np.array([float(str(row["ax_px"])), float(str(row["ay_px"]))])
        assert min(np.hypot(*(got - a)), np.hypot(*(got + a))) < 0.2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sharp", "{sharp}"], "Missing argument"),
        (["{blurred}"], "Missing option '--sharp'"),
        (["--sharp", "{sharp}", "{blurred}", "--patch", "1,2,3"], "is not X,Y,W,H"),
        (["--sharp", "{sharp}", "{blurred}", "--patch", "1,2,0,9"], "is not X,Y,W,H"),
        (["--sharp", "{sharp}", "{blurred}", "--patch", "300,10,40,40"], "does not lie inside the frame"),
        (["--sharp", "{sharp}", "{blurred}", "--frequency", "5"], "--exposure is missing"),
        (["--sharp", "{sharp}", "{blurred}", "--phase", "1"], "--frequency is missing"),
        (["--sharp", "{sharp}", "{blurred}", "--ambient", "1"], "--ambient is given, but no code"),
        (["--sharp", "{sharp}", "{blurred}", "--light", "12"], "--light '12' is no code"),
        (["--sharp", "{sharp}", "{blurred}", "--light", "110"], "--light needs --light-cycles, or --frequency and"),
        (["--sharp", "{sharp}", "{blurred}", "--light", "cos", "--light", "sin"], "2 --light for 1 blurred frames"),
        (["--sharp", "{sharp}", "{blurred}", "{blurred}"], "two blurred frames are called run 7"),
        (["--sharp", "{sharp}", "{gone}"], "gone.dng: no such file"),
        (["--sharp", "{gone}", "{blurred}"], "gone.dng: no such file"),
        (["--sharp", "{sharp}", "{small}"], "small.png: is 50x40 pixels"),
        (["--sharp", "{blank}", "{blurred}"], "blank.png: no dots found"),
        (["--sharp", "{sharp}", "{jpeg}"], "j.nef: is a JPEG"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_writes_nothing(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    sharp: Path,
    blurred: Path,
    arguments: list[str],
    said: str,
) -> None:
    files = {"sharp": sharp, "blurred": blurred, "gone": tmp_path / "gone.dng"}
    for name, size in (("small", (40, 50)), ("blank", (280, 320))):
        files[name] = tmp_path / f"{name}.png"
        cv2.imwrite(str(files[name]), np.full(size, 30000, np.uint16))
    files["jpeg"] = tmp_path / "j.nef"
    files["jpeg"].write_bytes(b"\xff\xd8\xff\xe1" + bytes(100))
    out = tmp_path / "out.csv"
    given = [argument.format(**files) for argument in arguments]
    assert run(monkeypatch, *given, "--out", out) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def spoilt(kind: str, picture: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(4)
    match kind:
        case "black":
            return np.zeros_like(picture)
        case "white":
            return np.full_like(picture, 65535)
        case "noise in the dark":
            return rng.integers(0, 60, picture.shape).astype(np.uint16)
        case _:
            return np.asarray(np.clip(rng.normal(30000, 400, picture.shape), 0, 65535), dtype=np.uint16)


@pytest.mark.parametrize("kind", ["black", "white", "noise in the dark", "bare paper"])
@pytest.mark.parametrize("patch", [[], ["--patch", "71,61,39,39"]], ids=["dots", "texture"])
def test_a_frame_that_shows_no_target_gives_no_number(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sharp: Path, blurred: Path, kind: str, patch: list[str]
) -> None:
    file, out = tmp_path / "spoilt.png", tmp_path / "out.csv"
    cv2.imwrite(str(file), spoilt(kind, cv2.imread(str(blurred), cv2.IMREAD_UNCHANGED)))
    assert run(monkeypatch, "--sharp", sharp, file, *patch, "--out", out) == 0
    for row in read_csv(out):
        assert "not_found" in str(row["flags"])
        assert row["ax_px"] in (None, "")
    if patch:  # and where the sharp frame shows none of it
        assert run(monkeypatch, "--sharp", file, sharp, *patch, "--out", out) == 0
        assert all("not_found" in str(row["flags"]) for row in read_csv(out))


@pytest.mark.parametrize("bits", [14, 8])
def test_fewer_bits_are_the_same_picture(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sharp: Path, blurred: Path, bits: int
) -> None:
    files = []
    for file in (sharp, blurred):
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) >> (16 - bits)
        files.append(tmp_path / file.name)
        cv2.imwrite(str(files[-1]), picture.astype(np.uint8 if bits == 8 else np.uint16))
    out = tmp_path / "out.csv"
    assert run(monkeypatch, "--sharp", *files, "--out", out) == 0
    rows = read_csv(out)
    check(rows, ["T01", "T02", "T03", "T04"])
    assert not any(row["flags"] for row in rows)


def test_a_second_dot_in_a_targets_patch_is_flagged_or_harmless(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sharp: Path, blurred: Path
) -> None:
    picture = cv2.imread(str(blurred), cv2.IMREAD_UNCHANGED)
    x, y = (PLACES[0] + (21.0, -8.0)).round().astype(int)
    dot = picture[y - 18 : y + 19, x - 18 : x + 19].copy()
    beside = picture[y - 18 : y + 19, x - 2 : x + 35]
    np.minimum(beside, dot, out=beside)
    file, out = tmp_path / "two.png", tmp_path / "out.csv"
    cv2.imwrite(str(file), picture)
    assert run(monkeypatch, "--sharp", sharp, file, "--out", out) == 0
    row = read_csv(out)[0]
    near = row["ax_px"] not in (None, "") and abs(abs(float(str(row["ax_px"]))) - 3) < 0.15
    assert near or row["flags"]


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("over", [1.0, 1.3])
def test_a_ceiling_below_the_container_s_is_masked_or_flagged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sharp: Path, blurred: Path, bits: int, over: float
) -> None:
    files, top = [], 2**bits - 1
    for file in (sharp, blurred):
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) * (over * top / 30000)
        files.append(tmp_path / file.name)
        cv2.imwrite(str(files[-1]), np.clip(np.rint(picture), 0, top).astype(np.uint16))
    out = tmp_path / "out.csv"
    assert run(monkeypatch, "--sharp", *files, "--out", out) == 0
    for row, a in zip(read_csv(out), MOTION, strict=True):
        near = row["ax_px"] not in (None, "") and abs(
            np.hypot(float(str(row["ax_px"])), float(str(row["ay_px"]))) - np.hypot(*a)
        )
        assert near < 0.1 or "saturated" in str(row["flags"])


@pytest.mark.parametrize("which", ["sharp", "blurred"])
def test_rows_that_were_never_written_are_named_and_nothing_is_measured_there(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    sharp: Path,
    blurred: Path,
    which: str,
) -> None:
    files = {"sharp": sharp, "blurred": blurred}
    picture = cv2.imread(str(files[which]), cv2.IMREAD_UNCHANGED)
    picture[130:] = 0
    files[which] = tmp_path / f"{which}.png"
    cv2.imwrite(str(files[which]), picture)
    out = tmp_path / "out.csv"
    assert run(monkeypatch, "--sharp", files["sharp"], files["blurred"], "--out", out) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if line.startswith("note:")]
    assert len(notes) == 1
    assert f"{which}.png: 150 of 280 rows are zero" in notes[0]
    rows = {row["target"]: row for row in read_csv(out)}
    assert abs(np.hypot(float(str(rows["T01"]["ax_px"])), float(str(rows["T01"]["ay_px"]))) - 3.0) < 0.15
    assert "T03" not in rows or "not_found" in str(rows["T03"]["flags"])
