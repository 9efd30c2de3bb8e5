"""Each file is read back by the field's own reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.cli.export import export
from labdaemon.errors import DataError, StorageError, UsageError
from labdaemon.export import FORMATS, EnvelopeCube, export_folder, formats, read_results


@pytest.fixture
def cube(folder: Path) -> EnvelopeCube:
    return EnvelopeCube.of(read_results(folder))


def test_hdf5(folder: Path, cube: EnvelopeCube):
    h5py = pytest.importorskip("h5py")
    with h5py.File(export_folder(folder, folder / "out.h5")) as file:
        np.testing.assert_array_equal(file["envelope/a_mm"], cube.vectors["a_mm"])
        assert file["envelope/a_mm"].attrs["units"] == "mm"
        assert file["envelope/a_mm"].dims[1].label == "target"
        assert [name.decode() for name in file["envelope/a_mm"].dims[1][0][()]] == list(cube.targets)
        np.testing.assert_array_equal(file["capture/frequency_hz"], [5.0, 8.0, 12.0])
        assert file["envelope/flags"].asstr()[2, 1] == "not_found"
        np.testing.assert_array_equal(file["envelope/transmissibility"], cube.scalars["transmissibility"])
        covariance = file["envelope/covariance_motion_mm2"]
        assert covariance[1, 1, 0, 2] == pytest.approx(0.4 * 0.002**2)
        assert covariance[1, 1, 2, 0] == covariance[1, 1, 0, 2]
        assert covariance[1, 0, 0, 2] == 0.0
        assert covariance.attrs["units"] == "mm2"
        assert file["envelope/transmissibility"].attrs["units"] == "1"


def test_parquet_by_pandas(folder: Path, cube: EnvelopeCube):
    pytest.importorskip("pyarrow")
    import pandas as pd
    import pyarrow.parquet as pq

    path = export_folder(folder, folder / "out.parquet")
    table = pd.read_parquet(path)
    assert list(table["capture"].unique()) == list(cube.captures)
    one = table[(table["capture"] == "eight") & (table["target"] == "T2")].iloc[0]
    assert one["frequency_hz"] == 8.0
    assert one["ax_mm"] == cube.vectors["a_mm"][1, 1, 0]
    assert list(table.loc[2, "flags"]) == ["at_rest", "camera_moved"]
    assert table["ax_mm"].isna().sum() == 1
    schema = pq.read_schema(path)
    assert schema.field("sd_ax_mm").metadata == {b"unit": b"mm"}
    assert schema.field("exposure_s").metadata == {b"unit": b"s"}
    assert one["cov_ax_az_mm2"] == pytest.approx(0.4 * 0.002**2)
    assert one["cov_ax_bz_mm2"] == 0.0
    assert schema.field("cov_ax_az_mm2").metadata == {b"unit": b"mm2"}
    assert one["transmissibility"] == cube.scalars["transmissibility"][1, 1]


def test_netcdf_by_xarray(folder: Path, cube: EnvelopeCube):
    xr = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xr.open_dataset(export_folder(folder, folder / "out.nc"), engine="h5netcdf") as data:
        assert data["a_mm"].dims == ("capture", "target", "axis")
        assert data["a_mm"].attrs["units"] == "mm"
        assert float(data["a_mm"].sel(capture="five", target="T2", axis="x")) == cube.vectors["a_mm"][0, 1, 0]
        assert float(data["frequency_hz"].sel(capture="twelve")) == 12.0
        covariance = data["covariance_motion_mm2"].sel(capture="eight", target="T2")
        assert float(covariance.sel(motion="ax_mm", other_motion="az_mm")) == pytest.approx(0.4 * 0.002**2)
        assert data["covariance_mean_mm2"].attrs["units"] == "mm2"
        assert str(data["flags"].sel(capture="twelve", target="T2").item()) == "not_found"


def test_matlab_by_scipy(folder: Path, cube: EnvelopeCube):
    from scipy.io import loadmat

    data = loadmat(export_folder(folder, folder / "out.mat"), simplify_cells=True)["labdaemon"]
    np.testing.assert_array_equal(data["a_mm"], cube.vectors["a_mm"])
    np.testing.assert_array_equal(data["complex_amplitude_mm"], cube.complex_amplitude_mm)
    assert list(data["target"]) == list(cube.targets)
    np.testing.assert_array_equal(data["covariance_motion_mm2"], cube.covariances["covariance_motion_mm2"])
    assert data["frequency_hz"].tolist() == [5.0, 8.0, 12.0]


def test_universal_file_by_pyuff(folder: Path, cube: EnvelopeCube):
    pyuff = pytest.importorskip("pyuff")
    file = pyuff.UFF(str(export_folder(folder, folder / "out.uff")))
    types = [int(kind) for kind in file.get_set_types()]
    assert types[:4] == [151, 164, 2411, 82]
    assert types.count(55) == 3
    assert types.count(58) == 9
    sets = file.read_sets()
    nodes = sets[types.index(2411)]
    np.testing.assert_allclose(nodes["x"], [0.0, 0.1, 0.2], atol=1e-9)  # metres
    shape = sets[types.index(55) + 1]
    np.testing.assert_allclose(shape["r1"], 1e-3 * cube.complex_amplitude_mm[1, :, 0], atol=1e-9)
    assert shape["freq"] == 8.0
    last = sets[types.index(55) + 2]
    assert list(last["node_nums"]) == [1, 3]  # the one that was not found is left out
    function = sets[types.index(58)]
    np.testing.assert_allclose(function["x"], [5.0, 8.0, 12.0])
    np.testing.assert_allclose(function["data"], cube.frequency_response[:, 0, 0], rtol=1e-6)
    assert (function["rsp_node"], function["rsp_dir"]) == (1, 1)


def test_shapes_without_any_frequency_are_written_without_functions(folder: Path):
    pyuff = pytest.importorskip("pyuff")
    for path in folder.glob("captures/*/capture.toml"):
        path.unlink()
    types = [int(kind) for kind in pyuff.UFF(str(export_folder(folder, folder / "out.uff"))).get_set_types()]
    assert types.count(55) == 3
    assert 58 not in types


@pytest.mark.peers
def test_paraview_by_its_reader(folder: Path, cube: EnvelopeCube):
    io = pytest.importorskip("vtkmodules.vtkIOXML", exc_type=ImportError)
    numpy_support = pytest.importorskip("vtkmodules.util.numpy_support", exc_type=ImportError)
    reader = io.vtkXMLPolyDataReader()
    reader.SetFileName(str(export_folder(folder, folder / "out.vtp")))
    reader.Update()
    data = reader.GetOutput()
    assert data.GetNumberOfPoints() == 3
    a = numpy_support.vtk_to_numpy(data.GetPointData().GetArray("twelve a_mm"))
    np.testing.assert_array_equal(a, cube.vectors["a_mm"][2])
    names = data.GetPointData().GetAbstractArray("target")
    assert [names.GetValue(index) for index in range(3)] == list(cube.targets)
    frequency = numpy_support.vtk_to_numpy(data.GetFieldData().GetArray("frequency_hz"))
    assert frequency.tolist() == [5.0, 8.0, 12.0]


def test_the_vtk_file_is_well_formed(folder: Path, cube: EnvelopeCube):
    from xml.etree import ElementTree as ET

    root = ET.parse(export_folder(folder, folder / "out.vtp")).getroot()
    arrays = {one.get("Name"): (one.text or "").split() for one in root.iter("DataArray")}
    np.testing.assert_array_equal(np.array(arrays["five a_mm"], dtype=float).reshape(-1, 3), cube.vectors["a_mm"][0])
    assert arrays["offsets"] == ["1", "2", "3"]


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_folder_without_results_writes_nothing(folder: Path, suffix: str):
    for package in FORMATS[suffix].packages:
        pytest.importorskip(package)
    (folder / "results" / "envelope.csv").unlink()
    with pytest.raises(DataError):
        export_folder(folder, folder / f"out{suffix}")
    assert not list(folder.glob("*out*"))


def test_an_unknown_suffix_is_refused_with_the_known_ones(folder: Path):
    with pytest.raises(UsageError, match=r"\.uff \(UFF\)"):
        export_folder(folder, folder / "out.xlsx")


def test_a_package_that_is_missing_is_named_with_the_remedy(folder: Path, monkeypatch: pytest.MonkeyPatch):
    missing = formats.FileFormat("Parquet", "parquet", ("no_such_package",))
    monkeypatch.setitem(FORMATS, ".parquet", missing)
    with pytest.raises(UsageError, match=r"no_such_package; run: pip install 'labdaemon\[export\]'"):
        export_folder(folder, folder / "out.parquet")


def test_a_file_that_cannot_be_written_is_named_and_leaves_nothing(folder: Path):
    (folder / "file").write_text("no folder", encoding="utf-8")
    with pytest.raises(StorageError, match="file"):
        export_folder(folder, folder / "file" / "out.mat")


def test_the_command_writes_several_files(folder: Path):
    done = CliRunner().invoke(
        export, [str(folder), "--to", str(folder / "a.mat"), "--to", str(folder / "b.vtp")], catch_exceptions=False
    )
    assert done.output.splitlines() == [f"wrote {folder / 'a.mat'}", f"wrote {folder / 'b.vtp'}"]


def test_the_crate_describes_every_file_of_the_folder(folder: Path):
    import hashlib
    import json

    (folder / ".hidden").write_text("no", encoding="utf-8")
    path = export_folder(folder, folder / "ro-crate-metadata.json")
    graph = {one["@id"]: one for one in json.loads(path.read_text(encoding="utf-8"))["@graph"]}
    parts = {part["@id"] for part in graph["./"]["hasPart"]}
    assert parts == {
        "captures/eight-1/capture.toml",
        "captures/eight-2/capture.toml",
        "captures/five/capture.toml",
        "captures/twelve/capture.toml",
        "results/envelope.csv",
    }
    envelope = graph["results/envelope.csv"]
    assert envelope["sha256"] == hashlib.sha256((folder / "results" / "envelope.csv").read_bytes()).hexdigest()
    assert graph["ro-crate-metadata.json"]["about"] == {"@id": "./"}
    assert graph["#measurement"]["result"] == [{"@id": "results/envelope.csv"}]


def test_the_crate_belongs_at_the_root_of_its_folder(folder: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="describes the folder in which it lies"):
        export_folder(folder, tmp_path / "ro-crate-metadata.json")
